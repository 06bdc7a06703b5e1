# ruff: noqa
# texture from numpy
import solari_vk as sv, numpy as np

tex = np.zeros((64, 64, 3), np.uint8)
tex[::8] = 255
tex[:, ::8] = (255, 0, 0)
s = sv.Scene()
s.add(sv.shapes.plane(4), sv.Material(base_color_texture=tex))
s.add(sv.shapes.sphere(0.5), sv.Material(base_color_texture=tex, roughness=0.4), (0, 0.5, 0))
s.environment = sv.Sky()
s.camera = sv.Camera.look_at((0, 1, 3), (0, 0.4, 0))
with sv.Device() as d, sv.PathTracer(d, s, (320, 180)) as t:
    t.render(samples=8).save("tex.png")
