# ruff: noqa
# save to gltf
import solari_vk as sv

s = sv.builtin("cornell_box")
s.add(sv.shapes.sphere(0.2), sv.Material(base_color=(1, 0, 0), clearcoat=1), (0, 0.5, 0), name="ball")
s.save("cornell.glb")
t = sv.load("cornell.glb")
print(t, list(t.instances))
