"""Renderers that compute only direct light, by ReSTIR DI with samples at pixel centers."""

from __future__ import annotations

from solari_vk.conformance.direct_checks import read_direct
from solari_vk.conformance.realtime import DIRECT, SPLIT, make_renderer

QUICK = {**SPLIT, "gbuffer": "traced", "jitter": False, "light_tile_count": 32, "light_tile_samples": 256}
direct_light = read_direct


def direct_renderer(device, scene, size, **settings):
    return make_renderer(device, scene, size, passes=DIRECT, **(QUICK | settings))
