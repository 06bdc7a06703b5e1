"""Whole frames: renderers with the settings that these tests share, so that their pipelines are made once; truth from
the path tracer; and how much of an earlier picture is still seen."""

from __future__ import annotations

import numpy as np

import solari_vk as sv

SIZE = (32, 32)
# Fewer tiles and cells than in use, for speed: neither changes a mean, and these pictures need no more.
SMALL = {"light_tile_count": 16, "world_cache_cells": 1 << 18}
LIGHT = ("di_diffuse", "di_specular", "gi_diffuse", "specular_gi")
OUTPUTS = ("radiance", *LIGHT, "emission", "diffuse_radiance", "specular_radiance", "display", "depth",
           "motion_vectors", "gbuffer", "guides_normal_roughness")  # fmt: skip


def make_renderer(device, scene, size=SIZE, seed=0, **settings):
    return sv.Renderer(device, scene, size, sv.Settings(**{**SMALL, **settings}), seed=seed)


def reflected(frame):
    """Radiance without what surfaces emit by themselves (h, w, 3)."""
    return sum(np.asarray(frame[name], np.float64)[..., :3] for name in LIGHT)


def truth(device, scene, samples, camera=None, size=SIZE, max_bounces=16, seed=0):
    """The path tracer's picture (h, w, 3)."""
    tracer = sv.PathTracer(device, scene, size, max_bounces=max_bounces, seed=seed)
    try:
        return tracer.render(camera or scene.camera, samples=samples).astype(np.float64)
    finally:
        tracer.close()


def reflected_truth(device, scene, samples, camera=None, size=SIZE, seed=0):
    """The path tracer's picture without emission."""
    emitted = truth(device, scene, 256, camera, size, max_bounces=0, seed=seed)
    picture = truth(device, scene, samples, camera, size, seed=seed)
    return np.where(emitted > 0, 0.0, picture)  # pixels that show a lamp, even in part, are left out


def left_of(before, now, picture):
    """Which share of the difference between an earlier picture and the present truth is in a picture still: 1 when it
    is the earlier one, 0 when nothing is left of it; noise is averaged over all of the picture."""
    difference = before - now
    return float(((picture - now) * difference).sum() / (difference**2).sum())


def find(scene, name):
    return next(instance for instance in scene if instance.name == name)


def same_bits(first, other):
    """Names of the outputs in which two frames differ."""
    return [name for name in OUTPUTS if first[name].tobytes() != other[name].tobytes()]


def snapshot(frame):
    return {name: frame[name].copy() for name in OUTPUTS}
