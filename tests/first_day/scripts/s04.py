# ruff: noqa
# trimesh primitives
import trimesh, solari_vk as sv

m = trimesh.creation.torus(1.0, 0.3)
c = trimesh.creation.capsule(1, 0.3)
c.apply_translation((2, 0, 0))
s = sv.Scene()
s.add(m, sv.Material(base_color=(0.8, 0.2, 0.1)), name="torus")
s.add(sv.Mesh(c.vertices, c.faces), sv.Material(), name="capsule")
s.add(sv.Mesh.from_trimesh(trimesh.creation.icosphere()), sv.Material(), (-2, 0, 0))
s.environment = sv.Sky()
s.camera = sv.Camera.look_at((0, 3, 5), (0, 0, 0))
with sv.Device() as d:
    sv.PathTracer(d, s, (320, 180)).render(samples=8).save("trimesh.png")
