# ruff: noqa
# stereo, panorama, fisheye, ortho
import solari_vk as sv, numpy as np

s = sv.builtin("cornell_box")
c = s.camera


def moved(x):
    cam = sv.Camera(transform=c.transform)
    cam.position = cam.position + (x, 0, 0)
    return cam


with sv.Device() as d, sv.PathTracer(d, s, (256, 128)) as t:
    for name, cam in {
        "left": lambda: moved(-0.03),
        "right": lambda: moved(0.03),
        "equirect": lambda: sv.Camera(position=(0, 1, 0), projection="equirectangular"),
        "fisheye": lambda: sv.Camera(position=(0, 1, 0), projection="fisheye", fov=180),
        "ortho": lambda: sv.Camera.look_at((0, 1, 4), (0, 1, 0), orthographic_height=2.0),
    }.items():
        t.render(cam(), samples=8).save(name + ".png")
        print(name, "ok")
