"""What all claims are measured with: renderers of nothing but light, runs over seeds in turns, references, pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.measure.partial import PartialRenderer
from solari_vk.measure.timing import every_barrier
from solari_vk.output.tone_mapping import encode_picture
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings

Picture = NDArray[np.float64]
# The frame without guides and display, whose shaders would have to be compiled for nothing.
LIGHT = ("gbuffer/", "light_tiles/", "world_cache/", "restir_di/", "restir_gi/", "specular_gi/", "display/compose")
CACHE_UPDATE = ("world_cache/sample_direct", "world_cache/sample_indirect", "world_cache/blend")


class Workbench:
    """A device, how much to measure, and where progress goes. `quick`: tiny pictures and two seeds, to try it out."""

    def __init__(self, device: Device, *, quick: bool = False, seeds: int | None = None,
                 say: Callable[[str], None] = print) -> None:  # fmt: skip
        self.device = device
        self.quick = quick
        self.seeds = range(seeds or (2 if quick else 5))
        self.say = say
        self._known: dict[str, Any] = {}

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """What several claims need: made when it is first asked for."""
        if name not in self._known:
            self._known[name] = make()
        return self._known[name]

    def size(self, width: int, height: int) -> tuple[int, int]:
        """A picture's size, or a tiny one."""
        return (16, 16 * height // width) if self.quick else (width, height)

    def count(self, many: int, few: int = 2) -> int:
        """Of frames or samples."""
        return few if self.quick else many

    @contextmanager
    def renderer(self, scene: Scene, size: tuple[int, int], **settings: Any) -> Iterator[Renderer]:
        """A renderer that is closed in the end. Few light tiles where all is tiny."""
        few = {"light_tile_count": 8, "world_cache_cells": 1 << 16} if self.quick else {}
        chosen: dict[str, Any] = {"gbuffer": "traced", **few, **settings}
        with every_barrier():  # so that no pass is charged with the time of another
            renderer = PartialRenderer(self.device, scene, size, Settings(**chosen), passes=LIGHT)
        try:
            yield renderer
        finally:
            renderer.close()

    def reference(self, scene: Scene, size: tuple[int, int], samples: int, **options: Any) -> Picture:
        """What the path tracer makes of it, (height, width, 3)."""
        tracer = PathTracer(self.device, scene, size, **options)
        try:
            return tracer.render(scene.camera, samples=self.count(samples, 16))["radiance"].astype(np.float64)
        finally:
            tracer.close()

    def direct_reference(self, scene: Scene, size: tuple[int, int], samples: int) -> Picture:
        """Light that comes straight from lights, without what is seen of these themselves."""
        with_lights = self.reference(scene, size, samples, max_bounces=1)
        return with_lights - self.reference(scene, size, samples, max_bounces=0)

    def pairs(
        self, renderer: Renderer, before: dict[str, Any], after: dict[str, Any], measure: Callable[[int], Any],
        most: int | None = None,
    ) -> tuple[list[Any], list[Any]]:  # fmt: skip
        """What `measure` (given the seed) finds with either settings; in turns, so that what else the machine does
        slows both. most: of seeds, where each takes long."""
        first, second = self.runs(renderer, [before, after], measure, most)
        return first, second

    def runs(
        self, renderer: Renderer, variants: Sequence[dict[str, Any]], measure: Callable[[int], Any],
        most: int | None = None,
    ) -> list[list[Any]]:  # fmt: skip
        """As `pairs`, for any number of settings."""
        found: list[list[Any]] = [[] for _ in variants]
        seeds = self.seeds[:most]
        for seed in seeds:
            for settings, values in zip(variants, found, strict=True):
                set_all(renderer, settings)
                renderer.seed = seed
                renderer.reset()
                values.append(measure(seed))
            self.say(f"    seed {seed + 1} of {len(seeds)}")
        return found


def set_all(renderer: Renderer, settings: dict[str, Any]) -> None:
    """Assign settings by name."""
    for name, value in settings.items():
        setattr(renderer.settings, name, value)


def run(renderer: Renderer, camera: Camera, frames: int) -> None:
    """Render frames and wait for them."""
    for _ in range(frames):
        renderer.render(camera)
    renderer.device.wait_idle()


def mean_of(renderer: Renderer, camera: Camera, frames: int, names: Sequence[str] = ("radiance",)) -> Picture:
    """The mean of the next frames' light of these names, (height, width, 3)."""
    total = np.zeros((renderer.size[1], renderer.size[0], 3))
    for _ in range(frames):
        frame = renderer.render(camera)
        for name in names:
            total += frame[name]
    return total / frames


def pass_times(renderer: Renderer, camera: Camera, frames: int, groups: Sequence[Sequence[str]]) -> list[float]:
    """Milliseconds of each group of passes together, medians of the next frames."""
    spent = []
    for _ in range(frames):
        run(renderer, camera, 1)
        timings = renderer.timings
        spent.append([sum(timings.get(name, 0.0) for name in names) for names in groups])
    return [float(value) for value in np.median(spent, axis=0)]


def side_by_side(pictures: Sequence[Picture], camera: Camera, scale: int = 2) -> NDArray[np.uint8]:
    """Pictures of radiance as one of 8 bits, each pixel `scale` wide, with a gap between them."""
    return join([encode_picture(picture, exposure=camera.exposure) for picture in pictures], scale)


def join(pictures: Sequence[NDArray[np.uint8]], scale: int = 2) -> NDArray[np.uint8]:
    """8-bit pictures of one height next to each other, on white."""
    gap = np.full((pictures[0].shape[0] * scale, 4, 3), 255, np.uint8)
    parts: list[NDArray[np.uint8]] = []
    for picture in pictures:
        parts += [picture.repeat(scale, axis=0).repeat(scale, axis=1), gap]
    return np.concatenate(parts[:-1], axis=1)
