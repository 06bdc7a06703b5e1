# ruff: noqa
# compare two materials side by side
import solari_vk as sv, numpy as np
from PIL import Image

scene = sv.builtin("sphere_grid")
s = sv.Scene()
s.add(sv.shapes.plane(10), sv.Material(base_color="#808080"))
a = s.add(sv.shapes.sphere(0.5), sv.Material(base_color=(0.9, 0.6, 0.2), metallic=1, roughness=0.1), (-0.7, 0.5, 0))
b = s.add(
    sv.shapes.sphere(0.5),
    sv.Material(base_color=(0.9, 0.6, 0.2), metallic=1, roughness=0.5, clearcoat=1),
    (0.7, 0.5, 0),
)
sv.studio_lights(s, ground=False)
s.camera = sv.Camera.look_at((0, 1.2, 3), (0, 0.5, 0), fov=45)
with sv.Device() as d, sv.PathTracer(d, s, (320, 180)) as t:
    f = t.render(samples=16)
    img = np.asarray(f)
    print(img.shape, img.dtype)
    Image.fromarray(f.image()).save("compare.png")
