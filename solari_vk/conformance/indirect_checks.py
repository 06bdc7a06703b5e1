"""One bounce of indirect light by ReSTIR GI."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import solari_vk as sv
from solari_vk.conformance.realtime import (
    SPECULAR,
    SPLIT,
    Effort,
    Image,
    add_up,
    make_renderer,
    measure_mean,
    measure_significance,
    run_pictures,
    trace,
)
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene.builtin import cornell_box

INDIRECT = Rule("one bounce of indirect light in a Cornell box", SUITE, "ReSTIR GI")
SIXTEENTHS = Rule("no tile of 4 x 4 differs significantly from the path tracer's indirect light", SUITE, "ReSTIR GI")


SIZE = (48, 48)
# The effort of the measurement, and the bar.
Profile = tuple[Effort, float]
FAST: Profile = (Effort(16, 24, 64, 2048), 0.03)
FULL: Profile = (Effort(16, 24, 256, 8192), 0.0075)


def trace_second_bounce(device: Device, scene: sv.Scene, samples: int) -> Image:
    """The path tracer's picture with two bounces minus that with one (h, w, 3)."""
    two, one = (trace(device, scene, samples, SIZE, max_bounces=count) for count in (2, 1))
    return two - one


def observe_indirect(device: Device, scene: sv.Scene, effort: Effort, **settings: Any) -> Image:
    """One bounce of indirect light in independent runs (runs, h, w, 3), rendered without the world cache."""
    alone: dict[str, Any] = {"passes": SPECULAR, **SPLIT, "world_cache": False, "di": False}
    with make_renderer(device, scene, SIZE, **alone, **settings) as renderer:
        return run_pictures(renderer, scene.camera, effort, lambda frame: add_up(frame, "gi_diffuse", "specular_gi"))


def measure_indirect(device: Device, profile: Profile = FAST) -> Iterator[Measurement]:
    """Without the cache, indirect light is the path tracer's second bounce."""
    effort, bar = profile
    scene = cornell_box()
    expected = trace_second_bounce(device, scene, effort.samples)
    found = observe_indirect(device, scene, effort)
    yield measure_mean(INDIRECT, found, expected, bar, effort)
    yield measure_significance(SIXTEENTHS, found, expected)
