"""Indirect light: a bounce of it by ReSTIR GI, and a mirror's by specular GI."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import Effort, add_up, make_renderer, measure_mean, run_pictures, trace
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, rgb

INDIRECT = Rule("one bounce of indirect light in a Cornell box", SUITE, "ReSTIR GI")
MIRROR = Rule("a mirror in a white room is as bright as its Fresnel term", SUITE, "Specular GI")


def measure_indirect(device: Device, full: bool = False) -> Iterator[Measurement]:
    """Without the cache, indirect light is the path tracer's second bounce."""
    effort, bar = (Effort(16, 24, 128, 4096), 0.02) if full else (Effort(), 0.06)
    scene = cornell_box()
    two, one = (trace(device, scene, effort.samples, max_bounces=count) for count in (2, 1))
    with make_renderer(device, scene, world_cache=False, di=False) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda f: add_up(f, "gi_diffuse", "specular_gi"))
    yield measure_mean(INDIRECT, found, two - one, bar, effort)


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
