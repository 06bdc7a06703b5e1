# ruff: noqa
# vertex animated
import solari_vk as sv, numpy as np

n = 64
x, z = np.meshgrid(np.linspace(-2, 2, n), np.linspace(-2, 2, n))
i = np.arange(n * n).reshape(n, n)
tri = np.concatenate(
    [
        np.stack([i[:-1, :-1], i[1:, :-1], i[:-1, 1:]], -1).reshape(-1, 3),
        np.stack([i[:-1, 1:], i[1:, :-1], i[1:, 1:]], -1).reshape(-1, 3),
    ]
)


def verts(t):
    return np.stack([x, 0.2 * np.sin(3 * x + t) * np.cos(3 * z), z], -1).reshape(-1, 3).astype(np.float32)


m = sv.Mesh(verts(0), tri)
s = sv.Scene()
s.add(m, sv.Material(base_color=(0.1, 0.3, 0.6), roughness=0.1), name="sea")
s.environment = sv.Sky()
s.camera = sv.Camera.look_at((0, 1.5, 4), (0, 0, 0))
with sv.Device() as d, sv.Renderer(d, s, (320, 180)) as r:
    for k in range(10):
        m.positions = verts(k * 0.3)
        f = r.render()
    f.save("sea.png")
