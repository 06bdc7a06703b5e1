"""What a frame costs besides its passes: memory, Python's time, and how all of it grows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.measure.frame.passes import frame_times
from solari_vk.measure.timing import seconds
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

# ---- growth -----------------------------------------------------------------------------------------


def frame_time(device: Device, scene: Scene, size: tuple[int, int], frames: int) -> float:
    """Milliseconds of a frame of a fresh renderer, once its cells and reservoirs are filled."""
    with Renderer(device, scene, size, Settings()) as renderer:
        return frame_times(renderer, scene.camera, 10 if frames > 2 else 1, frames)["frame"]


# ---- memory -----------------------------------------------------------------------------------------


def resource_bytes(resource: object) -> int | None:
    """The bytes of a buffer or of an image's first level, None for anything else."""
    if isinstance(resource, Buffer):
        return resource.size
    if isinstance(resource, Image):
        return resource.width * resource.height * resource.channels * resource.dtype.itemsize
    return None


def resource_sizes(renderer: Renderer) -> dict[str, int]:
    """The bytes of each buffer and image that the frame made for itself, by name; both images of a history count."""
    names = {name for row in renderer.describe() for name in (*row.reads, *row.writes)}
    resources = {name: renderer.resource(name) for name in sorted(names - set(renderer.binder.resources))}
    different = {id(resource): name for name, resource in reversed(resources.items())}
    sizes = {name: resource_bytes(resources[name]) for name in different.values()}
    return {name: size for name, size in sizes.items() if size is not None}


def memory(device: Device, small: tuple[int, int], large: tuple[int, int]) -> tuple[dict[str, float], dict[str, float]]:
    """Bytes a pixel and fixed bytes of each resource, from what two picture sizes take."""
    scene, sizes = builtin("cornell_box"), []
    with Renderer(device, scene, small, Settings()) as renderer:
        for size in (small, large):
            renderer.resize(size)
            renderer.render(scene.camera)
            device.wait_idle()
            sizes.append(resource_sizes(renderer))
    pixels = [size[0] * size[1] for size in (small, large)]
    slopes = {name: (sizes[1][name] - sizes[0][name]) / (pixels[1] - pixels[0]) for name in sizes[0]}
    return slopes, {name: sizes[0][name] - slopes[name] * pixels[0] for name in sizes[0]}


# ---- host -------------------------------------------------------------------------------------------


@contextmanager
def _vulkan_timed(device: Device) -> Iterator[list[float]]:
    """Seconds of each Vulkan call meanwhile, of functions that were called before."""
    spent: list[float] = []

    def timed(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            started = time.perf_counter()
            result = function(*arguments)
            spent.append(time.perf_counter() - started)
            return result

        return call

    functions = {name: item for name, item in vars(device.vk).items() if name.startswith("vk")}
    try:
        vars(device.vk).update({name: timed(item) for name, item in functions.items()})
        yield spent
    finally:
        vars(device.vk).update(functions)


def host_times(device: Device, frames: int) -> dict[str, tuple[float, float]]:
    """Milliseconds of a call of `render`, and how many of them Vulkan calls take; the device is idle when it begins.

    Medians, of frames of their own each.
    """
    scene = builtin("cornell_box")
    camera = scene.camera
    instance = list(scene.instances)[-2]  # a block
    start, pose = np.array(instance.transform), np.array(camera.transform)

    def nothing(_: int) -> None:
        pass

    def move_camera(frame: int) -> None:
        pose[0, 3] += 1e-4
        camera.transform = pose

    def move_instance(frame: int) -> None:
        moved = start.copy()
        moved[0, 3] += 1e-3 * (frame % 7)
        instance.transform = moved

    found = {}
    cases: dict[str, Callable[[int], None]] = {
        "still": nothing, "camera moving": move_camera, "one instance moving": move_instance,
    }  # fmt: skip
    with Renderer(device, scene, (32, 32), Settings()) as renderer:
        for name, change in cases.items():
            whole, inside = [], []
            for frame in range(frames + 5):
                change(frame)
                whole.append(seconds(lambda: renderer.render(camera)))
                device.wait_idle()
            for frame in range(frames):
                change(frame)
                with _vulkan_timed(device) as calls:
                    renderer.render(camera)
                inside.append(sum(calls))
                device.wait_idle()
            found[name] = float(np.median(whole[5:])) * 1e3, float(np.median(inside)) * 1e3
    return found
