"""Lights and a ground for scenes that have no light of their own, such as most glTF files of single objects."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte
from solari_vk.scene.model import Camera, Scene


def studio_lights(scene: Scene, *, ev100: float = 0.0, ground: bool = True, camera: Camera | None = None) -> Scene:
    """Add three area lights and a ground plane around the scene's bounds, and return the scene.

    Key (from the camera's left, above), fill (right, a quarter as bright) and rim (behind) are squares as
    wide as the scene's radius, 2.5 radii from its center, and as bright as a picture with this ev100 needs.
    Without a camera the front is +z. The ground is matte gray, 20 radii wide, just under the scene.
    """
    bounds = scene.bounds
    center, radius = bounds.center, bounds.radius
    if not radius > 0:
        raise SolariError(f"{scene.describe()} is a single point: a studio needs geometry with a size")
    turn = _heading(camera, center)
    half_side, distance = 0.5 * radius, 2.5 * radius
    # White paint that faces the key light is shown as about 0.9 = exposure * E / pi, with E = L * area / distance^2.
    key = 0.9 * math.pi * 1.2 * 2.0**ev100 * (distance / (2 * half_side)) ** 2
    for name, heading, height, strength in (("key", -40, 40, 1.0), ("fill", 55, 15, 0.25), ("rim", 160, 50, 0.6)):
        angle, up = turn + math.radians(heading), math.radians(height)
        toward = np.array((math.sin(angle) * math.cos(up), math.sin(up), math.cos(angle) * math.cos(up)))
        mesh = shapes.facing_quad(center + distance * toward, half_side, center)
        scene.add(mesh, lamp(key * strength, f"{name} light"), name=f"{name} light")
    if ground:
        at = np.array((center[0], bounds.min[1] - 1e-3 * radius, center[2]))
        mesh = shapes.quad(at, (0, 0, 10 * radius), (10 * radius, 0, 0), name="ground")
        scene.add(mesh, matte(0.35, "ground"), name="ground")
    return scene


def _heading(camera: Camera | None, center: NDArray[np.float64]) -> float:
    """The camera's angle about the y axis as seen from a center, in radians; 0 without a camera."""
    if camera is None:
        return 0.0
    x, _, z = camera.transform[:3, 3] - center
    return math.atan2(x, z)
