# ruff: noqa
# AO by own rays against height field
import solari_vk as sv, numpy as np

n = 128
x, z = np.meshgrid(np.linspace(-4, 4, n), np.linspace(-4, 4, n))
y = np.sin(x * 2) * np.cos(z * 2) * 0.5
v = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
i = np.arange(n * n).reshape(n, n)
tri = np.concatenate(
    [
        np.stack([i[:-1, :-1], i[1:, :-1], i[:-1, 1:]], -1).reshape(-1, 3),
        np.stack([i[:-1, 1:], i[1:, :-1], i[1:, 1:]], -1).reshape(-1, 3),
    ]
)
mesh = sv.Mesh(v, tri)
s = sv.Scene()
s.add(mesh, sv.Material())
with sv.Device() as d, sv.RayTracer(d, s) as tracer:
    rng = np.random.default_rng(0)
    ao = np.zeros(len(v))
    for k in range(32):
        w = rng.normal(size=(len(v), 3))
        w /= np.linalg.norm(w, axis=1)[:, None]
        w[:, 1] = abs(w[:, 1])
        hit = tracer.trace(v + [0, 1e-3, 0], w)
        ao += ~np.isfinite(hit.t)
    print((ao / 32).reshape(n, n).mean())
