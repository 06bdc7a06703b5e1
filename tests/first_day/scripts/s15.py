# ruff: noqa
# motion blur, dof
import solari_vk as sv

s = sv.open("../shared/assets/Fox/Fox.glb")
s.camera = sv.Camera.look_at((150, 100, 150), (0, 30, 0), fov=45, aperture=2.0, focus_distance=200)
with sv.Device() as d, sv.PathTracer(d, s, (320, 180)) as t:
    s.animate(0.3, "Run")
    t.render(samples=16, shutter=sv.Shutter(close=1 / 48)).save("fox.png")
