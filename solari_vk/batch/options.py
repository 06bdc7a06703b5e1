"""The arguments of `Batch`: its options and results by renderer, and checks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, is_name, quoted, unknown_name
from solari_vk.base.host_array import host_array
from solari_vk.gpu.acceleration.checks import check_kind, whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.passes import batch as passes
from solari_vk.passes import reference, world_cache
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera, Scene

# The options of each renderer.
OPTIONS = {
    "labels": [],
    "reference": [field.name for field in dataclasses.fields(reference.Settings)],
    "realtime": ["settings", "seed"],
}
# The results of each renderer beside the outputs.
RADIANCE_NAMES = {"labels": (), "reference": ("radiance",), "realtime": ("radiance", "raw_radiance", "display")}


def checked_mask(reset: Any, views: int) -> NDArray[np.bool_]:
    try:
        mask = host_array(reset)
    except (TypeError, ValueError, RuntimeError):
        mask = np.zeros(0)
    if mask.dtype != np.bool_ or mask.shape not in ((), (views,)):
        raise SolariError(f"Batch.render: reset is True, False or an array ({views},) of these, not {quoted(reset)}")
    return mask


def checked_flag(value: Any, name: str, where: str) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise SolariError(f"{where}: {name} is True or False, not {quoted(value)}")
    return bool(value)


def checked_names(renderer: Any, outputs: Any, options: Iterable[str]) -> tuple[str, ...]:
    """The names of the labels among the outputs; raises SolariError for wrong ones, and for wrong options."""
    if not is_name(renderer, OPTIONS):
        raise SolariError(f"Batch: renderer is one of {', '.join(OPTIONS)}, not {quoted(renderer)}")
    for name in options:
        if name not in OPTIONS[renderer]:
            known = ["renderer", "outputs", "worlds", *OPTIONS[renderer]]
            raise unknown_name(f"Batch with renderer='{renderer}' has no option", name, known)
    labels = checked_results(outputs, passes.OUTPUTS, "Batch", "output")
    if renderer == "labels" and not labels:
        raise SolariError(f"Batch: outputs names nothing: give some of {', '.join(passes.OUTPUTS)}")
    return labels


def checked_results(outputs: Any, known: Sequence[str], where: str, what: str) -> tuple[str, ...]:
    """Names of some results, each once; raises SolariError for those that aren't known."""
    if not isinstance(outputs, (str, Sequence)):
        raise SolariError(f"{where}: outputs is a list of names, not {quoted(outputs)}")
    names = [outputs] if isinstance(outputs, str) else list(outputs)
    for name in names:
        if not is_name(name, known):
            raise unknown_name(f"{where}: there is no {what}", name, known)
    return tuple(dict.fromkeys(names))


def check_scenes(scene: Any, worlds: Any) -> None:
    """Raise SolariError for a wrong list of scenes, and for a number of worlds beside a list or its SceneBinder."""
    # Who gives a list of scenes as worlds means the list in place of the scene.
    if isinstance(worlds, (list, tuple)) or np.ndim(worlds):
        raise SolariError(
            "Batch: worlds is the number of worlds of one scene: give a list of scenes in its place, "
            "Batch(device, [scene_a, scene_b], size, views)"
        )
    is_list = isinstance(scene, (list, tuple))
    if is_list and not scene:
        raise SolariError("Batch: the list of scenes is empty: give one for each world")
    for world, one in enumerate(scene if is_list else ()):
        check_kind(one, Scene, f"Batch: the scene of world {world}", "give a solari_vk.Scene")
    if (is_list or getattr(scene, "has_many_scenes", False)) and worlds != 1:
        raise SolariError(f"Batch: worlds={quoted(worlds)} goes with one scene: a list has the scene of each world")


def checked_worlds(device: Device, worlds: Any, views: int, renderer: str) -> int:
    """The number of worlds; raises SolariError if views aren't shared evenly, or the device doesn't hold so many."""
    count = whole_number(worlds, "Batch: worlds", 1)
    # Each world has cells of its own in the world cache, which is one buffer.
    most = world_cache.most_worlds(device.properties.limits.maxStorageBufferRange)
    if renderer == "realtime" and count > most:
        raise SolariError(
            f"Batch: {count:,} worlds: this device's buffers have cells of the world cache for at most "
            f"{most:,}: share the worlds among several batches"
        )
    # View i shows world i // (views / worlds).
    if views % count:
        raise SolariError(f"Batch: {views:,} views are no multiple of {count:,} worlds: each has as many views")
    return count


def check_realtime(cameras: Any, where: str) -> None:
    """Raise SolariError for cameras that the realtime renderer doesn't take."""
    if isinstance(cameras, Camera):
        cameras = [cameras]
    if not isinstance(cameras, (list, tuple)):
        return
    for index, camera in enumerate(cameras):
        if not isinstance(camera, Camera):
            return  # it is a list of poses
        if camera.auto_exposure:
            raise SolariError(f"{where}: view {index} can't choose an exposure: set auto_exposure to False")


def checked_size(device: Device, size: Any, views: int, record_bytes: int, renderer: str) -> tuple[int, int]:
    """The size of a view; raises SolariError if the device doesn't hold so many views, with a record for each."""
    width, height = _pair(size)
    limits = device.properties.limits
    most = 0
    if width > 0 and height > 0:
        pixel_bytes = (Renderer if renderer == "realtime" else PathTracer).pixel_bytes(device)
        most = limits.maxStorageBufferRange // max(pixel_bytes * width * height, record_bytes)
        # The realtime renderer has all views in one image, a grid whose last row may have places without a view.
        if renderer == "realtime":
            columns, rows = (limits.maxImageDimension2D // side for side in (width, height))
            empty = min(round(math.sqrt(most * height / width)), most - 1)
            # Dispatches of waiting paths have a layer of work groups for each view.
            layers = limits.maxComputeWorkGroupCount[2]
            most = min(most - max(empty, 0), columns * rows, layers)
    if views > most:
        hint = f"at most {most:,} views of this size: render them in parts" if most else "none of this size"
        raise SolariError(f"Batch: {views:,} views of {width}x{height} pixels: this device's buffers hold {hint}")
    return width, height


def _pair(size: Any) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise SolariError(f"Batch: size must be two whole numbers (width, height), not {quoted(size)}") from None
    return whole_number(width, "Batch: the width"), whole_number(height, "Batch: the height")
