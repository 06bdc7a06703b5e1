"""Rays by queries, pipelines and compute shaders give the same pictures bit by bit on lavapipe; tests see if not."""

from __future__ import annotations

import importlib.util
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from support.frames import each_lighting, make_renderer, snapshot
from support.scenes import bent_joints, tube
from support.seeded_bugs import GLSL, Bug, expect_noticed, seeded

import solari_vk as sv
from solari_vk.bound import flat_instances
from solari_vk.gpu.device.rays import RAYS
from solari_vk.gpu.trees import tree
from solari_vk.lab.measure.portals import window_room
from solari_vk.lab.structures import random_rotation
from solari_vk.scene.builtin import place

OCCLUSION = Path(__file__).resolve().parents[3] / "docs/examples/bake_occlusion.py"
SCENES = {
    "cornell_box": {},
    "closed_box": {},
    "many_lights": {"box_count": 60, "sphere_count": 9},
    "mirror_hall": {},
    "thin_wall": {},
    "sphere_grid": {},
    "shiny_floor": {},
    "polished_floor": {},
    "lamp_gap": {},
    "rooms": {"columns": 2, "rows": 1},
    "a room with a portal": None,
}
SIZE = (24, 16)


@pytest.fixture(scope="module")
def devices(any_device):
    """A device for each way to trace rays, with validation."""
    with ExitStack() as opened:
        yield {way: opened.enter_context(sv.Device(validation=True, rays=way)) for way in RAYS}


def differing(pictures):
    """The arrays that differ from those by queries; `pictures` makes the arrays of a way by name."""
    found = {way: pictures(way) for way in RAYS}
    query = found["query"]
    assert all(arrays.keys() == query.keys() for arrays in found.values())
    return [(way, name) for way in found for name in query if found[way][name].tobytes() != query[name].tobytes()]


def frames_of(renderer, camera, count):
    """All outputs of some frames by name and number."""
    taken = [snapshot(renderer.render(camera)) for _ in range(count)]
    assert renderer["world_cache/insert_failures"] == 0  # else the order of threads would matter
    return {f"{name} {at}": array for at, frame in enumerate(taken) for name, array in frame.items()}


def check_frames(devices, name, **settings):
    def pictures(way):
        arguments = SCENES[name]
        scene = window_room(sv.Sky(), with_portal=True) if arguments is None else sv.builtin(name, **arguments)
        with make_renderer(devices[way], scene, SIZE, seed=5, **{"gbuffer": "raster", **settings}) as renderer:
            found = frames_of(renderer, scene.camera, 3)
        with sv.PathTracer(devices[way], scene, SIZE, seed=5) as tracer:
            frame = tracer.render(scene.camera, samples=2)
            return found | {f"path tracer: {name}": frame[name].copy() for name in tracer.OUTPUTS}

    assert not differing(pictures)


@pytest.mark.parametrize(
    ("renderer", "worlds"), [("reference", 1), ("reference", 2), pytest.param("realtime", 1, marks=pytest.mark.slow)]
)
def test_batches_are_equal(devices, renderer, worlds):
    def pictures(way):
        scene = sv.builtin("cornell_box")
        cameras = [scene.camera, sv.Camera.look_at((1, 1.2, -2.5), (1, 1, 0))]
        options = {"renderer": renderer, "worlds": worlds, "outputs": sv.Batch.OUTPUTS}
        with sv.Batch(devices[way], scene, SIZE, 2, **options) as batch:
            if worlds > 1:
                block = batch.transforms["short block"]
                block[1, 1, 3] += 0.3
                batch.transforms["short block"] = block
            samples = {"samples": 2} if renderer == "reference" else {}
            batch.render(cameras, **samples)
            batch.render(cameras[::-1], **samples)
            return {name: batch[name] for name in batch}

    assert not differing(pictures)


def test_frames_and_paths_are_equal(devices):
    check_frames(devices, "cornell_box")


@pytest.mark.slow
@each_lighting
@pytest.mark.parametrize("name", SCENES)
def test_frames_and_paths_of_all_scenes_are_equal(devices, name, lighting):
    check_frames(devices, name, **lighting)


@pytest.mark.slow  # the driver compiles all pipelines anew, because their layout has no images of the drawn G-buffer
def test_frames_with_a_traced_gbuffer_are_equal(devices):
    check_frames(devices, "mirror_hall", gbuffer="traced")


@pytest.mark.slow
def test_frames_stay_equal_after_edits_resizes_and_reloads(devices):
    def pictures(way):
        scene = sv.builtin("cornell_box")
        with make_renderer(devices[way], scene, SIZE, seed=5, gbuffer="raster") as renderer:
            found = {"first": frames_of(renderer, scene.camera, 2)}
            box = scene.instances["tall block"]
            box.transform = box.transform @ place(0.8, (0.1, 0.2, 0))
            scene.materials["white"].base_color = (0.2, 0.7, 0.3)
            scene.add(sv.Instance(mesh=sv.shapes.sphere(0.2), material=sv.Material(emissive=(4, 2, 1))))
            found["edited"] = frames_of(renderer, scene.camera, 2)
            renderer.resize((20, 25))
            found["resized"] = frames_of(renderer, scene.camera, 2)
            with seeded(Bug("passes/world_cache/update.glsl", "seed_cell_rng", "return 1u + correct(cell, salt);")):
                renderer.reload()
                found["reloaded"] = frames_of(renderer, scene.camera, 2)
            renderer.reload()
            found["restored"] = frames_of(renderer, scene.camera, 1)
        parts = list(found.values())
        assert all(one["paths_diffuse 0"].tobytes() != two["paths_diffuse 0"].tobytes() for one, two in pairwise(parts))
        return {f"{part}: {name}": array for part, arrays in found.items() for name, array in arrays.items()}

    assert not differing(pictures)


# ---- single rays, and bugs ---------------------------------------------------------------------------


def single_rays(device):
    """Hits of rays from numpy, by `trace_closest_hit`, and occlusion by a user's shader, by `trace_visibility`."""
    scene, rng = sv.builtin("cornell_box"), np.random.default_rng(3)
    low, high = scene.bounds
    origins = rng.uniform(low - 0.5, high + 0.5, (500, 3))
    directions = rng.normal(size=(500, 3))
    with sv.RayTracer(device, scene) as tracer:
        closest = tracer.trace(origins, directions)
        blocked = tracer.trace(origins, directions, t_max=0.7, any_hit=True)["instance"] >= 0
    spec = importlib.util.spec_from_file_location("bake_occlusion", OCCLUSION)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    openness = np.concatenate(example.bake(device, scene, samples=8, reach=0.7))
    assert 0.1 < np.isfinite(closest["t"]).mean() < 0.9
    assert 0.1 < closest["front_face"].mean() < 0.9
    assert 0.1 < blocked.mean() < 0.9
    assert 0.1 < openness.mean() < 0.9
    return {**{name: closest[name].copy() for name in closest.dtype.names}, "blocked": blocked, "openness": openness}


@pytest.fixture(scope="module")
def by_queries(devices):
    """What `single_rays` gives by queries."""
    return single_rays(devices["query"])


@pytest.mark.parametrize("way", ["pipeline", "compute"])
def test_single_rays_are_equal(devices, by_queries, way):
    found = single_rays(devices[way])
    assert not [name for name, array in by_queries.items() if array.tobytes() != found[name].tobytes()]


def animated_hits(device):
    """Hits of random rays in each frame of a tube that bends, and grows by a half once."""
    mesh, rest = tube(targets=1)
    instance = sv.Instance(mesh=mesh, material=sv.Material(), joint_matrices=rest * 0 + np.eye(4), morph_weights=[0])
    scene, rng = sv.Scene(instance), np.random.default_rng(5)
    origins, aims = (rng.uniform((-1.5, -0.5, -1.5), (1.5, 2.5, 1.5), (300, 3)) for _ in range(2))
    found = []
    with sv.RayTracer(device, scene) as tracer:
        for frame in range(40):
            instance.joint_matrices = bent_joints(rest, 0.03 * frame) * (1 if frame < 20 else 1.6)
            instance.morph_weights = [np.sin(frame)]
            found.append(tracer.trace(origins, aims - origins))
    assert 0.05 < np.mean([np.isfinite(hits["t"]).mean() for hits in found]) < 0.9
    return np.concatenate(found)


def hits_of_placed_instances(device):
    """Hits of random rays at balls that are turned, mirrored, sheared, scaled and flattened."""
    rng, ball, scene = np.random.default_rng(9), sv.shapes.sphere(0.6, 8), sv.Scene()
    for number in range(300):
        linear = random_rotation(rng)
        if number % 3 == 0:
            linear = linear @ np.diag(10.0 ** rng.uniform(-1.5, 0.2, 3) * rng.choice((-1, 1), 3))
        elif number % 3 == 1:
            linear = rng.normal(size=(3, 3))
        if number % 50 == 0:
            linear[:, 1] = 0
        placed = np.eye(4)
        placed[:3] = np.append(linear, rng.uniform(-5, 5, (3, 1)), axis=1)
        scene.add(sv.Instance(mesh=ball, material=sv.Material(), transform=placed))
    with sv.RayTracer(device, scene) as tracer:
        hits = tracer.trace(rng.uniform(-6, 6, (20_000, 3)), rng.normal(size=(20_000, 3)))
        is_flat = device.rays == "compute" and flat_instances.MAX_TRIANGLES > 0
        assert (getattr(tracer.binder.tlas, "flat_tree", None) is not None) == is_flat
    assert 0.3 < np.isfinite(hits["t"]).mean() < 0.7
    return hits


def hits_in_two_levels(device):
    """The same without a tree of static instances."""
    with mock.patch.object(flat_instances, "MAX_TRIANGLES", 0):
        return hits_of_placed_instances(device)


def hits_of_fine_meshes(device):
    """Balls of 5 cm with triangles of a millimeter, up to a kilometer from the origin, and a ground."""
    rng = np.random.default_rng(2)
    scene = sv.Scene(sv.Instance(mesh=sv.shapes.plane(10), material=sv.Material()))
    scene.origin = 0, 0, 0
    centers = np.array([(1, 0, 0), (30, 2, 1), (-7, 100, 3), (5, 400, -1000)])
    for center in centers:
        scene.add(sv.Instance(mesh=sv.shapes.sphere(0.05, 64), material=sv.Material(), position=center))
    aims = centers[rng.integers(0, len(centers), 20_000)] + rng.uniform(-0.05, 0.05, (20_000, 3))
    directions = rng.normal(size=aims.shape)
    with sv.RayTracer(device, scene) as tracer:
        return tracer.trace(aims - directions, directions)


@pytest.mark.parametrize("traced", [animated_hits, hits_of_placed_instances, hits_in_two_levels, hits_of_fine_meshes])
def test_hits_by_compute_are_those_of_queries(devices, traced):
    query, compute = (traced(devices[way]) for way in ("query", "compute"))
    assert [name for name in query.dtype.names if query[name].tobytes() != compute[name].tobytes()] == []


def test_hits_by_pairs_of_floats(devices, monkeypatch):
    """As devices without 64-bit numbers have them: the same triangles, at distances that differ by a rounding."""
    monkeypatch.setenv("SOLARI_VK_HIDDEN_FEATURES", "shaderFloat64")
    with sv.Device(validation=True, rays="compute") as device:
        assert device.lacking == ("WITHOUT_DOUBLES",)
        for traced in (animated_hits, hits_of_placed_instances, hits_in_two_levels, hits_of_fine_meshes):
            query, pairs = traced(devices["query"]), traced(device)
            for name in ("instance", "primitive", "front_face"):
                np.testing.assert_array_equal(pairs[name], query[name])
            np.testing.assert_allclose(pairs["t"], query["t"], rtol=1.3e-7)


TRACE = "scene/trace_compute.glsl"


def changed_line(function, line, other):
    """A bug in one line of a long function of the traversal."""
    source = (GLSL / TRACE).read_text(encoding="utf-8")
    start = source.index("{", source.index(f" {function}(")) + 1
    body = source[start : source.index("\n}", start)]
    assert body.count(line) == 1, f"{function} has {body.count(line)} times {line}"
    return Bug(TRACE, function, body.replace(line, other))


BUGS = {
    "faces forgotten": Bug("scene/trace.rchit", "main", "correct(); ray_payload.instance |= 1u;"),
    "misses are hits": Bug("scene/trace.rmiss", "main", "ray_payload.instance = 0u;"),
}
BUGS_BY_COMPUTE = {
    "a box is missed": Bug(TRACE, "meets_box", "return correct(ray, low, high, t_min, t_max, near) && near > 0.01;"),
    "triangles are closed at two edges": Bug(
        TRACE, "meets_triangle", "return correct(ray, triangle, found, front_face) && found.y > 0.01;"
    ),
    "faces are forgotten": Bug(
        TRACE, "resolve_hit", "bool met = correct(ray, triangle, found, front_face); front_face = true; return met;"
    ),
    "a child is skipped": changed_line("next_leaf", "if (meets_first && meets_second)", "if (false)"),
    "t isn't shortened": changed_line("traverse_flat", "FlatHit(found.x,", "FlatHit(hit.t,"),
    "a stack of two children": changed_line(
        "next_leaf", "waiting[top++] = second_is_nearer", "if (top > 2u) { top--; } waiting[top++] = second_is_nearer"
    ),
    "a leaf is read one short": changed_line("traverse_flat", ">> LEAF_COUNT_SHIFT) + 1u;", ">> LEAF_COUNT_SHIFT);"),
    "in two levels, t isn't shortened": changed_line("traverse", "t_max = found.x;", ""),
    "in two levels, a leaf is read one short": changed_line(
        "traverse", ">> LEAF_COUNT_SHIFT) + 1u;", ">> LEAF_COUNT_SHIFT);"
    ),
    "transforms are inverted in another order": Bug(
        "scene/trees/primitives.glsl", "inverse_by_elimination", "return inverse(matrix);"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*BUGS, *BUGS_BY_COMPUTE])
def test_a_seeded_bug_is_noticed(devices, by_queries, name):
    if name in BUGS:
        expect_noticed(BUGS[name], name, test_single_rays_are_equal, devices, by_queries, "pipeline")
        return
    tree._kernels.clear()  # which know shaders without the bug
    check = test_hits_by_compute_are_those_of_queries
    try:
        traced = hits_in_two_levels if name.startswith("in two levels") else hits_of_placed_instances
        expect_noticed(BUGS_BY_COMPUTE[name], name, check, devices, traced)
    finally:
        tree._kernels.clear()
