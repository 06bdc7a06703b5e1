# ruff: noqa
# 200 random spheres, moved each frame, 30 frames fast
import solari_vk as sv, numpy as np, time

rng = np.random.default_rng(0)
scene = sv.Scene()
pos = rng.uniform(-5, 5, (200, 3))
balls = []
for p in pos:
    m = sv.Material(base_color=rng.uniform(0, 1, 3), roughness=rng.uniform(), metallic=float(rng.uniform() < 0.5))
    balls.append(scene.add(sv.shapes.sphere(rng.uniform(0.2, 0.6)), m, p))
scene.environment = sv.Sky()
scene.camera = sv.Camera.look_at((0, 2, 14), (0, 0, 0))
with sv.Device() as d, sv.Renderer(d, scene, (320, 180)) as r:
    t = time.time()
    for i in range(30):
        pos += rng.normal(0, 0.1, pos.shape)
        for b, p in zip(balls, pos):
            b.transform = p
        f = r.render()
        f.save(f"b{i:02}.png")
        if i == 0:
            print("first", time.time() - t)
            t = time.time()
    print("29 frames", time.time() - t)
