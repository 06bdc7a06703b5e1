"""The G-buffer: raster against rays, motion vectors against the scene's motion, culling on against off."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from gbuffer_worlds import WALLS, material_zoo, turned, turned_rigidly, walled
from numpy.typing import NDArray
from support.measured import hold
from support.oracles import gbuffer
from support.realtime import GBUFFER, GUIDES, get_jitter, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.passes.gbuffer import COUNTERS
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, matte, place
from solari_vk.scene.matrices import transform_points

_GBUFFER = (SUITE, "G-buffer")
INSIDE = Rule("raster and traced G-buffers agree inside triangles", *_GBUFFER)
RASTER = Rule("raster and traced G-buffers agree at edges within a pixel", *_GBUFFER)
MOTION = Rule("motion vectors follow the camera and moving instances", *_GBUFFER)
STILL = Rule("what rests has no motion, also seen in mirrors", *_GBUFFER)
CULLING = Rule("culling drops nothing that is visible", *_GBUFFER)
COUNTED = Rule("each visible instance is counted once: drawn, or culled for one reason", *_GBUFFER)
SIZE = (96, 64)
MAX_MOTION_ERROR = 1 / 16  # pixels
# The largest difference of packed values that rounding to either neighboring code can cause.
_TOLERANCES = {
    "color": 4e-3, "perceptual_roughness": 1.01 / 255, "emissive": 0.02, "metallic": 1.01 / 255, "normal": 2e-3,
    "geometric_normal": 1e-4, "motion": 1e-6, "reflectance": 0.0, "instance": 0.0,
}  # fmt: skip
SCENES = ("material_zoo", "orthographic_zoo", "cornell_box", "sphere_grid")


def make_scene(name: str) -> sv.Scene:
    """A built-in scene, or `material_zoo` before one of two cameras."""
    if not name.endswith("zoo"):
        return builtin(name)
    scene = material_zoo()
    scene.camera.orthographic_height = 3.4 if name == "orthographic_zoo" else 0.0
    return scene


# ---- raster and rays --------------------------------------------------------------------------------


def _neighbors_alike(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Where all 3x3 pixels around one have the same value (h, w)."""
    rows = np.pad(values, 1, mode="edge")
    height, width = values.shape
    shifts = [rows[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.asarray(np.all([shift == values for shift in shifts], axis=0))


def measure_raster(device: Device, scene: sv.Scene, size: tuple[int, int] = SIZE) -> Iterator[Measurement]:
    """Compares all values of the raster G-buffer with the traced one."""
    found = []
    for way in ("raster", "traced"):
        with make_renderer(device, scene, size, passes=GBUFFER, gbuffer=way) as renderer:
            found.append(gbuffer.decode(renderer.render(scene.camera)))
    raster, traced = found
    differs = np.abs(raster["depth"] - traced["depth"]) > 3e-5 * traced["depth"]
    for name, tolerance in _TOLERANCES.items():
        apart = np.abs(raster[name] - traced[name])
        differs |= (apart.reshape(*differs.shape, -1) > tolerance).any(axis=-1)
    # Raster snaps vertices to a grid within the pixel, so that a pixel's center may lie on either side of an edge.
    normals = np.round(traced["geometric_normal"] * 500).astype(np.int64) @ (1, 1 << 12, 1 << 24)
    inside = _neighbors_alike(traced["instance"] << 40 | normals)
    wrong = float(differs[inside].sum()) if inside.mean() > 0.2 else math.inf
    yield Measurement(INSIDE, wrong, 0.0, f"of {inside.sum():,} pixels differ")
    yield Measurement(RASTER, float(differs.mean()), 0.01, "of pixels differ")


# ---- motion -----------------------------------------------------------------------------------------


def measure_motion(device: Device, way: str = "raster", orthographic_height: float = 0.0) -> Iterator[Measurement]:
    """Measures motion vectors while camera and instances move, turn and scale, with jitter and mirrored instances."""
    random, scene = np.random.default_rng(4), material_zoo()
    scene.add(sv.Instance(mesh=shapes.sphere(0.2, 12), material=matte(0.3), transform=place(1.0, (0, 0.5, 0.5))))
    *moving, _, _ = scene.instances
    camera, worst, largest = dataclasses.replace(scene.camera, orthographic_height=orthographic_height), 0.0, 0.0
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        renderer.render(camera)
        for _ in range(4):
            before, previous = {instance: instance.transform for instance in scene.instances}, camera
            for instance in moving:
                instance.transform = turned(instance.transform, random, 0.1, 0.05)
            pose = turned_rigidly(camera.transform, random, 0.03, 0.1)
            zoom = random.uniform(0.95, 1.05)
            camera = sv.Camera(transform=pose, vertical_fov=camera.vertical_fov * zoom,
                               orthographic_height=camera.orthographic_height * zoom)  # fmt: skip
            found = gbuffer.decode(renderer.render(camera))
            world = gbuffer.world_positions(camera, found["depth"], get_jitter(renderer))
            was = world.copy()
            # The background is infinitely far away; in parallel projections it has one color and doesn't move.
            background = found["depth"] == 0
            was[background] += previous.transform[:3, 3] - pose[:3, 3]
            for row, instance in renderer.binder.instances.items():
                here, step = found["instance"] == row, before[instance] @ np.linalg.inv(instance.transform)
                was[here] = transform_points(step, world[here])
            expected = gbuffer.project(previous, was) - gbuffer.project(camera, world)
            expected[background & (orthographic_height > 0)] = 0
            worst = max(worst, float(np.abs(found["motion"] * SIZE - expected).max()))
            largest = max(largest, float(np.abs(expected).max()))
    note = f"the fastest moves by {largest:.1f} pixels"
    yield Measurement(MOTION, worst if largest > 5 else math.inf, MAX_MOTION_ERROR, "of a pixel", note)


def measure_still(device: Device, way: str) -> Iterator[Measurement]:
    """Looks twice from each of several places at surfaces under random transforms, by themselves and in mirrors."""
    random = np.random.default_rng(6)
    moving = 0
    for name in ("material_zoo", "mirror_hall"):
        scene = make_scene(name)
        for instance in scene.instances:
            instance.transform = turned(instance.transform, random, 0.2, 0.2)
        with make_renderer(device, scene, SIZE, passes=GUIDES, gbuffer=way, jitter=True) as renderer:
            for _ in range(4):
                pose = turned_rigidly(scene.camera.transform, random, 0.1, 0.3)
                camera = dataclasses.replace(scene.camera, transform=pose)
                renderer.render(camera)
                frame = renderer.render(camera)
                for image in ("motion_vectors", "guides_specular_motion"):
                    moving += int((frame[image] != 0).any(axis=-1).sum())
    yield Measurement(STILL, float(moving), 0.0, "values of pixels", way)


# ---- culling ----------------------------------------------------------------------------------------

_VARIANTS: dict[str, dict[str, Any]] = {
    "none": {"gbuffer": "raster", "frustum_culling": False, "occlusion_culling": False},
    "frustum": {"gbuffer": "raster", "occlusion_culling": False},
    "occlusion": {"gbuffer": "raster", "frustum_culling": False},
    "both": {"gbuffer": "raster"},
}


def _change(scene: sv.Scene, random: np.random.Generator, number: int) -> None:
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


def measure_culling(device: Device, orthographic_height: float = 0.0) -> Iterator[Measurement]:
    """Culling changes no pixel while a camera moves and jumps among walls, and instances move, appear and disappear."""
    frame_count, random = 32, np.random.default_rng(5)
    scene = walled(random)
    binder = SceneBinder(device, scene)
    wrong, miscounted, sums = 0, 0, dict.fromkeys(COUNTERS, 0)
    eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
    with ExitStack() as opened:
        opened.callback(binder.destroy)
        renderers = {
            name: opened.enter_context(make_renderer(device, binder, (88, 54), passes=GBUFFER, **chosen))
            for name, chosen in _VARIANTS.items()
        }
        for number in range(frame_count):
            eye, target = (at + random.uniform(-0.2, 0.2, 3) for at in (eye, target))
            if number % 7 == 6:  # a cut: visibility in the previous frame says nothing about this one
                eye, target = random.uniform(-9, 9, 3), random.uniform(-3, 3, 3)
            fov = random.uniform(1.0, 1.6)
            camera = sv.Camera.look_at(eye, target, vertical_fov=fov, orthographic_height=orthographic_height * fov)
            _change(scene, random, number)
            frames = {name: renderer.render(camera) for name, renderer in renderers.items()}
            visible = sum(instance.visible for instance in scene.instances)
            for name, frame in frames.items():
                differ = [(frame[image] != frames["none"][image]).any(axis=-1) for image in gbuffer.IMAGES]
                wrong += int(np.any(differ, axis=0).sum())
                counts = {counter: int(renderers[name][f"gbuffer/{counter}"]) for counter in COUNTERS}
                miscounted += sum(counts.values()) != visible
                miscounted += name in ("none", "frustum") and counts["occlusion_culled"] > 0
                miscounted += name in ("none", "occlusion") and counts["frustum_culled"] > 0
                sums = {counter: sums[counter] + counts[counter] * (name == "both") for counter in COUNTERS}
    note = ", ".join(f"{count} {name}" for name, count in sums.items())
    worked = min(sums.values()) > frame_count
    unit = f"pixels of {frame_count * 3} frames differ"
    yield Measurement(CULLING, float(wrong) if worked else math.inf, 0.0, unit, note)
    yield Measurement(COUNTED, float(miscounted), 0.0, f"of {frame_count * 4} frames miscounted", note)


# ---- each rule holds, and can fail --------------------------------------------------------------------

@pytest.mark.parametrize("name", [name if name == "material_zoo" else pytest.param(name, marks=pytest.mark.slow)
                                  for name in SCENES])  # fmt: skip
def test_raster_and_rays_agree(device, name):
    hold(measure_raster(device, make_scene(name)))


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_motion(device, way):
    hold(measure_motion(device, way))
    hold(measure_still(device, way))


def test_culling(device):
    hold(measure_culling(device))


GBUFFER_FILE, PIXEL, CULL = "passes/gbuffer/gbuffer.glsl", "passes/gbuffer/pixel.glsl", "passes/gbuffer/cull.comp"


def measure_zoo(device):
    return measure_raster(device, make_scene("material_zoo"))


test_a_seeded_bug_is_noticed = bug_tests({
    INSIDE: (measure_zoo, Bug("passes/gbuffer/raster.glsl", "intersect_triangle",
                              "Hit hit = correct(ray, row, triangle, mesh); hit.barycentrics = hit.barycentrics.yx; "
                              "return hit;")),
    RASTER: (measure_zoo, Bug("passes/gbuffer/raster.glsl", "intersect_triangle",
                              "return correct(ray, row, triangle > 0u ? triangle - 1u : 0u, mesh);")),
    MOTION: (measure_motion, Bug(GBUFFER_FILE, "rests", "return true;")),
    STILL: (lambda device: measure_still(device, "traced"), Bug(
        GBUFFER_FILE, "motion_vector", "return correct(world_position, previous_world_position) + 1e-7;")),
    CULLING: (measure_culling, Bug(CULL, "is_beyond", "return correct(box, normal, distance - 0.2);")),
    "occlusion culling": (measure_culling, Bug(CULL, "is_occluded", "box.half_axes *= 0.5; return correct(box);")),
    COUNTED: (measure_culling, Bug(CULL, "main", "correct(); atomicAdd(gbuffer_counters.drawn_first, 1u);")),
})  # fmt: skip
