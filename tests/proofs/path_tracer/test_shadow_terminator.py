"""A ball of few triangles with smooth normals is shaded as one of many: facets hide no light at its terminator."""

from __future__ import annotations

import numpy as np
from support.frames import PATHS, PLAIN_PATHS, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes

SIZE = (64, 64)
TOWARDS_SUN = np.array((0.8, 0.5, 0.33166))


def ball(segments, **material):
    """A ball in the sun, seen from the front."""
    scene = sv.Scene(sv.DirectionalLight(-TOWARDS_SUN, illuminance=np.pi))
    scene.add(shapes.sphere(segments=segments), sv.Material(**{"base_color": 0.8, "reflectance": 0.0, **material}))
    scene.camera = sv.Camera.look_at((0, 0, 5), (0, 0, 0), orthographic_height=2.0, ev100=0)
    return scene


def traced(device, scene):
    with sv.PathTracer(device, scene, SIZE) as tracer:
        return np.array(tracer.render(samples=64)["raw_radiance"])[..., 1]


def framed(device, scene):
    with make_renderer(
        device, scene, SIZE, passes=PATHS, gbuffer="traced", **{**PLAIN_PATHS, "jitter": True}
    ) as renderer:
        return np.mean([np.array(renderer.render()["raw_radiance"])[..., 1] for _ in range(64)], axis=0)


def terminator():
    """Pixels whose normals are at 70 to 90 degrees from the sun, and not at the silhouette."""
    y, x = (1 - 2 * (np.mgrid[:64, :64] + 0.5) / 64) * np.array((1, -1)).reshape(2, 1, 1)
    across = x * x + y * y
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - across, 0))], axis=-1)
    cosine = normal @ TOWARDS_SUN
    return (across < 0.7) & (cosine > 0.0) & (cosine < 0.34)


def check_balls(device, ways=(traced, framed)):
    where = terminator()
    for way in ways:
        smooth, coarse = (way(device, ball(segments))[where] for segments in (512, 16))
        error = np.abs(coarse - smooth).mean() / smooth.mean()
        dark = (coarse < 0.2 * smooth)[smooth > 0.05].mean()
        print(way.__name__, error, dark)
        assert error < 0.15, f"{way.__name__}: {error:.3f}"
        assert dark < 0.01, f"{way.__name__}: {dark:.3f} of the pixels are dark"


def test_balls(device):
    check_balls(device)


def test_things_on_a_cube_keep_their_shadows(device):
    """The smooth normals of a cube stand for no curve: a small box on it has its shadow."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    triangles = [(2, 6, 7), (2, 7, 3)]  # the top
    scene = sv.Scene(sv.DirectionalLight((-1, -1, 0), illuminance=np.pi))
    gray = sv.Material(base_color=0.8, reflectance=0.0)
    scene.add(sv.Mesh(corners, triangles, normals=corners / 3**0.5), gray)
    scene.add(shapes.box((-0.1, 1, -0.1), (0.1, 1.2, 0.1)), gray)
    scene.camera = sv.Camera.look_at((-0.15, 5, 0), (-0.15, 1, 1e-3), orthographic_height=0.04, ev100=0)
    assert traced(device, scene).max() < 0.05


def smooth(triangles):
    """A mesh of these triangles, (n, 3, 3), with normals that are the means around each vertex."""
    positions, corners = np.unique(np.round(triangles.reshape(-1, 3), 6), axis=0, return_inverse=True)
    corners = corners.reshape(-1, 3)
    normals = np.zeros_like(positions)
    faces = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    np.add.at(normals, corners, faces[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return sv.Mesh(positions, corners, normals=normals)


def triangles_of(mesh):
    return np.asarray(mesh.positions)[np.asarray(mesh.triangles)]


def check_room(device):
    """No sun shines into a room in which a box with smooth normals is near the walls."""
    room = sv.Mesh(positions=triangles_of(shapes.box((-1, -1, -1), (1, 1, 1)))[:, ::-1].reshape(-1, 3))
    box = smooth(triangles_of(shapes.box((0, -0.98, 0), (0.98, 0, 0.98))))
    instances = [sv.Instance(mesh, sv.Material(base_color=1.0, reflectance=0.0)) for mesh in (room, box)]
    suns = [
        sv.DirectionalLight(side * np.array((0.3, 1, 0.2)), illuminance=1e6, angular_diameter=np.pi) for side in (1, -1)
    ]
    camera = sv.Camera.look_at((-0.8, 0.9, -0.7), (0.8, -0.9, 0.8), vertical_fov=2.2, near=1e-6)
    lit = (traced(device, sv.Scene(*instances, *suns, camera)) > 0).sum()
    assert lit == 0, f"light in {lit} pixels"


def test_a_room_is_light_tight(device):
    check_room(device)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "rays start on the facets": (
            lambda device: check_balls(device, (traced,)),
            Bug("scene/surface.glsl", "find_lift", "return 0.0;"),
        ),
        "lifts over any edge": (
            check_room,
            Bug("scene/surface.glsl", "find_lift", "return 0.5 * MAX_LIFT * sqrt(point.area);"),
        ),
        "pixels have no lift": (
            lambda device: check_balls(device, (framed,)),
            Bug("passes/gbuffer/gbuffer.glsl", "pack_halves_up", "return correct(low, 0.0);"),
        ),
    },
    quick=("rays start on the facets",),
)
