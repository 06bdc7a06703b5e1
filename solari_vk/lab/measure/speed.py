"""`solari-vk bench`: speed as figures and as ratios measured in one run."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.light_tree import LightTree, light_tree
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure import rays as rays_from_python
from solari_vk.lab.measure.bare_rays import BOUNCES, BarePaths
from solari_vk.lab.measure.character import character
from solari_vk.lab.measure.figures import best_seconds, device_seconds, seconds
from solari_vk.lab.measure.report import Report, measuring
from solari_vk.lab.measure.scenes import hilly
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.model import Animation, Scene

SECONDS = 3.0  # the time that each measurement may take
LARGE_SCENE = 1_000_000  # triangles
CROWD = 50
INTRO = (
    "Times are wall-clock. The two sides of a ratio run in turns.",
    "The bare ray-query kernel (`glsl/passes/bare_rays/paths.comp`) follows the path tracer's paths without shading. "
    "The kernel that only traces (`glsl/passes/bare_rays/trace.comp`) reads rays and writes distances. "
    "`RayTracer.trace` takes the same rays from numpy arrays and also returns triangles, positions and normals; its "
    "own kernel is the part of it that runs on the device.",
)


def run(
    select: str | None, files: Sequence[Path] = (), markdown: Path | None = None, *, rays: str | None = None
) -> None:
    """Measure and print everything; markdown: a page to write as well. `select` and `rays`: those of `Device`.

    Raises SolariError without a folder for the page.
    """
    with measuring(select, rays, markdown, "Benchmarks", *INTRO) as (device, report):
        report.figure("import solari_vk", _process("import solari_vk"), "s", "aim 0.15")
        info = _process("import sys; from solari_vk.cli import main; main(['info'])")
        report.figure("solari-vk info", info, "s", "aim 0.5")
        for path in files:
            load = seconds(lambda path=path: load_gltf(path))  # type: ignore[misc]
            report.figure(f"load {path.name}", load, "s", "aim 2 for FlightHelmet")
        for name in ("cornell_box", "many_lights"):
            _rays(device, report, name)
            for size in (256, 512):
                _samples(device, report, name, size)
        _host_time(device, report)
        _crowd(device, report)
        _light_tree(device, report)
        _large_scene(device, report)
        rays_from_python.run(device, report, SECONDS)


def _process(code: str) -> float:
    """Seconds that a fresh interpreter needs for some code, beyond its own start; the best of five."""

    def best(program: str) -> float:
        command = [sys.executable, "-c", program]
        return min(seconds(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(5))

    # Without the start of the interpreter itself.
    return best(code) - best("pass")


def _rays(device: Device, report: Report, name: str) -> None:
    """Rays a second of the bare kernel and of the path tracer, in turns over the same scene and size."""
    scene = builtin(name)
    size = (256, 256)
    spent, traced = np.zeros(2), np.zeros(2)  # the bare kernel's, the path tracer's
    with (
        PathTracer(device, scene, size, max_bounces=BOUNCES) as tracer,
        BarePaths(device, tracer.binder, scene.camera, size) as bare,
    ):
        tracer.render(scene.camera, samples=1)
        bare.run(0)
        # Two sides share the time.
        until = time.perf_counter() + 2 * SECONDS
        while time.perf_counter() < until:
            kernel_seconds, kernel_rays = bare.run(tracer.samples)
            before = tracer.rays
            tracer_seconds = device_seconds(device, lambda: tracer.render(scene.camera, samples=tracer.samples + 1))
            spent += kernel_seconds, tracer_seconds
            traced += kernel_rays, tracer.rays - before
    speed, path_tracer_speed = traced / spent
    report.figure(f"{name}: bare ray-query kernel", speed / 1e6, "Mrays/s")
    report.figure(f"{name}: inside the path tracer", path_tracer_speed / 1e6, "Mrays/s")
    report.figure(f"{name}: path tracer / bare kernel", path_tracer_speed / speed, "", "aim 0.5 or more")


def _samples(device: Device, report: Report, name: str, size: int) -> None:
    scene = builtin(name)
    with PathTracer(device, scene, (size, size)) as tracer:
        tracer.render(scene.camera, samples=1)
        # More samples than any device takes in that time.
        spent = device_seconds(device, lambda: tracer.render(scene.camera, samples=1 << 20, time_limit=SECONDS))
        report.figure(f"{name} {size}x{size}", tracer.samples * size * size / spent / 1e6, "Msamples/s")


def _host_time(device: Device, report: Report) -> None:
    """Python's own time for a frame: uniforms, submission, bookkeeping; the device is idle when it begins."""
    scene = builtin("cornell_box")
    spent = []
    with PathTracer(device, scene, (8, 8), max_bounces=0) as tracer:
        tracer.render(scene.camera, samples=4)
        for _ in range(1000):
            device.wait_idle()
            spent.append(seconds(lambda: tracer.advance(scene.camera, 1)))
    report.figure("host time of a frame, median of 1000", float(np.median(spent)) * 1e3, "ms", "aim 0.2")


def _crowd(device: Device, report: Report) -> None:
    """Python's own time for many animated characters, each with a clip and a pose of its own."""
    scene = Scene()
    clips: list[Animation] = []
    for _ in range(CROWD):
        one = character(1000)
        scene.add(next(instance for instance in one if instance.posed))
        clips.append(one.animations[0])
    binder = SceneBinder(device, scene)
    spent = []

    def pose(at: float) -> None:
        for clip in clips:
            clip.apply(scene, at)

    for frame in range(40):
        device.wait_idle()
        spent.append((seconds(partial(pose, frame / 60)), seconds(binder.update)))
    device.wait_idle()
    binder.destroy()
    # The first frames compile and allocate.
    posed, records = 1e3 * np.median(spent[8:], axis=0)
    report.figure(f"{CROWD} characters of 24 joints: play clips, assign poses", float(posed), "ms")
    report.figure(f"{CROWD} characters of 24 joints: records of their poses", float(records), "ms")


def _light_tree(device: Device, report: Report) -> None:
    """The host's time for a tree over lights that are anywhere, with any powers, and for one light that moves."""
    binder = SceneBinder(device, Scene())
    rng = np.random.default_rng(1)
    spent = []
    record = binder.lights.leaves.tree.records.dtype
    for count in (10_000, 100_000):
        bounds = rng.normal(scale=10, size=(count, 1, 3)) + rng.random((count, 1, 3)) * [[[-1.0], [1.0]]]
        ids = np.arange(count, dtype=np.uint32)
        powers = rng.random(count) ** 8  # a few bright lights among many dim ones
        spent.append(best_seconds(device, partial(light_tree, bounds, powers, record), SECONDS))
        report.figure(f"tree of {count:,} lights", spent[-1] * 1e3, "ms")
    binder.destroy()
    report.figure("tree of 100,000 / of 10,000 lights", spent[1] / spent[0], "", "10 is linear")
    tree = LightTree(record)
    tree.update(ids, bounds, powers)

    def move() -> None:
        bounds[0] += 1e-3
        tree.update(ids, bounds, powers)

    moved = best_seconds(device, move, SECONDS)
    report.figure("one of 100,000 lights moves / their tree is built", moved / spent[1], "")


def _large_scene(device: Device, report: Report) -> None:
    """Measure the time from numpy arrays to the first pixel of a picture."""
    scene = hilly(LARGE_SCENE)

    def load() -> None:
        with PathTracer(device, scene, (8, 8)) as tracer:
            tracer.render(scene.camera, samples=1)

    report.figure(f"load a generated scene of {LARGE_SCENE:,} triangles", device_seconds(device, load), "s")
