"""Paths against the path tracer: the rules of their means, for any scene."""

import math
from typing import NamedTuple

import numpy as np

import solari_vk as sv
from solari_vk.lab.conformance.rules import SUITE, Measurement, Rule
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, place, rgb
from support import realtime
from support.frames import path_tracer_at_centers
from support.pictures import take_picture
from support.realtime import PATHS, PLAIN, Effort, make_renderer, read_radiance, run_pictures, trace
from support.statistics import sixteenths

_PATHS = (SUITE, "Paths")
ONE = Rule("with one light sample a vertex and no cache, paths have the path tracer's mean", *_PATHS)
ONE_TILES = Rule("with one light sample a vertex and no cache, no tile differs from the path tracer's", *_PATHS)
SEVERAL = Rule("resampling among several light samples leaves the mean as it is", *_PATHS)
SEVERAL_TILES = Rule("resampling among several light samples leaves each tile as it is", *_PATHS)
CACHED = Rule("without regularization, paths that end in the world cache are as bright as the path tracer's", *_PATHS)
CACHED_TILES = Rule("each of 4 x 4 tiles of paths that end in the world cache is close to the path tracer's", *_PATHS)

SIZE = (32, 32)
SAME_SURFACES = {**PLAIN, "gbuffer": "traced"}  # those of the path tracer; raster finds others at edges
RESAMPLED = {**SAME_SURFACES, "paths_candidates": 8, "paths_later_candidates": 4}
DEFAULT = {"lighting": "paths", "jitter": False}
RUNS = {
    "one": (ONE, ONE_TILES, SAME_SURFACES),
    "several": (SEVERAL, SEVERAL_TILES, RESAMPLED),
    "cached": (CACHED, CACHED_TILES, {**DEFAULT, "paths_regularization": 0.0}),
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
        return take_picture(device, scene, SIZE, samples, runs=16, max_bounces=64, **settings).runs


def observe_paths(device, scene, effort, **settings):
    """The radiance of independent runs (runs, 32, 32, 3)."""
    with make_renderer(device, scene, SIZE, passes=PATHS, **settings) as renderer:
        return run_pictures(renderer, scene.camera, effort, read_radiance)


def find_unlit(device, scene):
    """Pixels (32, 32, 1) that show no light itself, since the G-buffer rounds emission; all, if there are none."""
    dark = trace(device, scene, 64, SIZE, max_bounces=0).max(axis=-1, keepdims=True) == 0
    return dark | ~dark.any()


class Profile(NamedTuple):
    """The effort without and with the cache, and the bars of the mean without the cache, and with it."""

    plain: Effort
    cached: Effort
    bars: tuple[float, float]


FULL = Profile(Effort(16, 0, 128, 8192), Effort(16, 24, 64), (0.01, 0.02))


def measure_means(device, profile, scene=None, kinds=tuple(RUNS)):
    """Paths against the path tracer, for metals that show a lamp, a sun, gloss and mirrors, or for `scene`.

    kinds: which of RUNS are measured.
    """
    scene = scene or metal_gallery()
    measured = find_unlit(device, scene)
    expected = trace_centers(device, scene, profile.plain.samples) * measured
    for kind in kinds:
        mean, tiles, settings = RUNS[kind]
        effort = profile.cached if kind == "cached" else profile.plain
        found = observe_paths(device, scene, effort, **settings) * measured
        yield realtime.measure_mean(mean, found, expected, profile.bars[kind == "cached"], effort)
        if kind == "cached":
            # Over the mean of all tiles, since the cache is slightly biased.
            ours, theirs = (sixteenths(runs).mean(axis=(0, -1)) for runs in (found, expected))
            errors = np.abs(ours - theirs) / theirs.mean()
            note = f"tiles {np.round(100 * errors, 1).tolist()} %"
            yield Measurement(tiles, float(errors.max()), 0.1, f"of the picture's mean, {effort}", note)
        else:
            yield realtime.measure_significance(tiles, found, expected)
