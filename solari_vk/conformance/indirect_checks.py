"""Indirect light: a bounce of it by ReSTIR GI, and a mirror's by specular GI."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import (
    SPECULAR,
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
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, rgb

INDIRECT = Rule("one bounce of indirect light in a Cornell box", SUITE, "ReSTIR GI")
SIXTEENTHS = Rule("no sixteenth's indirect light differs significantly from the path tracer's", SUITE, "ReSTIR GI")
MIRROR = Rule("a mirror in a white room is as bright as its Fresnel term", SUITE, "Specular GI")


SIZE = (48, 48)
# How much is measured, and the bar.
Profile = tuple[Effort, float]
FAST: Profile = (Effort(16, 24, 64, 2048), 0.03)
FULL: Profile = (Effort(16, 24, 256, 8192), 0.0075)


def trace_second_bounce(device: Device, scene: sv.Scene, samples: int) -> Image:
    """What the path tracer finds with two bounces and not with one (h, w, 3)."""
    two, one = (trace(device, scene, samples, SIZE, max_bounces=count) for count in (2, 1))
    return two - one


def observe_indirect(device: Device, scene: sv.Scene, effort: Effort, **settings: Any) -> Image:
    """Indirect light of independent runs (runs, h, w, 3), without the cache: of one bounce."""
    with make_renderer(device, scene, SIZE, passes=SPECULAR, world_cache=False, di=False, **settings) as renderer:
        return run_pictures(renderer, scene.camera, effort, lambda frame: add_up(frame, "gi_diffuse", "specular_gi"))


def measure_indirect(device: Device, profile: Profile = FAST) -> Iterator[Measurement]:
    """Without the cache, indirect light is the path tracer's second bounce."""
    effort, bar = profile
    scene = cornell_box()
    expected = trace_second_bounce(device, scene, effort.samples)
    found = observe_indirect(device, scene, effort)
    yield measure_mean(INDIRECT, found, expected, bar, effort)
    yield measure_significance(SIXTEENTHS, found, expected)


def measure_mirror(device: Device) -> Iterator[Measurement]:
    """A flat mirror of metal within walls that all emit 1: what it shows is Schlick's Fresnel term."""
    room = sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=lamp(1.0))
    color = np.array((0.9, 0.6, 0.3))
    gold = sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=0.0)
    mirror = sv.Instance(mesh=shapes.quad((0, 0, -2), (3, 0, 0), (0, 3, 0)), material=gold)
    camera = sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2)
    size = (24, 24)
    with make_renderer(device, sv.Scene(room, mirror, camera), size, jitter=False) as renderer:
        for _ in range(2):
            frame = renderer.render(camera)
        found = add_up(frame)
    across = (2 * (np.arange(24) + 0.5) / 24 - 1) * math.tan(0.6)
    cosine = 1 / np.sqrt(1 + across[None, :] ** 2 + across[:, None] ** 2)
    expected = color + (1 - color) * (1 - cosine[..., None]) ** 5
    # Of the mean: single pixels also show the faint sheen of the walls.
    error = np.abs(found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1)) - 1).max()
    yield Measurement(MIRROR, float(error), 0.01, "relative error")
