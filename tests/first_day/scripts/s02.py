# ruff: noqa
# dataset: depth + normals + ids for 20 random views of a room, COCO boxes
import solari_vk as sv, numpy as np, json

A = "../shared/assets/kaykit_dungeon/"
scene = sv.Scene()
rng = np.random.default_rng(0)
for x in range(-2, 3):
    for z in range(-2, 3):
        scene.add(sv.load(A + "floor_tile_large.glb"), position=(4 * x, 0, 4 * z))
for n, p in {
    "table_long_decorated_A": (0, 0, 0),
    "chair": (2, 0, 1),
    "barrel_large": (-3, 0, 2),
    "chest_gold": (3, 0, -3),
    "keg": (-3, 0, -3),
}.items():
    scene.add(sv.load(A + n + ".glb"), position=p, name=n)
scene.environment = sv.Sky()
scene.add(sv.PointLight(position=(0, 4, 0), intensity=1000))
out = []
with sv.Device() as device, sv.Renderer(device, scene, (320, 240)) as r:
    for v in range(20):
        eye = rng.uniform((-8, 1, -8), (8, 4, 8))
        cam = sv.Camera.look_at(eye, (0, 1, 0), fov=60)
        f = r.render(cam)
        depth = f["depth"]
        normal = f["shading_normal"]
        ids = f["instance_id"]
        boxes = {}
        for i in np.unique(ids):
            ys, xs = np.nonzero(ids == i)
            boxes[int(i)] = [int(xs.min()), int(ys.min()), int(xs.max() - xs.min() + 1), int(ys.max() - ys.min() + 1)]
        np.savez(f"v{v:02}.npz", depth=depth, normal=normal, ids=ids)
        out.append(boxes)
print(out[:2])
