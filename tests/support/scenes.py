"""Scenes for tests, random ones among them, their meshes and cameras, and whether two scenes are the same."""

import dataclasses
import math

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.material import TEXTURES, Texture
from solari_vk.scene.matrices import rotation, transform_points
from solari_vk.scene.meshes.deformation import Deformation

# ---- a lamp over a floor, whose light has closed forms ----


# ---- a wall, for frames of known light ----


WALL_SIZE = (96, 64)
WALL_DISTANCE = 2.0  # of the wall from the camera, in meters; the camera sees up and down by 45 degrees
WALL_PIXEL = 2.0 * WALL_DISTANCE / WALL_SIZE[1]  # the width of a pixel on the wall


def white_wall(*corners):
    """White quads seen by a camera at the origin that looks along -z; by default one wall that fills the picture."""
    scene = sv.Scene()
    far = 5 * WALL_DISTANCE
    default = [
        [-far, -far, -WALL_DISTANCE],
        [far, -far, -WALL_DISTANCE],
        [far, far, -WALL_DISTANCE],
        [-far, far, -WALL_DISTANCE],
    ]
    scene.add(shapes.polygons(*(corners or (np.array(default),))), matte(1.0))
    scene.add(sv.Camera(vertical_fov=np.pi / 2))
    return scene


def camera_moved_by(pixels):
    """The camera, moved to the right by this many pixels of the wall."""
    transform = np.eye(4)
    transform[0, 3] = WALL_PIXEL * pixels
    return sv.Camera(transform=transform, vertical_fov=np.pi / 2)


# ---- metals that show a room ----


# ---- skinned and morphed meshes ----


HEIGHT = 2.0


def tube(joints=3, around=8, rings=9, targets=0, rng=None, **fields):
    """A mesh around the y axis, whose joints are evenly spaced, and the places (J, 4, 4) of the joints at rest.

    Each vertex is moved by the two joints beside it. targets: the number of random morph targets.
    """
    heights, angles = np.linspace(0, HEIGHT, rings), 2 * math.pi * np.arange(around) / around
    y, angle = (part.reshape(-1) for part in np.meshgrid(heights, angles, indexing="ij"))
    out = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=1)
    positions = 0.3 * out + y[:, None] * [0, 1, 0]
    ring, slot = (part.reshape(-1) for part in np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij"))
    a, b = ring * around + slot, ring * around + (slot + 1) % around
    triangles = np.concatenate([np.stack([a, a + around, b], 1), np.stack([b, a + around, b + around], 1)])
    place = y / HEIGHT * (joints - 1)
    first = np.minimum(place.astype(int), joints - 2)
    share = place - first
    rng = np.random.default_rng(7) if rng is None else rng
    added = rng.normal(scale=0.1, size=(3, targets, len(positions), 3))
    deformation = Deformation(
        joints=np.stack([first, first + 1], 1),
        joint_weights=np.stack([1 - share, share], 1),
        **dict(zip(("targets", "target_normals", "target_tangents"), added, strict=True)) if targets else {},
    )
    tangents = np.append(np.cross([0, 1, 0], out), np.ones((len(out), 1)), axis=1)
    rest = np.tile(np.eye(4), (joints, 1, 1))
    rest[:, 1, 3] = np.linspace(0, HEIGHT, joints)
    mesh = sv.Mesh(
        positions,
        triangles,
        normals=out,
        uvs=np.stack([angle, y], 1),
        tangents=tangents,
        deformation=deformation,
        **fields,
    )
    return mesh, rest


def bent_joints(rest, angle, axis=(0, 0, 1)):
    """Joint matrices (J, 4, 4) of a tube in which each joint turns by an angle relative to the one below it."""
    matrices, above = [], np.eye(4)
    for joint, below in zip(rest, [np.eye(4), *rest[:-1]], strict=True):
        turn = np.eye(4)
        turn[:3, :3] = rotation(axis, angle)
        above = above @ np.linalg.inv(below) @ joint @ turn
        matrices.append(above @ np.linalg.inv(joint))
    return np.array(matrices)


# ---- random scenes, most of them unusual ----
#
# Degenerate triangles, lights without area, huge and tiny scales, extreme emission, cameras inside mirrors, no objects.


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


# ---- whether two scenes are equal in all that pictures show of them ----


OF_UNLIT = ("base_color", "base_color_texture", "alpha", "alpha_mode", "double_sided", "unlit", "name")
POSES = (0, 0.13, 0.5, 0.71, 1.0)  # of clips, in parts of their duration


def check_same(scene, other):
    """AssertionError unless the scenes are the same, in poses of their clips too."""
    assert other.name == scene.name
    assert list(other.variants) == list(scene.variants)
    check_objects(scene, other)
    for name in scene.variants:
        for one in (scene, other):
            one.use_variant(name)
        check_objects(scene, other)
    assert other.animations.names == scene.animations.names
    for number, clip in enumerate(scene.animations):
        assert abs(other.animations[number].duration - clip.duration) <= 1e-6 * clip.duration
        for seconds in np.array(POSES) * clip.duration:
            for one in (scene, other):
                one.animate(seconds, number, loop=False)
            check_objects(scene, other)


def check_objects(scene, other):
    for kind in ("instances", "cameras", "lights"):
        found, wanted = ([item for item in getattr(one, kind) if item is not one.environment] for one in (other, scene))
        if all(item.name for item in wanted):  # what follows clips is read in another order
            found, wanted = (sorted(items, key=lambda item: item.name) for items in (found, wanted))
        for a, b in zip(found, wanted, strict=True):
            assert a.name == b.name or not b.name, kind
            assert (a is other.backdrop, a is default_of(other)) == (b is scene.backdrop, b is default_of(scene)), kind
            {"instances": check_instance, "cameras": check_fields, "lights": check_fields}[kind](a, b)
    assert (scene.environment is None) == (other.environment is None)
    if scene.environment is not None:
        directions = np.random.default_rng(1).normal(size=(500, 3))
        found, wanted = (light(one.environment, directions) for one in (other, scene))
        inside = np.isfinite(found) & np.isfinite(wanted)
        assert inside.mean() > 0.9
        near(found[inside], wanted[inside], 1e-6)


def default_of(scene):
    return scene._camera or next(iter(scene.cameras), None)


def check_instance(found, wanted):
    assert found.visible == wanted.visible
    check_material(found.material, wanted.material)
    if not wanted.visible:
        return
    a, b = found.posed_mesh(), wanted.posed_mesh()
    corners, others = triangles_with_area(a), triangles_with_area(b)
    if np.linalg.det(found.transform) * np.linalg.det(wanted.transform) < 0:  # of a skin, which then is inside out
        others = others[:, ::-1]
    places = [transform_points(one.transform, mesh.positions) for one, mesh in ((found, a), (wanted, b))]
    near(places[0][corners], places[1][others], 1e-5)
    for name in ("normals", "tangents"):
        if getattr(b, name) is not None and not wanted.posed:
            near(getattr(a, name)[corners], getattr(b, name)[others], 1e-5)
    assert a.colors is b.colors is None or np.array_equal(a.colors[corners], b.colors[others])
    for name in ("base_color_texture",) if wanted.material.unlit else TEXTURES:
        ours, theirs = getattr(found.material, name), getattr(wanted.material, name)
        if theirs is not None:
            uvs, expected = a.uvs_for(ours.uv_set)[corners], b.uvs_for(theirs.uv_set)
            assert np.array_equal(uvs, np.zeros_like(uvs) if expected is None else expected[others]), name


def triangles_with_area(mesh):
    """The triangles (N, 3) of a mesh whose three vertices differ."""
    repeats = (np.roll(mesh.triangles, 1, axis=1) == mesh.triangles).any(axis=1)
    return mesh.triangles[~repeats]


def check_material(found, wanted):
    for name in OF_UNLIT if wanted.unlit else field_names(wanted):
        ours, theirs = getattr(found, name), getattr(wanted, name)
        if isinstance(theirs, Texture):
            check_texture(ours, theirs, name)
        elif matters(wanted, name):
            assert np.array_equal(ours, theirs), f"{wanted.describe()}: {name}: {ours} in place of {theirs}"


def matters(material, name):
    """Whether a field of a material shows: a cutoff does in mode "mask", a texture's scale where there is one."""
    if name == "alpha_cutoff":
        return material.alpha_mode == "mask"
    if name.endswith("_scale"):
        return getattr(material, name.replace("_scale", "_texture")) is not None
    return True


def check_texture(found, wanted, name):
    assert np.array_equal(found.image.pixels, wanted.image.pixels), name
    near(found.uv_transform, wanted.uv_transform, 1e-5)
    for field in ("wrap_u", "wrap_v", "magnification", "minification", "mipmaps"):
        assert getattr(found, field) == getattr(wanted, field), f"{name}: {field}"


def field_names(item):
    """The names of the fields of a scene's object, or of its class."""
    return [field.name for field in dataclasses.fields(item)]


def check_fields(found, wanted):
    """Cameras and lights."""
    assert type(found) is type(wanted)
    strength = next((name for name in ("intensity", "illuminance") if hasattr(wanted, name)), None)
    for name in set(field_names(wanted)) - {"name", "color", strength}:
        a, b = getattr(found, name), getattr(wanted, name)
        assert (a is None) == (b is None), name
        if isinstance(b, str):
            assert a == b, name
        elif b is not None:
            near(np.asarray(a, np.float64), np.asarray(b, np.float64), 1e-5)
    if strength:
        near(getattr(found, strength) * found.color, getattr(wanted, strength) * wanted.color, 1e-6)


def light(environment, directions):
    """The radiance from directions (N, 3) in the world, NaN near the edges of texels."""
    x, y, z = (directions @ environment.rotation.astype(np.float64)).T  # by the inverse
    height, width = environment.image.shape[:2]
    row = np.arctan2(np.hypot(x, z), y) / np.pi * height
    column = (np.arctan2(z, x) / (2 * np.pi) + 0.5) * width
    near_edge = (np.minimum(row % 1, 1 - row % 1) < 1e-3) | (np.minimum(column % 1, 1 - column % 1) < 1e-3)
    found = environment.image[row.astype(int).clip(0, height - 1), column.astype(int) % width] * environment.intensity
    return np.where(near_edge[:, None], np.nan, found)


def near(found, wanted, error):
    assert np.shape(found) == np.shape(wanted)
    assert np.abs(found - wanted).max(initial=0) <= error * max(1.0, np.abs(wanted).max(initial=0))


# ---- corners for acceleration structures ----


ABOVE_QUAD = np.array([0.6, 0.3, 5.0])
"""A point at distance 5 above the first triangle of `quad()`."""
DOWN = np.array([0.0, 0.0, -1.0])


def quad_corners(x=0.0, y=0.0, z=0.0):
    """Two triangles without indices, facing +z, of the unit square at (x, y, z)."""
    a = (x, y, z)
    b = (x + 1, y, z)
    c = (x + 1, y + 1, z)
    d = (x, y + 1, z)
    return np.array([a, b, c, a, c, d], np.float32)


def translation(x=0.0, y=0.0, z=0.0):
    """A translation (3, 4)."""
    return np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z]], np.float32)
