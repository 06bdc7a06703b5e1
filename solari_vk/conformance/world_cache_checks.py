"""The world cache: its hash map's laws, what its cells hold in a closed box, and walls that keep their light."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from solari_vk.conformance.oracles import closed_forms
from solari_vk.conformance.realtime import SPLIT, Effort, Image, add_up, make_renderer, measure_mean, trace
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.measure.replication import replicate
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import closed_box, cornell_box, place, thin_wall

_CACHE = (SUITE, "World cache")
LIST = Rule("the list of active cells holds each of the map's living cells once", *_CACHE)
ONCE = Rule("every key has exactly one entry", *_CACHE)
DEATH = Rule("cells die when they are no longer queried", *_CACHE)
FIXED_POINT = Rule("the cells of a closed box converge to the sum of all bounces", *_CACHE)
LEAK = Rule("no light leaks through a thin wall", *_CACHE)


def measure_world_cache(device: Device) -> Iterator[Measurement]:
    """The rules of the hash map hold after frames of the renderer."""
    scene = cornell_box()
    with make_renderer(device, scene, **SPLIT, world_cache_leak_prevention="finest") as renderer:
        for _ in range(6):
            renderer.render(scene.camera)
        before = renderer["world_cache_checksums"].copy(), renderer["world_cache_life"].copy()
        renderer.render(scene.camera)
        count = int(renderer["world_cache/active_cells"])
        listed = renderer["world_cache_active_cells"][:count]
        living = np.flatnonzero((before[0] != 0) & (before[1] > 0))
        wrong = len(living) if len(living) != count else int((np.sort(listed) != living).sum())
        yield Measurement(LIST, float(wrong if count > 100 else math.inf), 0.0, f"of {count} wrong")
        keys = renderer["world_cache_checksums"]
        keys = keys[keys != 0]
        yield Measurement(ONCE, float(len(keys) - len(np.unique(keys))), 0.0, "twice")
        renderer.settings.gi = renderer.settings.specular = False
        for _ in range(renderer.settings.world_cache_lifetime + 2):
            renderer.render(scene.camera)
        yield Measurement(DEATH, float(renderer["world_cache/active_cells"]), 0.0, "left")


def _read_cells(renderer: Renderer) -> tuple[float, int]:
    """The mean irradiance of the cells that have been updated at least a dozen times, and the number of these cells."""
    irradiance = renderer["world_cache_irradiance"].astype(np.float64)
    # A cell's count begins at 1 and grows by a quarter with each update.
    settled = irradiance[(renderer["world_cache_checksums"] != 0) & (irradiance[:, 3] >= 4.0)]
    return float(settled[:, :3].mean()) if len(settled) else math.inf, len(settled)


def measure_fixed_point(device: Device, full: bool = False, **settings: Any) -> Iterator[Measurement]:
    """In a closed box whose walls emit 1 and reflect half, the radiance is 2 everywhere and the irradiance 2 pi."""
    effort, bar = (Effort(16, 100, 8), 0.02) if full else (Effort(8, 40, 4), 0.05)
    scene = closed_box()
    expected = math.pi * float(closed_forms.closed_box_radiance(np.ones(1), np.full(1, 0.5), 64)[0])
    counts = []
    chosen: dict[str, Any] = {"world_cache_cells": 1 << 14, "world_cache_updates_per_pixel": 1e9, **settings}
    with make_renderer(device, scene, (16, 16), **chosen) as renderer:

        def observe() -> Image:
            for _ in range(effort.warm_up):
                renderer.render(scene.camera)
            total = 0.0
            for _ in range(effort.observed):
                renderer.render(scene.camera)
                mean, count = _read_cells(renderer)
                total += mean
                counts.append(count)
            return np.array([total / effort.observed])

        found = replicate(renderer, effort.runs, observe)
    measured = measure_mean(FIXED_POINT, found, expected, bar, effort)
    yield measured if min(counts) > 500 else Measurement(FIXED_POINT, math.inf, bar, note=f"{min(counts)} cells only")


# The wall's offset from the cells' grid in meters, its angle in degrees, and the bar.
WALLS = ((0.0, 0, 0.001), (0.075, 0, 0.002), (0.03, 0, 0.002), (0.1, 0, 0.002), (0.0, 45, 0.01), (0.05, 20, 0.01))


def measure_leak(
    device: Device, walls: Sequence[tuple[float, int, float]] = WALLS, **settings: Any
) -> Iterator[Measurement]:
    """The light that leaks through a wall of 2 cm, for walls on the grid of the cells and within cells."""
    for x, turn, bar in walls:
        scene, size = thin_wall(), (32, 32)
        wall = next(instance for instance in scene if instance.name == "wall")
        wall.transform = place((1.0, 1.0, 4.0 if turn else 1.0), (x, 0, 0), math.radians(turn))
        dark = trace(device, scene, 64, size).max(axis=-1) == 0
        dark[:, : size[0] // 2] = False  # the black pixels of this half show the outside of the room
        with make_renderer(device, scene, size, **settings) as renderer:
            for _ in range(24):
                renderer.render(scene.camera)
            picture = np.mean([add_up(renderer.render(scene.camera)) for _ in range(16)], axis=0)
        lit = picture[(picture.max(axis=-1) > 0) & ~dark].mean()
        left = float(picture[dark].mean() / lit) if dark.any() and lit > 0 else math.inf
        note = f"wall at {x:g} m, turned by {turn} degrees"
        yield Measurement(LEAK, left, bar, "of the lit half's light", note)
