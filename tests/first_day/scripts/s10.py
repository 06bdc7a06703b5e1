# ruff: noqa
# stereo, panorama, fisheye, ortho
import solari_vk as sv, numpy as np
s=sv.builtin("cornell_box")
c=s.camera
with sv.Device() as d, sv.PathTracer(d,s,(256,128)) as t:
    for name,cam in {
        "left": lambda: sv.Camera(c.transform, position=c.position+(-.03,0,0)),
        "right": lambda: c.moved((.03,0,0)),
        "pano": lambda: sv.Camera.panorama((0,1,0)),
        "equirect": lambda: sv.Camera(position=(0,1,0),projection="equirectangular"),
        "fisheye": lambda: sv.Camera(position=(0,1,0),projection="fisheye",fov=180),
        "ortho": lambda: sv.Camera.look_at((0,1,4),(0,1,0),orthographic=2.0),
        "ortho2": lambda: sv.Camera(position=(0,1,4),projection="orthographic",height=2)}.items():
        try:
            t.render(cam(),samples=8).save(name+".png"); print(name,"ok")
        except Exception as e: print(name,type(e).__name__,e)
