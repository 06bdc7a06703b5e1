"""The costs of a frame besides its passes: start, memory, Python's time, growth, and characters that move."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.bound.pose_commands import TIMED
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import device_seconds, seconds
from solari_vk.lab.measure.frame_passes import Plan, Size, frame_times
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

# ---- growth -----------------------------------------------------------------------------------------


def frame_time(device: Device, scene: Scene, size: Size, plan: Plan) -> float:
    """Milliseconds of a frame of a new renderer, after a warm-up that fills its cells and reservoirs."""
    with Renderer(device, scene, size, Settings()) as renderer:
        return frame_times(renderer, scene.camera, plan.warm_up_frames, plan.growth_frames, plan.seconds)["frame"]


# ---- start ------------------------------------------------------------------------------------------

_START = """
import sys, time
import solari_vk as sv
with sv.Device(sys.argv[1]) as device:
    scene, started = sv.builtin("cornell_box"), time.perf_counter()
    renderer = sv.Renderer(device, scene, (256, 256))
    made = time.perf_counter()
    renderer.render().wait()
    print(made - started, time.perf_counter() - made)
"""
NO_DRIVER_CACHE = {"MESA_SHADER_CACHE_DISABLE": "true", "__GL_SHADER_DISK_CACHE": "0"}


def start_seconds(device: Device, *, cold: bool = True) -> dict[str, tuple[float, float]]:
    """Seconds that new processes need to make a renderer, and to finish its first frame, by what must be compiled.

    cold: measure the starts that compile too, for which the driver's own cache is off. Raises SolariError when a
    process fails.
    """

    def start(**environment: str) -> tuple[float, float]:
        # The UUID means the same device in the new process, also where several have one name.
        command = [sys.executable, "-c", _START, device.properties.uuid]
        variables = {**os.environ, "SOLARI_VK_RAYS": device.rays, **environment}
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=variables)
        if done.returncode:
            raise SolariError(f"starting in a new process failed: {done.stderr.strip().rpartition(chr(10))[2]}")
        made, first = map(float, done.stdout.split())
        return made, first

    found = {}
    with tempfile.TemporaryDirectory() as folder:
        # An empty cache of ours too.
        caches = {**NO_DRIVER_CACHE, "SOLARI_VK_CACHE": folder}
        if cold:
            found["GLSL and pipelines"] = start(**caches)
            # The compiled GLSL stays, as in an installed package.
            for file in Path(folder).glob("*.pipelines"):
                file.unlink()
            found |= {"pipelines": start(**caches), "nothing": start(**caches)}
    # Fills the driver's own cache.
    start()
    return found | {"nothing, and the driver has a cache": start()}


# ---- memory -----------------------------------------------------------------------------------------


def memory(device: Device, small: tuple[int, int], large: tuple[int, int]) -> dict[str, tuple[float, ...]]:
    """(bytes a pixel, fixed bytes) of the resources of each stage, from the bytes for two picture sizes."""
    scene = builtin("cornell_box")
    sizes = []
    with Renderer(device, scene, small, Settings()) as renderer:
        for size in (small, large):
            renderer.resize(size)
            renderer.render(scene.camera)
            device.wait_idle()
            sizes.append(renderer.memory)
        # Reversed, so that the first stage that writes a resource stays.
        stage_of = {name: row.name.partition("/")[0] for row in reversed(renderer.describe()) for name in row.writes}
    pixels = [size[0] * size[1] for size in (small, large)]
    found: dict[str, tuple[float, ...]] = {}
    for name, size_bytes in sizes[0].items():
        # Bytes are a line over pixels: its slope, and its value at none.
        slope = (sizes[1][name] - size_bytes) / (pixels[1] - pixels[0])
        stage = stage_of.get(name, "written by no pass")
        before = found.get(stage, (0.0, 0.0))
        found[stage] = before[0] + slope, before[1] + size_bytes - slope * pixels[0]
    return found


# ---- host -------------------------------------------------------------------------------------------


def host_times(device: Device, frames: int) -> dict[str, float]:
    """Milliseconds of a call of `render` by case: medians over frames. Each call starts on an idle device."""
    scene = builtin("cornell_box")
    camera = scene.camera
    block = list(scene.instances)[-2]
    pose, start = np.array(camera.transform), np.array(block.transform)

    def move_camera(_: int) -> None:
        pose[0, 3] += 1e-4
        camera.transform = pose

    def move_block(frame: int) -> None:
        moved = start.copy()
        moved[0, 3] += 1e-3 * (frame % 7)
        block.transform = moved

    cases: dict[str, Callable[[int], None]] = {
        "still": lambda _: None,
        "camera moving": move_camera,
        "one instance moving": move_block,
    }
    found = {}
    with Renderer(device, scene, (32, 32), Settings()) as renderer:
        for name, change in cases.items():
            spent = []
            for frame in range(frames + 5):
                change(frame)
                spent.append(1e3 * seconds(lambda: renderer.render(camera)))
                device.wait_idle()
            found[name] = float(np.median(spent[5:]))
    return found


# ---- characters -------------------------------------------------------------------------------------

CHARACTER_HEAD = [
    "scene",
    "vertices",
    "host: pose",
    "vertices on the device",
    "refit",
    "frame in motion",
    "frame at rest",
]
CHARACTER_NOTE = (
    "Milliseconds, medians. The host samples the animation and assigns the poses; the device computes positions, "
    "normals and tangents and refits or builds the bottom-level structures. The frame, from call to done, includes "
    "both works of the device, the host's records of them and the top-level structure."
)


def measure_character(device: Device, scene: Scene, plan: Plan) -> list[str]:
    """A row of the table: a scene whose first animation plays at 60 frames a second."""
    spent: dict[str, list[float]] = defaultdict(list)
    camera = scene.camera
    with Renderer(device, scene, plan.growth_size, Settings()) as renderer:
        stopwatch = renderer.binder.time_poses()
        at_rest = frame_times(renderer, camera, plan.warm_up_frames, plan.frames, plan.seconds)["frame"]
        for frame in range(plan.warm_up_frames + plan.frames):
            started = time.perf_counter()
            scene.animate(frame / 60)
            pose = 1e3 * (time.perf_counter() - started)
            whole = 1e3 * device_seconds(device, lambda: renderer.render(camera))
            on_device = stopwatch.read()
            if frame < plan.warm_up_frames:
                continue
            for name, value in {"pose": pose, "frame": whole, **on_device}.items():
                spent[name].append(value)
    vertices = sum(len(instance.mesh.positions) for instance in scene if instance.posed)
    # A part that the scene has no need of has no times.
    parts = [spent[name] or [float("nan")] for name in ("pose", *TIMED, "frame")]
    medians = [float(np.median(values)) for values in parts]
    return [scene.name, f"{vertices:,}", *(f"{value:.2f}" for value in (*medians, at_rest))]
