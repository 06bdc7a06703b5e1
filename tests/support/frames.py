"""Whole realtime frames in tests: which outputs two frames share, and how much of an earlier picture is left."""

from __future__ import annotations

from solari_vk.conformance.realtime import PARTS

SIZE = (32, 32)
OUTPUTS = ("radiance", *PARTS, "emission", "diffuse_radiance", "specular_radiance", "display", "depth",
           "motion_vectors", "gbuffer", "guides_normal_roughness")  # fmt: skip


def find(scene, name):
    return next(instance for instance in scene if instance.name == name)


def settle(renderer, camera, frames=30):
    """The last of so many frames."""
    for _ in range(frames):
        frame = renderer.render(camera)
    return frame


def snapshot(frame):
    return {name: frame[name].copy() for name in OUTPUTS}


def differing(first, other):
    """Names of the outputs in which two frames differ."""
    return [name for name in OUTPUTS if first[name].tobytes() != other[name].tobytes()]


def left_of(before, now, picture):
    """The part of the difference between an earlier picture and the present truth that a picture still shows: 1 when it
    is the earlier picture, 0 when nothing of that is left."""
    difference = before - now
    return float(((picture - now) * difference).sum() / (difference**2).sum())
