"""`solari-vk bench`: speed as figures and as ratios measured in one run."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.measure import rays as bench_rt
from solari_vk.measure.report import device_facts, host_load, markdown_facts, markdown_table
from solari_vk.reference import PathTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.gltf import load_gltf
from solari_vk.scene.model import Camera, Instance, Material, Mesh, Scene
from solari_vk.scene.view import write_view

SECONDS = 3.0  # each measurement runs about so long
BOUNCES = 4


_LEGEND = (
    "The bare ray-query kernel (`glsl/passes/bench/rays.comp`) follows paths as the path tracer does, unshaded.",
    "The kernel that only traces (`glsl/passes/bench/plain.comp`) reads rays and writes distances. `RayTracer.trace`",
    "takes the same rays from numpy arrays, and returns triangles, positions and normals besides; its own kernel is",
    "the part of it that runs on the device.",
)


class Figures:
    """Takes figures one by one, prints each at once, and writes them all as a page."""

    def __init__(self) -> None:
        self._rows: list[tuple[str, str, str]] = []
        self._load = host_load()

    def __call__(self, what: str, value: float, unit: str, note: str = "") -> None:
        """One figure."""
        text = f"{value:,.0f}" if unit == "bytes" else f"{value:,.3f}"
        self._rows.append((what, f"{text} {unit}".rstrip(), note))
        print(f"{what:<60} {text:>14} {unit}" + (f"  ({note})" if note else ""), flush=True)

    def markdown(self, device: Device) -> str:
        """The page."""
        head = [
            "# Benchmarks", "",
            "Written by `solari-vk bench --markdown FILE`. Times are wall-clock; ratios are of runs in turns.", "",
            *markdown_facts(device_facts(device, self._load)), "", *_LEGEND, "",
        ]  # fmt: skip
        return "\n".join([*head, *markdown_table(("what", "measured", "remark"), self._rows, (1,))]) + "\n"


def run(select: str | None, files: list[Path], markdown: Path | None = None) -> None:
    """Measure and print everything; markdown: a file to write as well. Raises SolariError without a folder for it."""
    if markdown is not None and not markdown.resolve().parent.is_dir():
        raise SolariError(f"{markdown}: there is no folder {markdown.resolve().parent}")
    say = Figures()
    say("import solari_vk", _process("import solari_vk"), "s", "aim 0.15")
    say("solari-vk info", _process("import sys; from solari_vk.cli import main; main(['info'])"), "s", "aim 0.5")
    for path in files:
        load = _time(lambda path=path: load_gltf(path))  # type: ignore[misc]
        say(f"load {path.name}", load, "s", "aim 2 for FlightHelmet")
    with Device(select) as device:
        print(f"device: {device.name}")
        for name in ("cornell_box", "many_lights"):
            _rays(device, say, name)
            for size in (256, 512):
                _samples(device, say, name, size)
        _host_time(device, say)
        _large_scene(device, say)
        bench_rt.run(device, say, SECONDS)
        if markdown is not None:
            markdown.write_text(say.markdown(device), encoding="utf-8")
            print(f"wrote {markdown}")


def _time(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _process(code: str) -> float:
    """Seconds that a fresh interpreter needs for some code, beyond its own start; the best of five."""

    def best(program: str) -> float:
        command = [sys.executable, "-c", program]
        return min(_time(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(5))

    return best(code) - best("pass")


def _rays(device: Device, say: Figures, name: str) -> None:
    """Rays a second of the bare kernel and of the path tracer, in turns over the same scene and size."""
    scene = builtin(name)
    size = (256, 256)
    tracer = PathTracer(device, scene, size, max_bounces=BOUNCES)
    tracer.render(scene.camera, samples=1)
    stage = Stage("bench", buffers={"ray_count": size[0] * size[1]}, passes=[Pass("bench/rays", threads=size)])
    bare = Frame(device, [stage], external=tracer.binder.resources)
    write_view(bare.uniforms, scene.camera, size, size[1])
    bare.uniforms["max_bounces"] = BOUNCES
    bare.submit()
    device.wait_idle()

    bare_rays = bare_seconds = 0.0
    traced_rays = traced_seconds = 0.0
    until = time.perf_counter() + 2 * SECONDS
    while time.perf_counter() < until:
        bare.uniforms["sample_index"] = tracer.samples
        bare_seconds += _time(lambda: device.wait(bare.submit()))
        bare_rays += int(bare["ray_count"].sum(dtype=np.uint64))
        before = tracer.rays
        traced_seconds += _time(lambda: tracer.render(scene.camera, samples=tracer.samples + 1))
        traced_rays += tracer.rays - before
    say(f"{name}: bare ray-query kernel", bare_rays / bare_seconds / 1e6, "Mrays/s")
    say(f"{name}: inside the path tracer", traced_rays / traced_seconds / 1e6, "Mrays/s")
    ratio = traced_rays / traced_seconds / (bare_rays / bare_seconds)
    say(f"{name}: path tracer / bare kernel", ratio, "", "aim 0.5 or more")
    bare.close()
    tracer.close()


def _samples(device: Device, say: Figures, name: str, size: int) -> None:
    scene = builtin(name)
    tracer = PathTracer(device, scene, (size, size))
    tracer.render(scene.camera, samples=1)
    started = time.perf_counter()
    tracer.render(scene.camera, samples=1 << 20, time_limit=SECONDS)
    seconds = time.perf_counter() - started
    say(f"{name} {size}x{size}", tracer.samples * size * size / seconds / 1e6, "Msamples/s")
    tracer.close()


def _host_time(device: Device, say: Figures) -> None:
    """Python's own time for a frame: uniforms, submission, bookkeeping; the device is idle meanwhile."""
    scene = builtin("cornell_box")
    tracer = PathTracer(device, scene, (8, 8), max_bounces=0)
    tracer.render(scene.camera, samples=4)
    spent = []
    for _ in range(1000):
        device.wait_idle()
        spent.append(_time(lambda: tracer.advance(scene.camera, 1)))
    device.wait_idle()
    say("host time of a frame, median of 1000", float(np.median(spent)) * 1e3, "ms", "aim 0.2")
    tracer.close()


def _large_scene(device: Device, say: Figures) -> None:
    """Load a generated height field of a million triangles: numpy arrays to the first pixel."""
    side = 708
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    heights = 0.05 * np.sin(20 * x) * np.cos(17 * z)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    corners = np.stack([first, first + side + 1, first + 1, first + 1, first + side + 1, first + side + 2], axis=1)
    mesh = Mesh(positions=np.stack([x, heights, z], axis=-1).reshape(-1, 3), indices=corners.reshape(-1, 3))
    lamp = Material(emissive=np.full(3, 5.0, np.float32), double_sided=True)
    above = Mesh(positions=np.array([[-1, 2, -1], [1, 2, -1], [0, 2, 1]], np.float32))
    scene = Scene(Instance(mesh=mesh, material=Material()), Instance(mesh=above, material=lamp))
    camera = Camera.look_at((0, 1, 2), (0, 0, 0))

    def load() -> None:
        tracer = PathTracer(device, scene, (8, 8))
        tracer.render(camera, samples=1)
        tracer.close()

    say(f"load a generated scene of {len(corners) * 2:,} triangles", _time(load), "s")
