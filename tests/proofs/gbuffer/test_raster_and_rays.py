"""The G-buffer: raster against rays, motion vectors against the scene's motion, culling on against off.

Each with cameras in perspective and orthographic ones.
"""

from __future__ import annotations

import dataclasses
import math
from contextlib import ExitStack

import numpy as np
import pytest
from gbuffer_worlds import WALLS, material_zoo, turned, turned_rigidly, walled
from oracles.encodings import GBUFFER_IMAGES, decode_gbuffer
from oracles.rays import camera_rays, project, world_positions
from support.frames import GBUFFER, GUIDES, get_jitter, make_renderer, path_traced
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.passes.gbuffer import COUNTERS
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, matte, place
from solari_vk.scene.matrices import transform_points

SIZE = (96, 64)
# The largest difference of packed values that rounding to either neighboring code can cause.
TOLERANCES = {
    "color": 4e-3,
    "perceptual_roughness": 1.01 / 255,
    "emissive": 0.02,
    "metallic": 1.01 / 255,
    "normal": 2e-3,
    "geometric_normal": 1e-4,
    "motion": 1e-6,
    "reflectance": 0.0,
    "instance": 0.0,
}
OFFSET = {"principal_point": (0.8, -0.1), "pixel_aspect": 1.3}  # of the picture
ORTHOGRAPHIC = (0.0, 3.4)  # heights of what cameras see; 0 in perspective


def zoo(orthographic_height=0.0):
    scene = material_zoo()
    scene.camera.orthographic_height = orthographic_height
    return scene


# ---- raster and rays --------------------------------------------------------------------------------


def neighbors_alike(values):
    """Where all 3x3 pixels around one have the same value (h, w)."""
    rows = np.pad(values, 1, mode="edge")
    height, width = values.shape
    shifts = [rows[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.all([shift == values for shift in shifts], axis=0)


def check_raster(device, scene):
    """All values of the raster G-buffer and the traced one agree: inside triangles, and at edges within a pixel."""
    found = []
    for way in ("raster", "traced"):
        with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
            found.append(decode_gbuffer(renderer.render(scene.camera)))
    raster, traced = found
    differs = np.abs(raster["depth"] - traced["depth"]) > 3e-5 * traced["depth"]
    for name, tolerance in TOLERANCES.items():
        apart = np.abs(raster[name] - traced[name])
        differs |= (apart.reshape(*differs.shape, -1) > tolerance).any(axis=-1)
    # Raster snaps vertices to a grid within the pixel, so that a pixel's center may lie on either side of an edge.
    normals = np.round(traced["geometric_normal"] * 500).astype(np.int64) @ (1, 1 << 12, 1 << 24)
    inside = neighbors_alike(traced["instance"] << 40 | normals)
    assert inside.mean() > 0.2
    assert not differs[inside].any()
    assert differs.mean() < 0.01


# ---- motion -----------------------------------------------------------------------------------------


def check_motion(device, way="raster", orthographic_height=0.0):
    """Motion vectors follow the camera and moving instances within 1/16 of a pixel, while both move, turn and scale,
    with jitter and mirrored instances."""
    random, scene = np.random.default_rng(4), material_zoo()
    scene.add(sv.Instance(mesh=shapes.sphere(0.2, 12), material=matte(0.3), transform=place(1.0, (0, 0.5, 0.5))))
    *moving, _, _ = scene.instances
    camera = dataclasses.replace(scene.camera, orthographic_height=orthographic_height)
    worst = 0.0
    largest = 0.0
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        renderer.render(camera)
        for _ in range(4):
            before, previous = {instance: instance.transform for instance in scene.instances}, camera
            for instance in moving:
                instance.transform = turned(instance.transform, random, 0.1, 0.05)
            pose = turned_rigidly(camera.transform, random, 0.03, 0.1)
            zoom = random.uniform(0.95, 1.05)
            camera = sv.Camera(
                transform=pose,
                vertical_fov=camera.vertical_fov * zoom,
                orthographic_height=camera.orthographic_height * zoom,
            )
            found = decode_gbuffer(renderer.render(camera))
            world = world_positions(camera, found["depth"], get_jitter(renderer))
            was = world.copy()
            # The background is infinitely far away; in parallel projections it has one color and doesn't move.
            background = found["depth"] == 0
            was[background] += previous.transform[:3, 3] - pose[:3, 3]
            for row, instance in renderer.binder.instances.items():
                here, step = found["instance"] == row, before[instance] @ np.linalg.inv(instance.transform)
                was[here] = transform_points(step, world[here])
            expected = project(previous, was) - project(camera, world)
            expected[background & (orthographic_height > 0)] = 0
            worst = max(worst, float(np.abs(found["motion"] * SIZE - expected).max()))
            largest = max(largest, float(np.abs(expected).max()))
    print(f"off by {worst:.4f} pixels; the fastest moves by {largest:.1f}")
    assert largest > 5
    assert worst < 1 / 16


def check_still(device, way="traced"):
    """What rests has no motion, also seen in mirrors: surfaces under random transforms, seen twice from each place."""
    random = np.random.default_rng(6)
    for scene in (material_zoo(), builtin("mirror_hall")):
        for instance in scene.instances:
            instance.transform = turned(instance.transform, random, 0.2, 0.2)
        with make_renderer(device, scene, SIZE, passes=GUIDES, gbuffer=way, jitter=True) as renderer:
            for _ in range(4):
                pose = turned_rigidly(scene.camera.transform, random, 0.1, 0.3)
                camera = dataclasses.replace(scene.camera, transform=pose)
                renderer.render(camera)
                frame = renderer.render(camera)
                for image in ("motion_vectors", "guides_specular_motion"):
                    assert not frame[image].any()


# ---- culling ----------------------------------------------------------------------------------------

VARIANTS = {
    "none": {"gbuffer": "raster", "frustum_culling": False, "occlusion_culling": False},
    "frustum": {"gbuffer": "raster", "occlusion_culling": False},
    "occlusion": {"gbuffer": "raster", "frustum_culling": False},
    "both": {"gbuffer": "raster"},
}


def change(scene, random, number):
    """Move some instances. In some frames also replace one, so that the new one gets its row, or hide or show one."""
    instances = list(scene.instances)
    for _ in range(5):
        moved = instances[random.integers(WALLS, len(instances))]
        moved.transform = turned(moved.transform, random, 0.5, 0.5)
    if number % 4 == 3:
        gone = instances[WALLS]
        scene.remove(gone)
        scene.add(sv.Instance(mesh=gone.mesh, material=gone.material, transform=gone.transform))
        instances[-1].visible = not instances[-1].visible


def check_culling(device, orthographic_height=0.0, **lens):
    """Culling changes no pixel while a camera moves and jumps among walls, and instances move, appear and disappear.
    Each visible instance is counted once: drawn, or culled for one reason."""
    frame_count, random = 32, np.random.default_rng(5)
    scene = walled(random)
    binder = SceneBinder(device, scene)
    sums = np.zeros(len(COUNTERS), int)
    eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
    with ExitStack() as opened:
        opened.callback(binder.destroy)
        renderers = {
            name: opened.enter_context(make_renderer(device, binder, (88, 54), passes=GBUFFER, **chosen))
            for name, chosen in VARIANTS.items()
        }
        for number in range(frame_count):
            eye, target = (at + random.uniform(-0.2, 0.2, 3) for at in (eye, target))
            if number % 7 == 6:  # a cut: visibility in the previous frame says nothing about this one
                eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
            fov = random.uniform(1.0, 1.6)
            height = orthographic_height * fov
            camera = sv.Camera.look_at(eye, target, vertical_fov=fov, orthographic_height=height, **lens)
            change(scene, random, number)
            visible = sum(instance.visible for instance in scene.instances)
            expected = renderers["none"].render(camera)
            for name, renderer in renderers.items():
                frame = expected if name == "none" else renderer.render(camera)
                for image in GBUFFER_IMAGES:
                    np.testing.assert_array_equal(frame[image], expected[image], err_msg=f"{name} {number}: {image}")
                counts = {counter: int(renderer[f"gbuffer/{counter}"]) for counter in COUNTERS}
                assert sum(counts.values()) == visible
                assert name in ("both", "occlusion") or not counts["occlusion_culled"]
                assert name in ("both", "frustum") or not counts["frustum_culled"]
            sums += list(counts.values())
    assert sums.min() > frame_count, f"{COUNTERS}: {sums}"


# ---- each check holds, and can fail -----------------------------------------------------------------


@pytest.mark.parametrize("height", ORTHOGRAPHIC)
def test_raster_and_rays_agree(device, height):
    check_raster(device, zoo(height))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cornell_box", "sphere_grid", "many_lights", "mirror_hall"])
def test_raster_and_rays_agree_on_other_scenes(device, name):
    check_raster(device, builtin(name))


def test_near_plane_cuts(device):
    """Neither raster nor rays show surfaces in front of the near plane."""
    scene = sv.Scene(sv.Instance(mesh=shapes.sphere(1.0, 24), material=matte(0.5)))
    scene.add(sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=matte(0.2)))
    scene.add(sv.Camera.look_at((0, 0, 1.5), (0, 0, 0), near=0.6, vertical_fov=math.radians(90)))
    check_raster(device, scene)
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer="raster") as renderer:
        shown = decode_gbuffer(renderer.render(scene.camera))["instance"]
    assert shown[32, 48] == 1  # through the sphere, whose inside isn't drawn, to the box
    assert shown[32, 73] == 0


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_motion(device, way):
    for height in ORTHOGRAPHIC:
        check_motion(device, way, height)
    check_still(device, way)


# Not (5.0, OFFSET): that picture has surfaces nearer each other than the depths that raster tells apart.
@pytest.mark.parametrize(("height", "lens"), [(0.0, {}), (5.0, {}), (0.0, OFFSET)])
def test_culling(device, height, lens):
    check_culling(device, height, **lens)


@pytest.mark.parametrize("height", ORTHOGRAPHIC)
def test_an_offset_principal_point(device, height):
    scene = zoo(height)
    scene.camera.update(**OFFSET)
    check_raster(device, scene)


GBUFFER_FILE, CULL, RASTER_FILE = (f"passes/gbuffer/{name}" for name in ("gbuffer.glsl", "cull.comp", "raster.glsl"))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "raster: inside triangles": (
            lambda device: check_raster(device, zoo()),
            Bug(
                RASTER_FILE,
                "intersect_triangle",
                "Hit hit = correct(ray, row, triangle, mesh); hit.barycentrics = hit.barycentrics.yx; return hit;",
            ),
        ),
        "raster: another triangle": (
            lambda device: check_raster(device, zoo()),
            Bug(
                RASTER_FILE, "intersect_triangle", "return correct(ray, row, triangle > 0u ? triangle - 1u : 0u, mesh);"
            ),
        ),
        "orthographic rays from one point": (
            lambda device: check_raster(device, zoo(ORTHOGRAPHIC[1])),
            Bug(
                "scene/camera.glsl",
                "view_ray",
                "ViewRay ray = correct(position, from); ray.origin = vec3(0.0); return ray;",
            ),
        ),
        "motion": (check_motion, Bug(GBUFFER_FILE, "is_mesh_static", "return true;")),
        "rest": (
            check_still,
            Bug(GBUFFER_FILE, "motion_vector", "return correct(world_position, previous_world_position) + 1e-7;"),
        ),
        "frustum culling": (check_culling, Bug(CULL, "is_beyond", "return correct(box, normal, distance - 0.3);")),
        "orthographic culling": (
            lambda device: check_culling(device, 5.0),
            Bug(CULL, "is_beyond", "return correct(box, normal, distance > 0.0 ? 0.5 * distance : distance);"),
        ),
        "occlusion culling": (check_culling, Bug(CULL, "is_occluded", "box.half_axes *= 0.5; return correct(box);")),
        "counts": (check_culling, Bug(CULL, "main", "correct(); atomicAdd(gbuffer_counters.drawn_first, 1u);")),
    }
)


# ---- orthographic cameras ---------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_a_tilted_floor_is_where_it_must_be(device, way):
    """Depths and positions in closed form; the footprint of a pixel doesn't depend on the distance."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (0, 0, 50), (50, 0, 0)), matte(0.5)))
    camera = sv.Camera.look_at((0, 7, 5), (0, 0, 0), orthographic_height=6.0, near=0.5)
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way, jitter=False) as renderer:
        found = decode_gbuffer(renderer.render(camera))
    origins, directions = camera_rays(camera, *SIZE)
    expected = -origins[..., 1] / directions[..., 1]
    np.testing.assert_allclose(camera.near / found["depth"], expected, rtol=1e-5)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        frame = tracer.render(camera, samples=1)
        np.testing.assert_allclose(frame["depth"], expected, rtol=1e-5)
        np.testing.assert_allclose(frame["position"], origins + directions * expected[..., None], atol=1e-4)


@pytest.mark.slow
def test_orthographic_frames_agree_with_the_path_tracer(device):
    """The denoised frame of a still camera, and of one that moves, has the light that the path tracer gives."""
    scene, size = builtin("cornell_box"), (48, 32)
    eye, target = np.array([1, 1, -3.0]), np.ones(3)
    steps = [np.array([0.02, 0.01, 0]) * k for k in range(12)]
    cameras = [sv.Camera.look_at(eye + step, target + step, orthographic_height=2.4) for step in steps]
    truth = path_traced(device, scene, 512, size, cameras[-1], seed=3)
    with sv.Renderer(device, scene, size, seed=4) as renderer:
        for camera in [cameras[0]] * 24 + cameras:
            radiance = renderer.render(camera)["radiance"].copy()
    assert np.isfinite(radiance).all()
    dark = truth.max(axis=2) < 3  # the lamp itself aside
    assert np.abs(radiance[dark].mean() / truth[dark].mean() - 1) < 0.03
    apart = np.abs(radiance - truth).mean(axis=2) / truth[dark].mean()
    assert np.median(apart) < 0.06
    assert np.mean(apart[dark]) < 0.15
