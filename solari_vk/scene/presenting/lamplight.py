"""What emissive surfaces and lamps light of what a camera sees. Rays decide, without light that surfaces pass on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.scene.emission import luminance_sums, mean_luminances
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.presenting.enclosures import Floats, Room, closed_place, largest_triangles, trace

if TYPE_CHECKING:
    from solari_vk.scene.camera import Camera
    from solari_vk.scene.lights.light import Light
    from solari_vk.scene.objects import Instance

SIDE = 6  # rays along each side of a picture
LAMP_POINTS = 8  # of all emissive surfaces together
LIFT = 1e-4  # of points above their surfaces, as a share of the distance from the camera


class Lamps(NamedTuple):
    """Points that light comes from."""

    points: Floats
    """(N, 3) in meters."""
    normals: Floats
    """Of emissive surfaces (N, 3), and the axes of spots; zero for lamps that shine to all sides."""
    edges: Floats
    """(N,) the cosine of half of a spot's cone, -1 for lamps that shine to all sides, and NaN of surfaces."""
    intensities: Floats
    """(N,) in cd, of surfaces along the normal."""


def solid_parts(instances: Iterable[Instance]) -> list[Instance]:
    """Instances that light doesn't pass."""
    return [item for item in instances if item.alpha_mode == "opaque" and not item.material.transmits]


def lamps_of(instances: Iterable[Instance], lights: Iterable[Light] = ()) -> Lamps | None:
    """The lamps of a scene; None without any, and where light comes from infinity."""
    corners, powers = [np.zeros((0, 3, 3))], [np.zeros(0)]
    for instance in instances:
        if instance.visible and instance.material.emits:
            corners.append(transform_points(instance.transform, instance.mesh.positions)[instance.mesh.triangles])
            powers.append(_powers(instance, corners[-1]))
    power = np.concatenate(powers)
    shining: list[Any] = [light for light in lights if light.emits]
    if any(not hasattr(light, "position") for light in shining):
        return None
    points = [np.asarray(light.position, np.float64)[None] for light in shining]
    count = LAMP_POINTS if power.sum() > 0 else 0
    if not count and not points:
        return None
    # Each point of a surface stands for an equal share of the power.
    chosen = np.searchsorted(np.cumsum(power), (np.arange(count) + 0.5) / LAMP_POINTS * power.sum())
    a, b, c = np.concatenate(corners)[chosen].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return Lamps(
        np.concatenate([(a + b + c) / 3, *points]),
        np.concatenate([normals, *(np.reshape(getattr(light, "direction", np.zeros(3)), (1, 3)) for light in shining)]),
        np.append(np.full(count, np.nan), [math.cos(getattr(light, "outer_cone_angle", math.pi)) for light in shining]),
        np.append(np.full(count, power.sum() / LAMP_POINTS), [light.intensity for light in shining]),
    )


def _powers(instance: Instance, corners: Floats) -> Floats:
    """The luminous intensity of each triangle (M,) along its normal, in cd."""
    a, b, c = corners.swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    texture = instance.material.emissive_texture
    if texture is not None:
        area *= mean_luminances(instance.mesh, instance.mesh.triangles, texture, luminance_sums(texture.image))
    return np.asarray(area * float(instance.material.emissive @ np.array(LUMINANCE_WEIGHTS)))


def light_seen(camera: Camera, instances: list[Instance], lamps: Lamps) -> Floats:
    """The radiance in cd/m^2 that white surfaces would have in the light of lamps, (N,), at N places of instances that
    a camera sees; of surfaces that shine themselves that of the brightest."""
    blockers = largest_triangles(solid_parts(instances))
    emissive = [item for item in instances if item.material.emits]
    shining = largest_triangles(emissive)
    brightest = max((float(item.material.emissive.max()) for item in emissive), default=0.0)
    grid = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)
    origins, directions = camera.rays(grid, (SIDE, SIDE))
    found = []
    # Parallel projections have an origin for each ray.
    for origin in np.unique(origins, axis=0):
        along = directions[(origins == origin).all(axis=1)]
        seen = trace(origin, along, largest_triangles(instances, seen_from=origin))
        shines = trace(origin, along, shining).distance <= seen.distance
        for index in np.flatnonzero(np.isfinite(seen.distance)):
            if shines[index]:
                found.append(brightest)
                continue
            normal = seen.normal[index] * -np.sign(seen.normal[index] @ along[index])
            point = origin + seen.distance[index] * (along[index] + LIFT * normal)
            found.append(_light_at(point, normal, lamps, blockers))
    return np.array(found)


def _light_at(point: Floats, normal: Floats, lamps: Lamps, blockers: Floats) -> float:
    toward = lamps.points - point
    squares = np.maximum((toward**2).sum(axis=1), 1e-300)
    units = toward / np.sqrt(squares)[:, None]
    aimed = -(units * lamps.normals).sum(axis=1)
    share = np.where(np.isnan(lamps.edges), aimed.clip(0), aimed >= lamps.edges)
    light = lamps.intensities * share * (units @ normal).clip(0) / (squares * math.pi)
    ahead = light > 0
    free = trace(point, toward[ahead], blockers).distance > 1 - LIFT
    return float(light[ahead][free].sum())


def lit_shell(camera: Camera, instances: list[Instance], lights: Iterable[Light], points: Floats) -> Room | None:
    """A place in a closed shell whose lamps are all inside, so that this camera outside would see a black one."""
    lamps = lamps_of(instances, lights)
    if lamps is None or light_seen(camera, instances, lamps).any():
        return None
    room = closed_place(solid_parts(instances), points)
    if room is None:
        return None
    # The lamps that are seen from the place are in the shell.
    return room if (trace(room.center, lamps.points - room.center, room.triangles).distance > 0.99).any() else None
