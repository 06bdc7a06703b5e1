"""Frames and path-traced pictures for tests: renderers, independent runs, what frames hold, and runs of shaders."""

from __future__ import annotations

import ctypes
import dataclasses
import itertools
import math
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest import mock

import numpy as np
import pytest
from support.scenes import WALL_SIZE
from support.seeded_bugs import Bug, Measurement, Rule, seeded
from support.statistics import measure_mean, measure_picture_tiles, measure_tiles_t, tile_means_4x4

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import MATERIAL_FIELDS, MATERIAL_SOLID, NO_INDEX
from solari_vk.bound.features import LOBES
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Draw, Pass, Step
from solari_vk.gpu.shaders.compiler import compile_shader, roots
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import reference
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import RADIANCE_COMPONENTS, Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, place, rgb
from solari_vk.scene.material import TEXTURES
from solari_vk.settings import RAW, Settings

# Fewer tiles and cells than by default, for speed; they don't change means.
SMALL = {"light_tile_count": 16, "world_cache_cells": 1 << 18}
PARTS = ("diffuse_radiance", "specular_radiance")  # of the reflected light
# Settings for Solari's passes, for which all cells of the world cache are updated.
SPLIT_LIGHTING = {"lighting": "split", "world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9}
# Settings for frames with only surfaces and visible emission, sampled at pixel centers.
LIGHT_OFF = {**SPLIT_LIGHTING, "di": False, "gi": False, "specular": False, "world_cache": False, "jitter": False}
# The passes that compute one part of the light, the last three with lighting=split.
GBUFFER = ("gbuffer/",)
DIRECT = (*GBUFFER, "solari019/light_tiles/", "solari019/restir_di/")
INDIRECT = (*GBUFFER, "solari019/light_tiles/", "world_cache/", "solari019/world_cache/", "solari019/restir_gi/")
SPECULAR = (*INDIRECT, "solari019/specular_gi/")
GUIDES = (*GBUFFER, "guides/")
PATHS = (*GBUFFER, "camera_medium", "world_cache/", "paths/", "display/compose")
# What the path tracer computes, at the centers of pixels.
PLAIN_PATHS = {
    "lighting": "paths",
    "world_cache": False,
    "paths_candidates": 1,
    "paths_later_candidates": 1,
    "paths_regularization": 0.0,
    "paths_bounces": 64,
    "jitter": False,
}
FRAME_SIZE = (32, 32)  # where a test gives no other
JITTER_PERIOD = 32  # number of frames after which samples cover the pixel evenly, so that edges add no noise


@dataclass(frozen=True)
class Effort:
    """The effort of a measurement: independent runs, their warm-up and observed frames, the path tracer's samples.

    Frames of a run are correlated, so more runs reduce noise more than more frames.
    """

    runs: int = 8
    warm_up: int = 24
    observed: int = JITTER_PERIOD
    samples: int = 512

    def __str__(self) -> str:
        return f"{self.runs} runs of {self.observed} frames"


class PartialRenderer(Renderer):
    """The frame with only those passes whose names start with one of `passes`, such as "gbuffer/" or "paths/", so that
    the shaders of all others need not be compiled.

    A resource that a running pass only declares, because another pass writes it, holds zeros.
    """

    def __init__(self, *args, passes, **options):
        self._passes = tuple(passes)
        super().__init__(*args, **options)

    def _stages(self, size):
        stages = super()._stages(size)
        sources = Sources(roots())
        kept = [[step for step in stage.passes if step.name.startswith(self._passes)] for stage in stages]
        declared = set().union(*(declared_resources(step, sources) for steps in kept for step in steps))
        known = {name.removeprefix("previous_") for name in declared}
        return [
            dataclasses.replace(
                stage,
                passes=steps,
                buffers={name: size for name, size in stage.buffers.items() if name.removeprefix("previous_") in known},
                images={name: size for name, size in stage.images.items() if name in known},
            )
            for stage, steps in zip(stages, kept, strict=True)
        ]


def declared_resources(step, sources):
    """The names of all resources that a step's shaders declare, and of what it draws into."""
    if isinstance(step, Step):
        return {*step.reads, *step.writes}
    suffixes = ("comp",) if isinstance(step, Pass) else ("vert", "frag")
    paths = [f"passes/{step.name}.{suffix}" for suffix in suffixes]
    modules = [reflect(compile_shader(path, header=step.header, root=sources), path) for path in paths]
    drawn = {step.depth} if isinstance(step, Draw) else set()
    return drawn.union(*(module.bindings for module in modules))


def make_renderer(device, scene, size=FRAME_SIZE, seed=0, passes=None, **settings):
    """A renderer with RAW, SMALL and these settings; with `passes`, it runs only those (see PartialRenderer)."""
    chosen = Settings(**{**RAW, **SMALL, **settings})
    if passes is None:
        return Renderer(device, scene, size, chosen, seed=seed)
    return PartialRenderer(device, scene, size, chosen, seed=seed, passes=passes)


def uniforms_of(renderer):
    """The uniform blocks of a renderer's latest frame, which no user of a renderer needs."""
    return renderer._frame.uniforms


def get_jitter(renderer):
    """The offset of the latest frame's samples from pixel centers, (x, y) in pixels."""
    return np.array(uniforms_of(renderer)["camera.jitter"], np.float64)


def choose_dispatches(tracer, rows=None, samples=None):
    """Let a path tracer's dispatches take so many rows and samples, which it chooses by their time otherwise."""
    if samples is not None:
        tracer._dispatch.samples = samples
        tracer._dispatch.next_measurement = 10**9  # a number of samples that no test reaches
    if rows is not None:
        tracer._dispatch.rows = rows
        tracer._frame.rebuild(tracer._stages(tracer.size))


def read_radiance(frame, name="sample_radiance"):
    """A result of a frame, (h, w, 3)."""
    return np.asarray(frame[name], np.float64)[..., :3]


def add_up(frame, *names):
    """The sum (h, w, 3) of results, by default of the reflected light."""
    return sum(read_radiance(frame, name) for name in names or PARTS)


def path_traced(device, scene, samples, size=FRAME_SIZE, camera=None, **settings):
    """The path tracer's picture (h, w, 3)."""
    with PathTracer(device, scene, size, **settings) as tracer:
        return np.asarray(tracer.render(camera or scene.camera, samples=samples), np.float64)


def path_traced_reflected(device, scene, samples, size=FRAME_SIZE, camera=None):
    """The path tracer's picture (h, w, 3), black where a pixel shows even a part of a lamp.

    A lamp's own pixels may hold half of a picture's light, and would hide errors of the rest.
    """
    emitted = path_traced(device, scene, 256, size, camera, max_bounces=0)
    return np.where(emitted > 0, 0.0, path_traced(device, scene, samples, size, camera))


# ---- independent runs ----


def replicate(renderer, runs, observe):
    """What `observe` returns after a reset with each of the seeds 0 to runs - 1, (runs, ...); all must be finite.

    Each run has a seed and a history of its own (P-REPL of TESTING.md), so that runs are independent of each other.
    """
    found = []
    for seed in range(runs):
        renderer.seed = seed
        renderer.reset()
        found.append(np.asarray(observe(), np.float64))
        assert np.isfinite(found[-1]).all(), f"seed {seed}: a value is not finite"
    return np.stack(found)


def observe_runs(renderer, camera, effort, read):
    """The mean of `read(frame)` over the observed frames of each independent run, after its warm-up: (runs, ...)."""

    def observe():
        for _ in range(effort.warm_up):
            renderer.render(camera)
        total = 0.0
        for _ in range(effort.observed):
            total = total + np.asarray(read(renderer.render(camera)), np.float64)
        return total / effort.observed

    return replicate(renderer, effort.runs, observe)


WHOLE = Rule("a picture is as bright as the path tracer's")
TILES = Rule("each of 4 x 4 tiles of a picture is close to the path tracer's")
OTHER_OUTPUTS = ("depth", "motion_vectors", "gbuffer", "guides_normal_roughness", "display")


# ---- what frames hold ----


# Tests of whole frames run with the raw light of paths and with the denoiser; when slow tests run, also with light that
# pixels reuse and with Solari's passes. The parameter holds settings.
def _lightings(*quick):
    every = {
        "raw": {},
        "denoised": {"denoise": True, "antialiasing": True},
        "reuse": {"restir": True},
        "split": SPLIT_LIGHTING,
    }
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


def render_frames(renderer, camera, frames=30):
    """Render this many frames, and return the last one."""
    for _ in range(frames):
        frame = renderer.render(camera)
    return frame


def measure_frames(device, scene, effort, samples, bar, tile_bar=None, size=FRAME_SIZE, **settings):
    """Compares frames with the path tracer's picture of so many samples; tiles only with a bar for them."""
    expected = path_traced(device, scene, samples, size, max_bounces=64)
    with make_renderer(device, scene, size, **settings) as renderer:
        found = observe_runs(renderer, scene.camera, effort, lambda frame: np.asarray(frame["radiance"], np.float64))
    yield measure_mean(WHOLE, found, expected, bar, effort)
    if tile_bar is not None:
        yield measure_picture_tiles(TILES, found, expected, tile_bar, effort)


def light_outputs(frame):
    """The names of the frame's radiance and of all its parts."""
    return ["radiance", *(name for name in RADIANCE_COMPONENTS if name in frame)]


def snapshot(frame):
    return {name: frame[name].copy() for name in (*light_outputs(frame), *OTHER_OUTPUTS)}


def differing_outputs(first, other):
    """Names of the outputs in which two frames differ."""
    names = (*light_outputs(first), *OTHER_OUTPUTS)
    return [name for name in names if first[name].tobytes() != other[name].tobytes()]


def share_of_earlier(before, now, picture):
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


# ---- pictures of the path tracer ----


@dataclass
class Picture:
    """A picture as R independent parts of its samples, (R, h, w, 3)."""

    runs: Any

    @property
    def mean(self):
        """The mean of the parts (h, w, 3), float64."""
        return self.runs.mean(axis=0, dtype=np.float64)

    @property
    def variance(self):
        """The variance of the mean (h, w, 3)."""
        return self.runs.var(axis=0, ddof=1, dtype=np.float64) / len(self.runs)


def path_traced_runs(device, scene, size=(48, 48), samples=64, *, runs=8, camera=None, **settings):
    """Take a picture of `samples` per pixel in `runs` parts of different seeds; settings are those of PathTracer.

    The variance comes from the spread of the parts, which are independent, as samples of one seed aren't.
    """
    parts = []
    with PathTracer(device, scene, size, **settings) as renderer:
        for run in range(runs):
            renderer.seed = settings.get("seed", 0) + 1000 * run
            image = renderer.render(camera or scene.camera, samples=max(samples // runs, 1))["radiance"]
            assert (image.shape, image.dtype) == ((size[1], size[0], 3), np.float32)
            assert np.isfinite(image).all()
            parts.append(image.astype(np.float64))
    return Picture(np.stack(parts))


# ---- parts of the light ----


# Passes and settings for frames that contain only direct light.
DIRECT_ONLY = {"passes": DIRECT, **SPLIT_LIGHTING, "gi": False, "specular": False, "world_cache": False}
QUICK = {**SPLIT_LIGHTING, "gbuffer": "traced", "jitter": False, "light_tile_count": 32, "light_tile_samples": 256}


def direct_light(frame):
    """The reflected direct light of a frame, (h, w, 3)."""
    return add_up(frame, "di_diffuse", "di_specular")


def direct_renderer(device, scene, size, **settings):
    """A renderer with few light tiles whose samples lie at pixel centers."""
    return make_renderer(device, scene, size, passes=DIRECT, **(QUICK | settings))


# ---- paths against the path tracer ----


ONE = Rule("with one light sample a vertex and no cache, paths have the path tracer's mean")
ONE_TILES = Rule("with one light sample a vertex and no cache, no tile differs from the path tracer's")
SEVERAL = Rule("resampling among several light samples leaves the mean as it is")
SEVERAL_TILES = Rule("resampling among several light samples leaves each tile as it is")
CACHED = Rule("without regularization, paths that end in the world cache are as bright as the path tracer's")
CACHED_TILES = Rule("each of 4 x 4 tiles of paths that end in the world cache is close to the path tracer's")

SAME_SURFACES = {**PLAIN_PATHS, "gbuffer": "traced"}  # those of the path tracer; raster finds others at edges
RESAMPLED = {**SAME_SURFACES, "paths_candidates": 8, "paths_later_candidates": 4}
PATHS_DEFAULT = {"lighting": "paths", "jitter": False}
PATHS_RUNS = {
    "one": (ONE, ONE_TILES, SAME_SURFACES),
    "several": (SEVERAL, SEVERAL_TILES, RESAMPLED),
    "cached": (CACHED, CACHED_TILES, {**PATHS_DEFAULT, "paths_regularization": 0.0}),
}


def metal_gallery():
    """Four metal panels of growing roughness fill the picture; they show a room with a lamp, a sun and a glossy ball.

    From the top left: a mirror, and roughness 0.02, 0.16 and 0.5. Metals: all that leaves them is specular.
    """
    scene = sv.Scene(name="metal_gallery")
    for at, perceptual_roughness in enumerate(np.array((0, 36, 102, 181)) / 255):  # 8 bits hold them
        x, y = (-1.0, 1.0)[at % 2], (3.0, 1.0)[at // 2]
        metal = sv.Material(base_color=rgb((0.95, 0.7, 0.4)), metallic=1.0, perceptual_roughness=perceptual_roughness)
        panel = shapes.quad((x, y, -2.0), (1.0, 0, 0), (0, 1.0, 0))
        scene.add(sv.Instance(mesh=panel, material=metal, name=f"panel {at}"))
    corners = {
        "floor": [(-3, 0, -2), (-3, 0, 3), (3, 0, 3), (3, 0, -2)],
        "left": [(-3, 0, 3), (-3, 0, -2), (-3, 4, -2), (-3, 4, 3)],
        "back": [(3, 0, 3), (-3, 0, 3), (-3, 4, 3), (3, 4, 3)],
    }
    colors = (rgb(0.6), rgb((0.7, 0.2, 0.1)), rgb((0.2, 0.3, 0.6)))
    for (name, polygon), color in zip(corners.items(), colors, strict=True):
        wall = sv.Material(base_color=color, perceptual_roughness=0.5, name=name)
        scene.add(sv.Instance(mesh=shapes.polygons(polygon), material=wall, name=name))
    gloss = sv.Material(base_color=rgb(0.8), perceptual_roughness=0.3, name="gloss")
    scene.add(shapes.sphere(0.6, 24), gloss, place(at=(-0.8, 0.6, 1.2)), name="ball")
    mirror = sv.Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")
    scene.add(shapes.sphere(0.4, 24), mirror, place(at=(0.9, 0.4, 0.9)), name="mirror")
    # In strips, so that paths may take as many light samples as they are set to.
    strips = [[(x, 3.9, 0.5), (x + 0.5, 3.9, 0.5), (x + 0.5, 3.9, 2.5), (x, 3.9, 2.5)] for x in (-0.7, -0.2, 0.3, 0.8)]
    light = shapes.polygons(*strips, name="lamp")
    scene.add(sv.Instance(mesh=light, material=lamp((4.0, 3.5, 3.0)), name="lamp"))
    scene.add(sv.DirectionalLight(direction=rgb((-0.6, -0.7, -0.15)), illuminance=3.0, angular_diameter=0.6))
    scene.add(sv.Camera.look_at((0, 2, 0.2), (0, 2, -2), vertical_fov=2 * math.atan(1.95 / 2.2)))
    return scene


def trace_centers(device, scene, samples, **settings):
    """16 independent pictures (16, 32, 32, 3) of the path tracer, sampled at the centers of pixels."""
    with path_tracer_at_centers():
        return path_traced_runs(device, scene, FRAME_SIZE, samples, runs=16, max_bounces=64, **settings).runs


def observe_paths(device, scene, effort, **settings):
    """The radiance of independent runs (runs, 32, 32, 3)."""
    with make_renderer(device, scene, FRAME_SIZE, passes=PATHS, **settings) as renderer:
        return observe_runs(renderer, scene.camera, effort, read_radiance)


def unlit_pixels(device, scene):
    """Pixels (32, 32, 1) that show no light itself, since the G-buffer rounds emission; all, if there are none."""
    dark = path_traced(device, scene, 64, FRAME_SIZE, max_bounces=0).max(axis=-1, keepdims=True) == 0
    return dark | ~dark.any()


def measure_paths(device, scene, samples, runs):
    """Paths against the path tracer's picture of so many samples.

    runs: kinds of PATHS_RUNS, each with its effort and the bar of the mean, "cached" also with the bar of its tiles.
    """
    measured = unlit_pixels(device, scene)
    expected = trace_centers(device, scene, samples) * measured
    for kind, (effort, bar, *tile_bar) in runs.items():
        mean, tiles, settings = PATHS_RUNS[kind]
        found = observe_paths(device, scene, effort, **settings) * measured
        yield measure_mean(mean, found, expected, bar, effort)
        if kind == "cached":
            # Over the mean of all tiles, since the cache is slightly biased.
            ours, theirs = (tile_means_4x4(pictures).mean(axis=(0, -1)) for pictures in (found, expected))
            errors = np.abs(ours - theirs) / theirs.mean()
            note = f"tiles {np.round(100 * errors, 1).tolist()} %"
            yield Measurement(tiles, float(errors.max()), *tile_bar, f"of the picture's mean, {effort}", note)
        else:
            yield measure_tiles_t(tiles, found, expected)


@contextmanager
def frames_of_known_light(device, scene, file, function, body, passes, **settings):
    """A renderer in which a function of a shader, which gives a sample of light, has this body."""
    given = Bug(file, function, body)
    with seeded(given), make_renderer(device, scene, WALL_SIZE, passes=passes, **settings) as renderer:
        yield renderer


# ---- runs of shaders ----


# brdf.comp of tests/proofs/brdf computes samples, values or albedos of materials for given directions.
_NUMPY = {"float": ("<f4", ()), "vec2": ("<f4", 2), "vec3": ("<f4", 3), "uint": ("<u4", ())}
MATERIAL_RECORD = np.dtype(
    [(name, *_NUMPY[kind]) for name, kind in MATERIAL_FIELDS.items()]
    + [("inside", "<u4"), ("coat_normal", "<f4", 3), ("anisotropy_direction", "<f4", 2)]
)
WITHOUT_LOBES = {
    **dict.fromkeys(TEXTURES, NO_INDEX),
    "ior": 1.5,
    "specular": 1.0,
    "coat_normal": (0.0, 0.0, 1.0),
    "anisotropy_direction": (1.0, 0.0),
}
"""The fields of a record whose value is not 0 for a material without lobes that few materials have."""
MODES = ("draw", "evaluate", "albedo", "sampled_albedo", "lobe_albedos")
ALL_LOBES = dict.fromkeys(LOBES, True)
"""The constants for materials with such lobes."""
RESULT_COUNT = 4  # vectors that the shader writes for each row


def material_records(base_color=1.0, reflectance=0.5, metallic=0.0, roughness=0.5, solid=False, **lobes):
    """Records of the broadcast arguments; colors may be numbers or (..., 3). lobes: fields of MATERIAL_RECORD, of
    all records."""
    shape = np.broadcast_shapes(np.shape(metallic), np.shape(roughness), np.shape(base_color)[:-1], (1,))
    records = np.zeros(shape, MATERIAL_RECORD)
    given = {**WITHOUT_LOBES, **lobes, "flags": MATERIAL_SOLID * solid}
    given |= {"metallic": metallic, "perceptual_roughness": roughness}
    for name, value in (("base_color", base_color), ("reflectance", reflectance)):
        given[name] = value if np.ndim(value) else np.full(3, value)
    for name, value in given.items():
        records[name] = value
    return records.ravel()


def direction_at(degrees, turn=0.4):
    """A direction (3,) at this angle from the normal; `turn` is its azimuth in radians."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], np.float32)


def run_brdf(shaders, mode, count, records, wo, wi=(0.0, 0.0, 0.0), **constants):
    """The rows (count, 4, 3) that brdf.comp writes; constants are its specialization constants."""
    wo, wi = (np.atleast_2d(np.asarray(directions, np.float32)) for directions in (wo, wi))
    given = {"test_materials": records, "outgoing": wo, "incoming": wi, **shaders.brdf_tables()}
    constants = {"MODE": MODES.index(mode), **constants}
    out = shaders.run("test/brdf", count, given, {"results": RESULT_COUNT * count}, constants=constants)
    return out["results"].reshape(count, RESULT_COUNT, 3)


def run_albedo(shaders, records, wo, **constants):
    """Directional albedo (N, 3) of each material seen from the direction of the same row."""
    count = max(len(records), len(np.atleast_2d(wo)))
    return run_brdf(shaders, "albedo", count, records, wo, **constants)[:, 0]


@contextmanager
def bound_scene(device, scene):
    """The binder of a scene, updated once, and destroyed when the device is done."""
    binder = SceneBinder(device, scene)
    try:
        binder.update()
        yield binder
    finally:
        device.wait_idle()
        binder.destroy()


# ---- memory, and calls that fail ----


def resident_bytes() -> int:
    """The memory of this process in bytes, 0 where there is no /proc.

    Without what the C library keeps of freed memory, whose holes grow where a driver compiles in several threads.
    """
    if os.name != "posix":
        return 0
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    if not os.path.exists("/proc/self/statm"):
        return 0
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * mmap.PAGESIZE


@contextmanager
def leaves_nothing(device: Device) -> Iterator[None]:
    """Fail if there are other objects on the device afterwards."""
    device.wait_idle()
    before = device.objects_in_use
    yield
    device.wait_idle()
    assert device.objects_in_use == before


def fail_after(patch, owner, name, calls):
    """After `calls` calls which work, one call of an owner's function fails."""
    function = getattr(owner, name)
    made = itertools.count()

    def call(*arguments, **options):
        if next(made) == calls:
            raise SolariError("out of memory")
        return function(*arguments, **options)

    patch.setattr(owner, name, call)
