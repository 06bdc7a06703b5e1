# ruff: noqa
# picking
import solari_vk as sv

s = sv.builtin("cornell_box")
with sv.Device() as d, sv.Renderer(d, s, (256, 256)) as r:
    f = r.render()
    print(f.pick(128, 200))
    print(s.instances)
    print(r.pick(128, 200))
