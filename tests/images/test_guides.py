"""Guide buffers: of ordinary surfaces as the path tracer sees them, and behind mirrors by analytic geometry."""

from __future__ import annotations

import numpy as np
import pytest
from specular_frames import GuideRenderer

import solari_vk as sv
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, matte, place, rgb
from solari_vk.scene.matrices import transform_directions, transform_points
from solari_vk.scene.model import Camera, Instance, Material, Scene

SIZE = (64, 48)
PIXEL = 1 / 16  # how far off a motion vector may be
MIRROR = Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")
PAINT = Material(base_color=rgb((0.25, 0.5, 0.75)), perceptual_roughness=0.6, name="paint")


@pytest.fixture
def guides(device):
    """guides(scene, **settings) -> GuideRenderer, closed when the test ends."""
    made = []

    def make(scene, size=SIZE, **settings):
        made.append(GuideRenderer(device, scene, size, sv.Settings(gbuffer="traced", jitter=False, **settings)))
        return made[-1]

    yield make
    for renderer in made:
        renderer.close()


# ---- analytic pictures ------------------------------------------------------------------------------


def project(camera, points, size=SIZE):
    """uv (..., 2) of world positions, and their depth along the view axis."""
    rotation, position = camera.transform[:3, :3], camera.transform[:3, 3]
    view = (points - position) @ rotation
    tangent = np.tan(camera.vertical_fov / 2) * np.array((size[0] / size[1], 1.0))
    return 0.5 + np.array((0.5, -0.5)) * view[..., :2] / (tangent * -view[..., 2:]), -view[..., 2]


def rays(camera, size=SIZE):
    """Directions (h, w, 3) through the middles of the pixels."""
    x, y = np.meshgrid((np.arange(size[0]) + 0.5) / size[0], (np.arange(size[1]) + 0.5) / size[1])
    tangent = np.tan(camera.vertical_fov / 2) * np.array((size[0] / size[1], 1.0))
    view = np.stack([(2 * x - 1) * tangent[0], (1 - 2 * y) * tangent[1], -np.ones_like(x)], axis=-1)
    return transform_directions(camera.transform, view)


def householder(point, normal):
    """World from world (4, 4): the reflection in a plane."""
    n = np.asarray(normal, float) / np.linalg.norm(normal)
    m = np.eye(4)
    m[:3, :3] -= 2 * np.outer(n, n)
    m[:3, 3] = 2 * n * (n @ point)
    return m


def turn(axis, angle):
    """Rotation (4, 4) about a coordinate axis."""
    a, b = [i for i in range(3) if i != axis]
    m = np.eye(4)
    m[a, a] = m[b, b] = np.cos(angle)
    m[a, b], m[b, a] = -np.sin(angle), np.sin(angle)
    return m


def expected_motion(camera, previous_camera, chain, previous_chain, placed, previous_placed):
    """For a rectangle in the xy plane of object space, seen over chains of mirrors: motion (h, w, 2) in pixels, depth,
    and where it is seen."""
    virtual = chain @ placed
    origin, directions = camera.transform[:3, 3], rays(camera)
    point, normal = virtual[:3, 3], np.cross(virtual[:3, 0], virtual[:3, 1])
    t = ((point - origin) @ normal) / (directions @ normal)
    positions = origin + directions * t[..., None]
    inside = transform_points(np.linalg.inv(virtual), positions)
    before = transform_points(previous_chain @ previous_placed, inside)
    uv, depth = project(camera, positions)
    previous_uv, _ = project(previous_camera, before)
    seen = (np.abs(inside[..., :2]) < 0.98).all(axis=-1) & (t > 0)
    return (previous_uv - uv) * SIZE, depth, seen


# ---- ordinary surfaces ------------------------------------------------------------------------------


@pytest.mark.parametrize("scene_name", ["cornell_box", "sphere_grid"])
def test_guides_of_ordinary_surfaces_are_the_path_tracers(guides, device, scene_name):
    """With replacement off, mirrors too; within what the G-buffer and these formats keep."""
    scene = builtin(scene_name)
    frame = guides(scene, primary_surface_replacement=False).render(scene.camera)
    tracer = sv.PathTracer(device, scene, SIZE)
    try:
        tracer.render(scene.camera, samples=1)
        albedo, normal = tracer["albedo"], tracer["shading_normal"]
        roughness, metallic = np.moveaxis(tracer["roughness_metallic"], -1, 0)
        depth = tracer["depth"]
    finally:
        tracer.close()
    there = np.isfinite(depth)
    diffuse = frame["guides/diffuse_albedo"][..., :3] / 255
    np.testing.assert_allclose(diffuse[there], (albedo * (1 - metallic)[..., None])[there], atol=0.004)
    made = frame["guides/normal_roughness"].astype(float)
    np.testing.assert_allclose(made[..., :3][there], normal[there], atol=0.002)
    np.testing.assert_allclose(made[..., 3][there], roughness[there], atol=0.0025)
    np.testing.assert_allclose(np.squeeze(frame["guides/depth"])[there], scene.camera.near / depth[there], rtol=1e-5)
    assert (diffuse[~there] == 0).all()
    assert (np.squeeze(frame["guides/depth"])[~there] == 0).all()


def test_specular_albedo_is_the_directional_albedo(guides):
    """Of a white metal 1 at every angle and roughness, of a smooth dielectric Fresnel's (Schlick)."""
    scene = Scene()
    camera = Camera.look_at((0, 1.0, 4), (0, 0, 0), vertical_fov=0.6)
    for column in range(4):
        white = Material(base_color=rgb(1.0), metallic=1.0, perceptual_roughness=(0.1, 0.3, 0.6, 1.0)[column])
        floor = shapes.quad((column - 1.5, 0, 0.5), (0, 0, 0.5), (0.5, 0, 0))
        scene.add(Instance(mesh=floor, material=white))
        glass = Material(base_color=rgb(0.0), perceptual_roughness=0.0, reflectance=rgb(0.25 + 0.25 * column))
        floor = shapes.quad((column - 1.5, 0, -0.5), (0, 0, 0.5), (0.5, 0, 0))
        scene.add(Instance(mesh=floor, material=glass))
    frame = guides(scene).render(camera)
    made = frame["guides/specular_albedo"][..., 0] / 255
    directions = rays(camera)
    positions = camera.transform[:3, 3] - directions * (camera.transform[1, 3] / directions[..., 1])[..., None]
    cosine = -directions[..., 1] / np.linalg.norm(directions, axis=-1)
    on_floor = np.abs(positions[..., 0]) < 1.99
    metal = on_floor & (np.abs(positions[..., 2] - 0.5) < 0.49)
    assert np.ptp(cosine[metal]) > 0.02
    np.testing.assert_allclose(made[metal], 1.0, atol=0.01)
    glass = on_floor & (np.abs(positions[..., 2] + 0.5) < 0.49)
    f0 = 0.16 * (0.25 + 0.25 * np.clip(np.floor(positions[..., 0] + 2), 0, 3)) ** 2
    np.testing.assert_allclose(made[glass], (f0 + (1 - f0) * (1 - cosine) ** 5)[glass], atol=0.004)


# ---- mirrors ----------------------------------------------------------------------------------------


def check_motion_in_mirrors(guides, mirrors, previous_mirrors, placed, previous_placed, camera, previous_camera):
    """A painted square over a chain of mirrors (the first is the camera's), all given by their placements."""
    scene = Scene()
    square = shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    panes = [scene.add(Instance(mesh=square, material=MIRROR, transform=m)) for m in previous_mirrors]
    paint = Material(base_color=PAINT.base_color, perceptual_roughness=0.6, double_sided=True)
    painted = scene.add(Instance(mesh=square, material=paint, transform=previous_placed))
    renderer = guides(scene)
    renderer.render(previous_camera)
    for pane, transform in zip(panes, mirrors, strict=True):
        pane.update(transform=transform)
    painted.update(transform=placed)
    frame = renderer.render(camera)

    def chain(placements):
        matrix = np.eye(4)
        for m in placements:
            matrix = matrix @ householder(m[:3, 3], np.cross(m[:3, 0], m[:3, 1]))
        return matrix

    motion, depth, seen = expected_motion(
        camera, previous_camera, chain(mirrors), chain(previous_mirrors), placed, previous_placed
    )
    diffuse = frame["guides/diffuse_albedo"][..., :3] / 255
    shown = seen & np.isclose(diffuse, PAINT.base_color, atol=0.01).all(axis=-1)
    assert shown.sum() > 100, "the square must be seen in the mirror"
    made = frame["guides/specular_motion"].astype(float) * SIZE
    error = np.linalg.norm(made - motion, axis=-1)[shown]
    assert error.max() < PIXEL, f"{error.max():.3f} pixels of {np.linalg.norm(motion, axis=-1)[shown].max():.1f}"
    np.testing.assert_allclose(np.squeeze(frame["guides/depth"])[shown], (camera.near / depth)[shown], rtol=2e-3)
    normal = (chain(mirrors) @ placed)[:3, 2]
    made = frame["guides/normal_roughness"].astype(float)[shown]
    facing = np.sign(made[:, :3] @ normal)[:, None]
    np.testing.assert_allclose(made[:, :3], facing * normal / np.linalg.norm(normal), atol=0.002)
    np.testing.assert_allclose(made[:, 3], 0.6, atol=0.003)
    return np.linalg.norm(motion, axis=-1)[shown].max()


CAMERA = Camera.look_at((0.4, 0.3, 3.0), (0, 0, 0), vertical_fov=0.5)
MOVED_CAMERA = Camera.look_at((0.3, 0.35, 3.05), (0.05, 0, 0), vertical_fov=0.5)
PANE = place((2.0, 1.5, 1.0), at=(0.0, 0.0, -0.4))
BEHIND = place((1.2, 0.9, 1), at=(0.2, 0.1, 4.0), turn=0.3)
MOVED_BEHIND = place((1.2, 0.9, 1), at=(0.35, 0.2, 4.1), turn=0.4)
MOVED_PANE = place((2.0, 1.5, 1.0), at=(0.02, 0.0, -0.5)) @ turn(1, 0.03)
# One mirror at 45 degrees throws the view to the left, and a second one there throws it forwards again.
SLANTED = place((2.0, 2.0, 1.0)) @ turn(1, np.pi / 4)
FACING = place((2.0, 2.0, 1.0), at=(-4.0, 0.0, 0.0)) @ turn(1, 1.25 * np.pi) @ turn(0, 0.05)
OVER_TWO = place((1.2, 0.9, 1), at=(-4.2, 0.1, -3.0), turn=0.2)
MOVED_OVER_TWO = place((1.2, 0.9, 1), at=(-4.0, 0.0, -3.1), turn=0.1)
MOTIONS = {
    "nothing moves": ([PANE], [PANE], BEHIND, BEHIND, CAMERA, CAMERA),
    "the camera moves": ([PANE], [PANE], BEHIND, BEHIND, MOVED_CAMERA, CAMERA),
    "the object moves": ([PANE], [PANE], MOVED_BEHIND, BEHIND, CAMERA, CAMERA),
    "the mirror moves": ([MOVED_PANE], [PANE], BEHIND, BEHIND, CAMERA, CAMERA),
    "all move": ([MOVED_PANE], [PANE], MOVED_BEHIND, BEHIND, MOVED_CAMERA, CAMERA),
    "object over two mirrors": ([SLANTED, FACING], [SLANTED, FACING], MOVED_OVER_TWO, OVER_TWO, CAMERA, CAMERA),
    "camera over two mirrors": ([SLANTED, FACING], [SLANTED, FACING], OVER_TWO, OVER_TWO, MOVED_CAMERA, CAMERA),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motion_in_flat_mirrors(guides, name):
    moved = check_motion_in_mirrors(guides, *MOTIONS[name])
    assert (moved > 1.0) == (name != "nothing moves"), f"moves by {moved:.2f} pixels"


MUTANTS = {
    "hits don't move": ("mirrors.glsl", "weights.x * mesh.positions.at[corners.x]", "0.0 * world_position", "all move"),
    "mirrors don't move": ("mirrors.glsl", "previous.id != instance.id", "true", "the mirror moves"),
    "normals don't turn": ("mirrors.glsl", "cofactors * object_normal", "mirror.normal", "all move"),
    "chain in the wrong order": (
        "mirrors.glsl", "mat3(chain) * householder", "householder * mat3(chain)", "object over two mirrors"
    ),
    "planes through the origin": ("mirrors.glsl", "mat3(chain) * moved + chain[3]", "chain[3]", "the camera moves"),
    "no reflection in the motion": (
        "write.comp", "previous_chain * vec4(previous_position, 1.0)", "previous_position", "the object moves"
    ),
}  # fmt: skip


QUICK = "chain in the wrong order"


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n != QUICK else []) for n in MUTANTS])
def test_a_seeded_bug_is_noticed(guides, name):
    file, old, new, proof = MUTANTS[name]
    with patched_shaders((f"passes/guides/{file}", old, new)), pytest.raises(AssertionError):
        check_motion_in_mirrors(guides, *MOTIONS[proof])


def test_an_empty_sky_in_a_mirror_turns_with_the_camera(guides):
    """What is infinitely far doesn't move with the camera's place, only with its turn; and has no depth or albedo."""
    scene = Scene(Instance(mesh=shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), material=MIRROR))
    renderer = guides(scene)
    near = Camera.look_at((0, 0, 2), (0, 0, 0), vertical_fov=0.9)
    moved = Camera.look_at((0.2, 0.1, 2), (0.2, 0.1, 0), vertical_fov=0.9)
    turned = Camera.look_at((0.2, 0.1, 2), (0.3, 0.1, 0), vertical_fov=0.9)
    renderer.render(near)
    frame = renderer.render(moved)
    assert np.abs(frame["guides/specular_motion"].astype(float) * SIZE).max() < PIXEL
    assert (frame["guides/depth"] == 0).all()
    assert (frame["guides/diffuse_albedo"][..., :3] == 0).all()
    assert np.abs(frame["guides/motion"].astype(float) * SIZE).max() > 1.0
    frame = renderer.render(turned)
    assert np.abs(frame["guides/specular_motion"].astype(float)[..., 0] * SIZE[0]).min() > 1.0


def test_without_replacement_mirrors_describe_themselves(guides):
    scene = Scene(
        Instance(mesh=shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), material=MIRROR),
        Instance(mesh=shapes.quad((0, 0, 4), (0, 2, 0), (2, 0, 0)), material=matte(0.5)),
    )
    camera = Camera.look_at((0, 0, 2), (0, 0, 0), vertical_fov=0.9)
    frame = guides(scene, primary_surface_replacement=False).render(camera)
    np.testing.assert_allclose(
        frame["guides/normal_roughness"].astype(float), np.broadcast_to((0, 0, 1, 0), (48, 64, 4))
    )
    np.testing.assert_allclose(np.squeeze(frame["guides/depth"]), camera.near / 2, rtol=1e-5)
