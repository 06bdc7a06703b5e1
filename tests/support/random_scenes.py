"""Random scenes and settings, most of them unusual: degenerate triangles, lights without area, huge and tiny scales,
extreme emission, cameras inside mirrors, empty scenes."""

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.settings import DEFAULTS, FIELDS

# Upper limits of settings that cost time.
MAX_VALUES = {
    "di_candidates": 64,
    "world_cache_candidates": 64,
    "world_cache_search_steps": 16,
    "specular_bounces": 12,
    "paths_bounces": 12,
    "paths_candidates": 64,
    "paths_later_candidates": 64,
}


def _spoiled_meshes():
    random = np.random.default_rng(0)
    points = random.uniform(-1, 1, (6, 3))
    ball = shapes.sphere(0.5, 8)
    sliver = [(0, 0, 0), (1, 0, 0), (0.5, 1e-7, 0)]
    return [
        sv.Mesh(positions=np.repeat(points[:2], 3, axis=0), name="points"),
        sv.Mesh(positions=points[[3, 4, 3, 5, 5, 4]], name="lines"),
        sv.Mesh(positions=sliver, name="sliver"),
        sv.Mesh(positions=np.concatenate([sliver, points[:3]]), normals=np.zeros((6, 3)), name="no normals"),
        sv.Mesh(positions=ball.positions, normals=-ball.normals, indices=ball.indices, name="inside out"),
        sv.Mesh(positions=ball.positions, normals=np.roll(ball.normals, 1, axis=1), indices=ball.indices, name="bent"),
    ]


MESHES = [
    shapes.sphere(0.5, 8),
    shapes.sphere(0.5, 8),
    shapes.box(),
    shapes.box((-2, -2, -2), (2, 2, 2), inward=True),
    shapes.box((-2, -2, -2), (2, 2, 2), inward=True),
    shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, 1)),
    *_spoiled_meshes(),
]


def random_material(random):
    def pick(*choices):
        return choices[random.integers(len(choices))]

    radiance = pick(0, 0, 0, 1e-30, 1e-6, 1, 10, 1e4, 1e8)
    return sv.Material(
        base_color=pick(np.zeros(3), np.ones(3), random.random(3), random.random(3)),
        metallic=pick(0.0, 0.0, 1.0, 1.0, float(random.random())),
        perceptual_roughness=pick(0.0, 0.02, 0.0317, 1.0, float(random.random()), float(random.random())),
        reflectance=pick(np.zeros(3), np.ones(3), random.random(3)),
        emissive=radiance * pick(np.ones(3), random.random(3), np.array((0, 0, 1.0))),
        double_sided=bool(random.random() < 0.3),
    )


def random_transform(random, scale):
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    kind = random.random()
    if kind < 0.3:  # mirrored, or scaled very differently along its axes
        axes = axes @ np.diag(random.choice((-1, 1), 3) * 10.0 ** random.uniform(-3, 0.5, 3))
    elif kind < 0.6:
        axes = np.eye(3)
    transform = np.eye(4)
    transform[:3, :3] = scale * axes
    transform[:3, 3] = scale * random.uniform(-1, 1, 3) * (random.random() < 0.8)
    return transform


def random_items(random):
    """Instances, suns and a camera."""
    scale = 10.0 ** random.choice((0, 0, 0, -3, -1, 1, 3, 5))
    count = int(random.choice((0, 1, 2, 4, 7)))
    items = []
    for _ in range(count):
        mesh = MESHES[random.integers(len(MESHES))]
        items.append(
            sv.Instance(mesh=mesh, material=random_material(random), transform=random_transform(random, scale))
        )
    for _ in range(int(random.choice((0, 0, 1, 2)))):
        items.append(
            sv.DirectionalLight(
                direction=random.normal(size=3),
                illuminance=float(random.choice((0, 1e-6, 1, 1e5, 1e10))),
                angular_diameter=float(random.choice((1e-5, 0.0093, 0.5, np.pi))),
            )
        )
    eye = scale * random.uniform(-1.5, 1.5, 3)
    target = eye + random.normal(size=3) * scale if random.random() < 0.5 else -0.01 * scale * random.random(3)
    items.append(
        sv.Camera.look_at(
            eye,
            target,
            vertical_fov=float(random.choice((0.01, 0.8, 1.5, 2.8))),
            near=float(scale * random.choice((1e-5, 1e-2))),
            ev100=float(random.uniform(-12, 16)),
        )
    )
    return items


def random_settings(random, settings):
    """Set each live setting to its default or to a random value of its whole range."""
    for name, field in FIELDS.items():
        if field.rebuilds:
            continue
        value = default = DEFAULTS[name]
        if random.random() < 0.35:
            if field.choices:
                value = str(random.choice(field.choices))
            elif isinstance(default, bool):
                value = not default
            else:
                high = min(field.high, MAX_VALUES.get(name, 1e6))
                low = max(field.low, 1e-6)
                value = float(np.clip(np.exp(random.uniform(np.log(low), np.log(high))), low, high))
                if isinstance(default, int):
                    value = round(value)
        if getattr(settings, name) != value:
            setattr(settings, name, value)
