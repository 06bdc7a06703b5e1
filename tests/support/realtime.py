"""Realtime frames for the suite: small renderers, and independent runs against the path tracer."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy import stats

from solari_vk.gpu.frame.frame import Draw, Pass, Step
from solari_vk.gpu.shaders.compiler import compile_shader, roots
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.lab.conformance.rules import Measurement
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, place
from solari_vk.scene.model import Instance, Material, Mesh
from solari_vk.settings import RAW, Settings
from support.replication import observe_runs
from support.statistics import relative_interval, sixteenths

# Fewer tiles and cells than by default, for speed; they don't change means.
SMALL = {"light_tile_count": 16, "world_cache_cells": 1 << 18}
PARTS = ("diffuse_radiance", "specular_radiance")  # of the reflected light
# Settings for Solari's passes, for which all cells of the world cache are updated.
SPLIT = {"lighting": "split", "world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9}
# Settings for frames with only surfaces and visible emission, sampled at pixel centers.
OFF = {**SPLIT, "di": False, "gi": False, "specular": False, "world_cache": False, "jitter": False}
# The passes that compute one part of the light, the last three with lighting=split.
GBUFFER = ("gbuffer/",)
DIRECT = (*GBUFFER, "solari019/light_tiles/", "solari019/restir_di/")
INDIRECT = (*GBUFFER, "solari019/light_tiles/", "world_cache/", "solari019/world_cache/", "solari019/restir_gi/")
SPECULAR = (*INDIRECT, "solari019/specular_gi/")
GUIDES = (*GBUFFER, "guides/")
PATHS = (*GBUFFER, "world_cache/", "paths/", "display/compose")
# What the path tracer computes, at the centers of pixels.
PLAIN = {
    "lighting": "paths",
    "world_cache": False,
    "paths_candidates": 1,
    "paths_later_candidates": 1,
    "paths_regularization": 0.0,
    "paths_bounces": 64,
    "jitter": False,
}
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


def make_renderer(device, scene, size=(32, 32), seed=0, passes=None, **settings):
    """A renderer with RAW, SMALL and these settings; with `passes`, it runs only those (see PartialRenderer)."""
    chosen = Settings(**{**RAW, **SMALL, **settings})
    if passes is None:
        return Renderer(device, scene, size, chosen, seed=seed)
    return PartialRenderer(device, scene, size, chosen, seed=seed, passes=passes)


def odd_scene():
    """Slivers, points, a light without area, zero normals, huge and tiny instances, a mirror, and extreme radiance."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0.5, 1e-7, 0), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3)])
    spoiled, ball = Mesh(positions=points, normals=np.zeros((6, 3), np.float32)), shapes.sphere(0.3, 8)
    scene = cornell_box(radiance=(1e8, 1e-3, 0))
    mirror = Material(metallic=1.0, perceptual_roughness=0.0, base_color=(1.0, 1.0, 1.0))
    for mesh, material, scale in (
        (spoiled, lamp(5.0), 1.0),
        (spoiled, mirror, 1.0),
        (ball, mirror, 1.0),
        (ball, lamp(1e6), 1e-5),
        (shapes.box(inward=True), mirror, 1e4),
    ):
        scene.add(Instance(mesh=mesh, material=material, transform=place(scale, (0.8, 1.2, 0.5))))
    return scene


def get_jitter(renderer):
    """The offset of the latest frame's samples from pixel centers, (x, y) in pixels."""
    return np.array(renderer._frame.uniforms["camera.jitter"], np.float64)


def read_radiance(frame, name="sample_radiance"):
    """A result of a frame, (h, w, 3)."""
    return np.asarray(frame[name], np.float64)[..., :3]


def add_up(frame, *names):
    """The sum (h, w, 3) of results, by default of the reflected light."""
    return sum(read_radiance(frame, name) for name in names or PARTS)


def trace(device, scene, samples, size=(32, 32), camera=None, **settings):
    """The path tracer's picture (h, w, 3)."""
    with PathTracer(device, scene, size, **settings) as tracer:
        return np.asarray(tracer.render(camera or scene.camera, samples=samples), np.float64)


def trace_reflected(device, scene, samples, size=(32, 32), camera=None):
    """The path tracer's picture (h, w, 3), black where a pixel shows even a part of a lamp.

    A lamp's own pixels may hold half of a picture's light, and would hide errors of the rest.
    """
    emitted = trace(device, scene, 256, size, camera, max_bounces=0)
    return np.where(emitted > 0, 0.0, trace(device, scene, samples, size, camera))


def run_pictures(renderer, camera, effort, read):
    """The mean of `read(frame)` over the observed frames of each independent run: (runs, ...)."""
    return observe_runs(renderer, camera, read, runs=effort.runs, warm_up=effort.warm_up, observed=effort.observed)


def measure_mean(rule, observations, expected, bar, effort):
    """The end of the 95 % interval of the mean's relative error that is farther from 0."""
    error, half_width = relative_interval(observations, expected)
    note = f"{error:+.2%} +- {half_width:.2%}"
    return Measurement(rule, abs(error) + half_width, bar, f"relative error, {effort}", note)


def measure_picture_tiles(rule, observations, expected, bar, effort):
    """The largest relative error of 4 x 4 tiles of a square picture."""
    found, right = (sixteenths(image).mean(axis=-1) for image in (observations.mean(axis=0), expected))
    errors = found / right - 1
    note = f"tiles {np.round(100 * errors, 1).tolist()} %"
    return Measurement(rule, float(np.abs(errors).max()), bar, f"relative error, {effort}", note)


def measure_significance(rule, observations, expected):
    """The largest Student's t of 4 x 4 tiles and their channels between runs (R, h, w, 3) and `expected`: a picture, or
    other runs. Chance exceeds the bar once in 1,000 runs at most."""
    ours, theirs = sixteenths(observations), sixteenths(expected)
    errors = [stats.sem(runs) for runs in (ours, theirs) if runs.ndim == 4]
    right = theirs.mean(axis=0) if theirs.ndim == 4 else theirs
    t = np.abs(ours.mean(axis=0) - right) / (np.linalg.norm(errors, axis=0) + 1e-5 * right + 1e-30)
    worst = np.unravel_index(t.argmax(), t.shape)
    note = f"row {worst[0]}, column {worst[1]}: {ours.mean(axis=0)[worst] / max(right[worst], 1e-30) - 1:+.2%}"
    bar = float(stats.t.isf(0.5e-3 / t.size, len(ours) - 1))
    return Measurement(rule, float(t.max()), bar, "standard errors", note)
