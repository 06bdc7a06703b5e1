# ruff: noqa
# change light
import solari_vk as sv

s = sv.builtin("cornell_box")
print(s.lights)
l = sv.PointLight(position=(0, 1, 0), color=(1, 0.5, 0.2), intensity=100)
s.lights.append(l)
with sv.Device() as d, sv.Renderer(d, s, (256, 256)) as r:
    for i in range(8):
        f = r.render()
    print(f["radiance"].mean())
    l.intensity = 1000
    for i in range(8):
        f = r.render()
    print(f["radiance"].mean())
    l.color = (0, 0, 1)
    for i in range(8):
        f = r.render()
    print(f["radiance"].mean((0, 1)))
