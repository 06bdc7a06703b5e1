"""One path a pixel: the path tracer's mean with and without the world cache, its cells, and its noise over frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

import solari_vk as sv
from solari_vk.conformance.oracles import closed_forms
from solari_vk.conformance.pictures import take_picture
from solari_vk.conformance.realtime import (
    GBUFFER,
    JITTER_PERIOD,
    Effort,
    Image,
    make_renderer,
    measure_mean,
    run_pictures,
    trace,
)
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.conformance.specular_checks import metal_gallery
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.replication import replicate
from solari_vk.measure.statistics import sixteenths, student_quantile
from solari_vk.rendered import RenderedFrame
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, matte, rgb

_PATHS = (SUITE, "Paths")
ONE = Rule("with one light sample a vertex and no cache, paths have the path tracer's mean", *_PATHS)
ONE_TILES = Rule("with one light sample a vertex and no cache, no tile differs from the path tracer's", *_PATHS)
SEVERAL = Rule("resampling among several light samples leaves the mean as it is", *_PATHS)
SEVERAL_TILES = Rule("resampling among several light samples leaves each tile as it is", *_PATHS)
CACHED = Rule("without regularization, paths that end in the world cache are as bright as the path tracer's", *_PATHS)
CACHED_TILES = Rule("each of 4 x 4 tiles of paths that end in the world cache is close to the path tracer's", *_PATHS)
SEQUENCE = Rule("consecutive frames average to less noise than independent ones", *_PATHS)
CELLS = Rule("cells over a shiny floor in the sun have the path tracer's irradiance", *_PATHS)

PASSES = (*GBUFFER, "world_cache/", "paths/")
# What the path tracer computes, at the centers of pixels.
PLAIN: dict[str, Any] = {
    "lighting": "paths", "world_cache": False, "paths_candidates": 1, "paths_later_candidates": 1,
    "paths_regularization": 0.0, "paths_bounces": 64, "jitter": False,
}  # fmt: skip
RESAMPLED = {**PLAIN, "paths_candidates": 8, "paths_later_candidates": 4}
DEFAULT: dict[str, Any] = {"lighting": "paths", "jitter": False}
RUNS = {
    "one": (ONE, ONE_TILES, PLAIN), "several": (SEVERAL, SEVERAL_TILES, RESAMPLED),
    "cached": (CACHED, CACHED_TILES, {**DEFAULT, "paths_regularization": 0.0}),
}  # fmt: skip
KINDS = tuple(RUNS)
_CENTERS = ("passes/pathtracer/pixel_filter.glsl", "return radius * (2.0 * u - 1.0);", "return 0.0 * u;")
SIZE = (32, 32)


def read_radiance(frame: RenderedFrame, name: str = "sample_radiance") -> Image:
    """A result of a frame, (h, w, 3)."""
    return np.asarray(frame[name], np.float64)[..., :3]


# ---- means ------------------------------------------------------------------------------------------


def trace_centers(device: Device, scene: sv.Scene, samples: int, **settings: Any) -> Image:
    """16 independent pictures (16, 32, 32, 3) of the path tracer, sampled at the centers of pixels."""
    with patched_shaders(_CENTERS):
        return take_picture(device, scene, SIZE, samples, runs=16, max_bounces=64, **settings).runs


def observe_paths(device: Device, scene: sv.Scene, effort: Effort, **settings: Any) -> Image:
    """The radiance of independent runs (runs, 32, 32, 3)."""
    with make_renderer(device, scene, SIZE, passes=PASSES, **settings) as renderer:
        return run_pictures(renderer, scene.camera, effort, read_radiance)


def measure_tiles(rule: Rule, found: Image, expected: Image) -> Measurement:
    """The largest Student's t of 4 x 4 tiles and their channels between runs (R, h, w, 3) and other runs."""
    ours, theirs = sixteenths(found), sixteenths(expected)
    spread = (ours.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / len(ours)
    right = theirs.mean(axis=0)
    t = np.abs(ours.mean(axis=0) - right) / (np.sqrt(spread) + 1e-5 * right + 1e-30)
    worst = np.unravel_index(t.argmax(), t.shape)
    note = f"row {worst[0]}, column {worst[1]}: {ours.mean(axis=0)[worst] / max(right[worst], 1e-30) - 1:+.2%}"
    bar = student_quantile(len(ours) - 1, 1 - 1e-3 / t.size)  # chance exceeds it once in 1,000 runs at most
    return Measurement(rule, float(t.max()), bar, "standard errors", note)


class Profile(NamedTuple):
    """The effort without and with the cache, and the bars of the mean without the cache, and with it."""

    plain: Effort
    cached: Effort
    bars: tuple[float, float]


FAST = Profile(Effort(16, 0, 64, 4096), Effort(8, 24, 32), (0.02, 0.03))
FULL = Profile(Effort(16, 0, 512, 16384), Effort(16, 24, 256), (0.01, 0.02))


def measure_means(
    device: Device, profile: Profile = FAST, scene: sv.Scene | None = None, kinds: Sequence[str] = KINDS
) -> Iterator[Measurement]:
    """Paths against the path tracer, for metals that show a lamp, a sun, gloss and mirrors, or for `scene`.

    Pixels that show a light itself are left out, unless all do, since the G-buffer rounds emission.
    kinds: which of KINDS are measured.
    """
    scene = scene or metal_gallery()
    measured = trace(device, scene, 64, SIZE, max_bounces=0).max(axis=-1, keepdims=True) == 0
    measured |= not measured.any()
    expected = trace_centers(device, scene, profile.plain.samples) * measured
    for kind, (mean, tiles, settings) in RUNS.items():
        if kind in kinds:
            effort = profile.cached if kind == "cached" else profile.plain
            found = observe_paths(device, scene, effort, **settings) * measured
            yield measure_mean(mean, found, expected, profile.bars[kind == "cached"], effort)
            yield (
                measure_cached_tiles(tiles, found, expected, effort)
                if kind == "cached"
                else measure_tiles(tiles, found, expected)
            )


def measure_cached_tiles(rule: Rule, found: Image, expected: Image, effort: Effort) -> Measurement:
    """The largest error of a tile over the mean of all, since the cache is slightly biased."""
    ours, theirs = (sixteenths(runs).mean(axis=(0, -1)) for runs in (found, expected))
    errors = np.abs(ours - theirs) / theirs.mean()
    note = f"tiles {np.round(100 * errors, 1).tolist()} %"
    return Measurement(rule, float(errors.max()), 0.1, f"of the picture's mean, {effort}", note)


# ---- frames -----------------------------------------------------------------------------------------


def measure_sequence(device: Device) -> Iterator[Measurement]:
    """The variance of the mean of 32 frames, over a 32nd of a frame's variance, where walls glow and reflect."""
    scene, seeds = closed_box(), 8
    with make_renderer(device, scene, SIZE, passes=PASSES, **{**PLAIN, "paths_bounces": 1}) as renderer:
        single, means = 0.0, []
        for seed in range(seeds):
            renderer.seed = seed
            frames = np.stack([read_radiance(renderer.render(scene.camera)) for _ in range(JITTER_PERIOD)])
            single += float(frames.var(axis=0, ddof=1).mean()) / seeds
            means.append(frames.mean(axis=0))
    ratio = float(np.stack(means).var(axis=0, ddof=1).mean() / (single / JITTER_PERIOD))
    yield Measurement(SEQUENCE, ratio, 0.6, "of the variance of independent frames")


# ---- cells ------------------------------------------------------------------------------------------


def metal(color: tuple[float, ...], perceptual_roughness: float) -> sv.Material:
    return sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=perceptual_roughness)


_HEIGHT, _PANEL = 1.1, 0.4  # meters
_SUN = np.array((0.15, -0.75, -0.6))  # where its light travels


def _panel_over_metal(roughness: float) -> sv.Scene:
    """A matte panel that faces a floor of metal in the sun, and a wall whose paths meet the panel from below."""
    scene = sv.Scene(sv.Camera.look_at((0.3, 0.6, 2.4), (0, 0.8, -1), vertical_fov=1.0))
    for mesh, material in (
        (shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), metal((0.95, 0.9, 0.8), math.sqrt(roughness))),
        (shapes.quad((0, _HEIGHT, 0), (_PANEL, 0, 0), (0, 0, _PANEL)), matte(0.5)),
        (shapes.quad((0, 0.5, -1.4), (1.5, 0, 0), (0, 0.5, 0)), matte(0.3)),
    ):
        scene.add(sv.Instance(mesh=mesh, material=material))
    scene.add(sv.DirectionalLight(direction=rgb(_SUN), illuminance=10.0, name="sun"))
    return scene


def measure_cells(device: Device, roughness: float = 0.3, runs: int = 8, **changed: Any) -> Iterator[Measurement]:
    """The irradiance of the panel's cells, against what the path tracer sees on the panel from below."""
    scene = _panel_over_metal(roughness)
    below = sv.Camera.look_at((0, _HEIGHT - 1, 0), (0, _HEIGHT, 0), up=(0, 0, 1), vertical_fov=2 * math.atan(_PANEL))
    # What the panel shows of a known irradiance from where the floor throws the sun: matte isn't quite Lambertian.
    sun = sv.DirectionalLight(direction=rgb(_SUN * (1, -1, 1)), illuminance=1.0)
    lit = trace(device, sv.Scene(scene.instances[1], sun), 256, SIZE, below, max_bounces=1).mean()
    received = closed_forms.sun_irradiance(1.0, sun.angular_diameter, float(-_SUN[1] / np.linalg.norm(_SUN)))
    expected = trace(device, scene, 2048, SIZE, below, max_bounces=64).mean(axis=(0, 1)) * received / lit
    # All cells live until the end and are updated in every frame.
    every = {"world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9, "world_cache_lifetime": 100}
    settings: dict[str, Any] = {**DEFAULT, **every, "world_cache_cell_size": 0.05, **changed}
    with make_renderer(device, scene, SIZE, passes=PASSES, **settings) as renderer:

        def observe() -> Image:
            total = np.zeros(3)
            for frame in range(32):
                renderer.render(scene.camera)
                total += _panel_irradiance(renderer) / 8 if frame >= 24 else 0.0
            return total

        found = replicate(renderer, runs, observe)
    yield measure_mean(CELLS, found[:, None, None], expected, 0.08, Effort(runs, 24, 8))


def _panel_irradiance(renderer: sv.Renderer) -> Image:
    """The mean irradiance (3,) of settled cells around the panel."""
    irradiance, bounds = (renderer[f"world_cache_{name}"].astype(np.float64) for name in ("irradiance", "bounds"))
    center = bounds[:, :3] + bounds[:, 3:] / 2
    near = np.abs(center - (0, _HEIGHT, 0)) < (_PANEL, 0.2, _PANEL)
    settled = near.all(axis=-1) & (renderer["world_cache_checksums"] != 0) & (irradiance[:, 3] >= 4)
    assert settled.sum() > 50, f"only {settled.sum()} cells"
    return np.asarray(irradiance[settled, :3].mean(axis=0))
