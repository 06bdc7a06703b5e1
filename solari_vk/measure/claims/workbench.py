"""Tools for measuring claims: renderers with Solari's preset, variants that take turns, references and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.patches import Patch, patched_shaders

from solari_vk.gpu.device.device import Device
from solari_vk.measure.partial import PartialRenderer
from solari_vk.measure.timing import every_barrier
from solari_vk.output.tone_mapping import encode_picture
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import QUALITIES, Settings

Picture = NDArray[np.float64]
# The frame without guides and display, so that their shaders need not be compiled.
LIGHT = ("gbuffer/", "light_tiles/", "world_cache/", "restir_di/", "restir_gi/", "specular_gi/", "display/compose",
         "taa/")  # fmt: skip
SOLARI = {**QUALITIES["solari"], "gbuffer": "traced"}


@dataclass(frozen=True)
class Variant:
    """One side of a comparison: what it changes of the settings and of the shaders."""

    settings: dict[str, Any] = field(default_factory=dict)
    patches: tuple[Patch, ...] = ()


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
        """The cached result of `make()` under this name, for results that several claims share."""
        if name not in self._known:
            self._known[name] = make()
        return self._known[name]

    def size(self, width: int, height: int) -> tuple[int, int]:
        """A picture's size in pixels, or a tiny one with `quick`."""
        return (16, 16 * height // width) if self.quick else (width, height)

    def count(self, many: int, few: int = 2) -> int:
        """A number of frames or samples: `few` with `quick`."""
        return few if self.quick else many

    @contextmanager
    def renderer(
        self, scene: Scene, size: tuple[int, int], patches: Sequence[Patch] = (), **settings: Any
    ) -> Iterator[Renderer]:
        """A renderer with Solari's preset, these settings and these patches of the shaders, closed at the end."""
        few = {"light_tile_count": 8, "world_cache_cells": 1 << 16} if self.quick else {}
        chosen: dict[str, Any] = {**SOLARI, **few, **settings}
        with every_barrier(), patched_shaders(*patches):  # barriers keep a pass's time apart from that of another
            renderer = PartialRenderer(self.device, scene, size, Settings(**chosen), passes=LIGHT)
        with renderer:
            yield renderer

    def reference(
        self, scene: Scene, size: tuple[int, int], samples: int, patches: Sequence[Patch] = (), **options: Any
    ) -> Picture:
        """The path tracer's picture (height, width, 3), by default with the layering of Solari's preset."""
        options = {"layering": SOLARI["layering"], **options}
        with patched_shaders(*patches), PathTracer(self.device, scene, size, **options) as tracer:
            return tracer.render(scene.camera, samples=self.count(samples, 16))["radiance"].astype(np.float64)

    def direct_reference(self, scene: Scene, size: tuple[int, int], samples: int) -> Picture:
        """Light that surfaces reflect straight from lights (height, width, 3); what lights themselves emit is 0."""
        with_lights = self.reference(scene, size, samples, max_bounces=1)
        return with_lights - self.reference(scene, size, samples, max_bounces=0)

    def compare(
        self, scene: Scene, size: tuple[int, int], variants: Sequence[Variant], measure: Callable[[Renderer], Any],
        max_seeds: int | None = None, **settings: Any,
    ) -> list[NDArray[np.float64]]:  # fmt: skip
        """The numbers that `measure` finds with each variant, an array (seeds, ...) for each.

        The variants take turns, seed by seed, so that other work of the machine slows all of them. Variants with the
        same patches share a renderer. max_seeds: for measures that take long.
        """
        changed = {name for variant in variants for name in variant.settings}
        found: list[list[Any]] = [[] for _ in variants]
        seeds = self.seeds[:max_seeds]
        with ExitStack() as stack:
            renderers: dict[tuple[Patch, ...], Renderer] = {}
            for patches in dict.fromkeys(variant.patches for variant in variants):
                renderers[patches] = stack.enter_context(self.renderer(scene, size, patches, **settings))
            unchanged = {name: getattr(renderers[variants[0].patches].settings, name) for name in changed}
            for seed in seeds:
                for variant, values in zip(variants, found, strict=True):
                    renderer = renderers[variant.patches]
                    for name, value in {**unchanged, **variant.settings}.items():
                        setattr(renderer.settings, name, value)
                    renderer.seed = seed
                    renderer.reset()
                    with every_barrier(), patched_shaders(*variant.patches):  # a setting may rebuild the frame
                        values.append(measure(renderer))
                self.say(f"    seed {seed + 1} of {len(seeds)}")
        return [np.array(values, np.float64) for values in found]


def run(renderer: Renderer, camera: Camera, frames: int) -> None:
    """Render frames and wait for them."""
    for _ in range(frames):
        renderer.render(camera)
    renderer.device.wait_idle()


def mean_of(renderer: Renderer, camera: Camera, frames: int, names: Sequence[str] = ("radiance",)) -> Picture:
    """The mean over the next frames of the sum of these outputs, (height, width, 3)."""
    total = np.zeros((renderer.size[1], renderer.size[0], 3))
    for _ in range(frames):
        frame = renderer.render(camera)
        for name in names:
            total += frame[name]
    return total / frames


def side_by_side(pictures: Sequence[Picture], camera: Camera, scale: int = 2) -> NDArray[np.uint8]:
    """Pictures of radiance, tone mapped, next to each other in one of 8 bits; each pixel is `scale` wide."""
    return join([encode_picture(picture, exposure=camera.exposure) for picture in pictures], scale)


def join(pictures: Sequence[NDArray[np.uint8]], scale: int = 2) -> NDArray[np.uint8]:
    """8-bit pictures of one height next to each other, with white gaps."""
    gap = np.full((pictures[0].shape[0] * scale, 4, 3), 255, np.uint8)
    parts: list[NDArray[np.uint8]] = []
    for picture in pictures:
        parts += [picture.repeat(scale, axis=0).repeat(scale, axis=1), gap]
    return np.concatenate(parts[:-1], axis=1)


def grow(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """The mask, grown by this many pixels to each side."""
    for _ in range(steps):
        padded = np.pad(mask, 1)
        mask = mask | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    return mask
