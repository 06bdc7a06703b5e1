# ruff: noqa
# lux on desk
import solari_vk as sv, numpy as np

s = sv.Scene()
s.add(sv.shapes.box((-2, 0, -2), (2, 0.01, 2)), sv.Material(base_color=(0.5,) * 3), name="desk")
# lamp of 800 lm at 1.5m
s.add(sv.PointLight(position=(0, 1.5, 0), lumens=800))
with sv.Device() as d:
    print(sv.illuminance(d, s, [(0, 0.0101, 0)], (0, 1, 0), samples=1000))
    print("expected", 800 / (4 * np.pi) / 1.49**2)
