"""What makes sphere lights cast shadows: black balls below their surfaces, which rays hit as any instance."""

from __future__ import annotations

from functools import cached_property
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene import shapes
from solari_vk.scene.bounds import FAR
from solari_vk.scene.builtin import matte
from solari_vk.scene.lights.punctual import PunctualLight
from solari_vk.scene.model import Instance, Light, Material, Mesh

# The ball's radius over the sphere's. Rays then meet the light before the ball, also after rounding.
SHARE = 0.995
# What rounding takes from the ball, over its coordinates on the device, which are about FAR at most (Scene.origin).
ROUNDING = 2.0**-22
LEAST_SHARE = 0.5


class Blockers:
    """The balls of lights. They share a mesh and a material, which reflects up to 3 % of light."""

    def __init__(self) -> None:
        self._of: dict[Light, Instance] = {}
        self._present: set[Instance] = set()

    @cached_property
    def _parts(self) -> tuple[Mesh, Material]:
        return shapes.sphere(1.0, 64), matte(0)

    def __contains__(self, instance: Instance) -> bool:
        return instance in self._present

    def of(self, light: Light) -> Instance | None:
        """The ball of a light, if it has one."""
        return self._of.get(light)

    def place(self, light: Light, present: bool) -> Instance | None:
        """Add, move or remove the ball of a light; returns the ball that is or was there."""
        blocker = self._of.get(light)
        if not (present and blocks_light(light)):
            if blocker is not None:
                del self._of[light]
                self._present.remove(blocker)
            return blocker
        transform = blocker_transform(light)
        if blocker is None:
            blocker = Instance(*self._parts, transform, name=light.name)
            self._of[light] = blocker
            self._present.add(blocker)
        elif not np.array_equal(blocker.transform, transform):
            blocker.transform = transform
        return blocker


def blocks_light(light: Light | None) -> TypeGuard[PunctualLight]:
    """Whether a light casts shadows by a ball of its own."""
    return isinstance(light, PunctualLight) and light.blocks_light


def blocker_transform(light: PunctualLight) -> NDArray[np.float64]:
    """Where the ball of a light is (4, 4): world from object."""
    coordinate = min(float(np.abs(light.position).max()), FAR)
    radius = max(SHARE * light.radius - ROUNDING * coordinate, LEAST_SHARE * light.radius)
    transform = np.diag([radius, radius, radius, 1.0])
    transform[:3, 3] = light.position
    return transform
