"""Comparisons of realtime frames: which outputs differ, and how much of an earlier picture a frame contains."""

from __future__ import annotations

from solari_vk.conformance.realtime import PARTS

SIZE = (32, 32)
OUTPUTS = ("radiance", *PARTS, "emission", "diffuse_radiance", "specular_radiance", "display", "depth",
           "motion_vectors", "gbuffer", "guides_normal_roughness")  # fmt: skip


def find(scene, name):
    return next(instance for instance in scene if instance.name == name)


def settle(renderer, camera, frames=30):
    """Render this many frames, and return the last one."""
    for _ in range(frames):
        frame = renderer.render(camera)
    return frame


def snapshot(frame):
    return {name: frame[name].copy() for name in OUTPUTS}


def differing(first, other):
    """Names of the outputs in which two frames differ."""
    return [name for name in OUTPUTS if first[name].tobytes() != other[name].tobytes()]


def left_of(before, now, picture):
    """How much of an earlier picture `before` a picture contains: 0 when it equals the reference `now`, 1 when it
    equals `before`, and in between by projection onto their difference."""
    difference = before - now
    return float(((picture - now) * difference).sum() / (difference**2).sum())
