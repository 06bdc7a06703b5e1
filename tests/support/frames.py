"""Comparisons of realtime frames: which outputs differ, and how much of an earlier picture a frame contains."""

from unittest import mock

import numpy as np
import pytest

from solari_vk.lab.conformance.rules import SUITE, Rule
from solari_vk.passes import reference
from solari_vk.renderers.renderer import LIGHT
from support.realtime import SPLIT, make_renderer, measure_mean, measure_picture_tiles, run_pictures, trace

SIZE = (32, 32)
WHOLE = Rule("a picture is as bright as the path tracer's", SUITE, "Renderer")
TILES = Rule("each of 4 x 4 tiles of a picture is close to the path tracer's", SUITE, "Renderer")
OTHER_OUTPUTS = ("depth", "motion_vectors", "gbuffer", "guides_normal_roughness", "display")


# Tests of whole frames run with the raw light of paths and with the denoiser; when slow tests run, also with light that
# pixels reuse and with Solari's passes. The parameter holds settings.
def _lightings(*quick):
    every = {"raw": {}, "denoised": {"denoise": True, "antialiasing": True}, "reuse": {"restir": True}, "split": SPLIT}
    return pytest.mark.parametrize(
        "lighting",
        [
            pytest.param(settings, id=name, marks=() if name in quick else pytest.mark.slow)
            for name, settings in every.items()
        ],
    )


each_lighting = _lightings("raw", "denoised")
# For what the denoiser would show too: whatever changes raw frames changes denoised ones.
denoised_first = _lightings("denoised")


def find(scene, name):
    return next(instance for instance in scene if instance.name == name)


def settle(renderer, camera, frames=30):
    """Render this many frames, and return the last one."""
    for _ in range(frames):
        frame = renderer.render(camera)
    return frame


def measure_frames(device, scene, effort, samples, bar, tile_bar=None, size=(32, 32), **settings):
    """Compares frames with the path tracer's picture of so many samples; tiles only with a bar for them."""
    expected = trace(device, scene, samples, size, max_bounces=64)
    with make_renderer(device, scene, size, **settings) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda frame: np.asarray(frame["radiance"], np.float64))
    yield measure_mean(WHOLE, found, expected, bar, effort)
    if tile_bar is not None:
        yield measure_picture_tiles(TILES, found, expected, tile_bar, effort)


def lights_of(frame):
    """The names of the frame's radiance and of all its parts."""
    return ["radiance", *(name for name in LIGHT if name in frame)]


def snapshot(frame):
    return {name: frame[name].copy() for name in (*lights_of(frame), *OTHER_OUTPUTS)}


def differing(first, other):
    """Names of the outputs in which two frames differ."""
    names = (*lights_of(first), *OTHER_OUTPUTS)
    return [name for name in names if first[name].tobytes() != other[name].tobytes()]


def left_of(before, now, picture):
    """How much of an earlier picture `before` a picture contains: 0 when it equals the reference `now`, 1 when it
    equals `before`, and in between by projection onto their difference."""
    difference = before - now
    return float(((picture - now) * difference).sum() / (difference**2).sum())


def path_tracer_at_centers():
    """A context in which path tracers sample at the centers of pixels, as realtime frames without jitter do."""
    return mock.patch.dict(reference.PIXEL_FILTERS, box=0.0)


def frames_in_history(frame):
    """The number of frames in the denoiser's history of each pixel's diffuse lobe: the lower half of a word holds a
    positive float without its last bits."""
    return (np.asarray(frame["denoise_diffuse"])[..., 3] << 16 >> 1).view(np.float32)
