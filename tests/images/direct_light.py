"""Direct light alone: the realtime frame up to ReSTIR DI, and what the path tracer makes of the same."""

from __future__ import annotations

from unittest import mock

import numpy as np

import solari_vk as sv
from solari_vk.gpu.frame.frame import Stage
from solari_vk.passes import gbuffer, light_tiles, pathtracer, restir_di
from solari_vk.renderer import Renderer
from solari_vk.settings import Settings

QUICK = {"gbuffer": "traced", "jitter": False, "light_tile_count": 32, "light_tile_samples": 256}


class DirectRenderer(Renderer):
    """Without the passes that direct light doesn't need, whose shaders take a minute to compile."""

    def _stages(self, size):
        settings = self.settings
        return [
            gbuffer.stage(size, settings, self.binder.instance_capacity),
            light_tiles.stage(size, settings),
            restir_di.stage(size, settings),
            Stage("counters", buffers={"ray_counts": 8}),
        ]


def direct_renderer(device, scene, size, **settings):
    return DirectRenderer(device, scene, size, Settings(**(QUICK | settings)))


def direct_light(frame):
    """What the primary surface sends on of light straight from lights, (height, width, 3)."""
    return frame["di_diffuse"].astype(np.float64) + frame["di_specular"]


def reference(device, scene, size, samples, **settings):
    """The same by the path tracer, all samples at the pixels' centres."""
    with mock.patch.dict(pathtracer.PIXEL_FILTERS, box=0.0):
        emission = _render(device, scene, size, 1, max_bounces=0, **settings)
        return _render(device, scene, size, samples, max_bounces=1, **settings) - emission


def _render(device, scene, size, samples, **settings):
    tracer = sv.PathTracer(device, scene, size, **settings)
    try:
        return tracer.render(scene.camera, samples=samples)["radiance"].astype(np.float64)
    finally:
        tracer.close()


def lit_share(device, scene, size, frames=64, **settings):
    """How much of the light in front of each pixel's surface isn't hidden, (height, width); NaN where there is none."""
    plain = {"di_candidates": 1, "di_temporal": False, "di_spatial": False}
    with direct_renderer(device, scene, size, **(settings | plain)) as renderer:
        seen, tried = 0.0, 0.0
        for _ in range(frames):
            frame = renderer.render(scene.camera)
            tried = tried + (frame["di_reservoirs"]["unbiased_contribution_weight"] > 0)
            seen = seen + frame["di_outcomes"][..., 1]
    return np.where(tried > 0, seen / np.maximum(tried, 1), np.nan)
