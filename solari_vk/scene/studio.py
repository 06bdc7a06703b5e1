"""A stage for scenes that bring no light or camera of their own, as most glTF files of single objects."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte
from solari_vk.scene.model import Camera, Instance, Scene


def frame_camera(
    scene: Scene,
    direction: ArrayLike = (-0.45, -0.3, -1.0),
    *,
    aspect: float = 1.0,
    vertical_fov: float = math.radians(35),
    margin: float = 1.1,
    ev100: float = 0.0,
) -> Camera:
    """A camera that looks along `direction` and sees the whole of the scene's bounds; it is not added.

    aspect is width / height of the picture; margin 1 would let the bounds touch its edges. Take the
    camera before adding what should not count, such as studio_lights. The direction must not be vertical.
    """
    low, high = scene.bounds()
    center = (low + high) / 2
    forward = np.asarray(direction, np.float64)
    camera = Camera.look_at(center - forward, center, vertical_fov=vertical_fov, ev100=ev100)
    corners = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    seen = (corners - center) @ camera.transform[:3, :3]
    slope = np.array((math.tan(vertical_fov / 2) * aspect, math.tan(vertical_fov / 2)))
    # For each corner the distance at which it lies on the picture's edge; z counts towards the camera.
    distance = float((np.abs(seen[:, :2]) * margin / slope + seen[:, 2:]).max())
    extent = float(np.linalg.norm(high - low)) or 1.0
    transform = camera.transform.copy()
    transform[:3, 3] = center + transform[:3, 2] * max(distance, 1e-3 * extent)
    camera.update(transform=transform, near=max(1e-4 * extent, 1e-9))
    return camera


def studio_lights(scene: Scene, *, ev100: float = 0.0, ground: bool = True, camera: Camera | None = None) -> Scene:
    """Add three area lights and a ground plane around the scene's bounds, and return the scene.

    Key (from the camera's left, above), fill (right, a quarter as bright) and rim (behind) are squares as
    wide as half the scene, two of its radii away; the lights are as bright as pictures of that ev100 need.
    Without a camera the front is +z. The ground is matte grey, 20 radii wide, just under the scene.
    """
    low, high = scene.bounds()
    center = (low + high) / 2
    radius = float(np.linalg.norm(high - low)) / 2
    if not radius > 0:
        raise SolariError(f"{scene.describe()} is a single point: there is nothing to light")
    turn = _heading(camera, center)
    half_side, distance = 0.5 * radius, 2.5 * radius
    # White paint facing the key light shows as about 0.9: exposure * E / pi, with E = L * area / distance^2.
    key = 0.9 * math.pi * 1.2 * 2.0**ev100 * (distance / (2 * half_side)) ** 2
    for name, heading, height, strength in (("key", -40, 40, 1.0), ("fill", 55, 15, 0.25), ("rim", 160, 50, 0.6)):
        angle, up = turn + math.radians(heading), math.radians(height)
        toward = np.array((math.sin(angle) * math.cos(up), math.sin(up), math.cos(angle) * math.cos(up)))
        mesh = shapes.facing_quad(center + distance * toward, half_side, center)
        scene.add(Instance(mesh=mesh, material=lamp(key * strength, f"{name} light"), name=f"{name} light"))
    if ground:
        at = np.array((center[0], low[1] - 1e-3 * radius, center[2]))
        mesh = shapes.quad(at, (0, 0, 10 * radius), (10 * radius, 0, 0), name="ground")
        scene.add(Instance(mesh=mesh, material=matte(0.35, "ground"), name="ground"))
    return scene


def _heading(camera: Camera | None, center: NDArray[np.float64]) -> float:
    """The angle about y at which the camera stands, seen from the centre."""
    if camera is None:
        return 0.0
    x, _, z = camera.transform[:3, 3] - center
    return math.atan2(x, z)
