"""Bodies of sphere lights that cast shadows: black balls below their surfaces, which rays hit as any instance."""

from __future__ import annotations

from functools import cached_property
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.lights.punctual import PunctualLight
from solari_vk.scene.model import Instance, Light, Material, Mesh

SHARE = 0.995
"""The ball's radius over the sphere's, so that rays meet the light before it, rounding errors aside."""


class Bodies:
    """The bodies of lights. They share a mesh and a material, which reflects up to 3 % of light."""

    def __init__(self) -> None:
        self._of: dict[Light, Instance] = {}
        self._present: set[Instance] = set()

    @cached_property
    def _parts(self) -> tuple[Mesh, Material]:
        return shapes.sphere(1.0, 64), matte(0)

    def __contains__(self, instance: Instance) -> bool:
        return instance in self._present

    def follow(self, light: Light, present: bool) -> Instance | None:
        """Add, move or remove the body of a light; returns it, None for a light that hasn't one."""
        body = self._of.get(light)
        if not (present and has_body(light)):
            if body is not None:
                del self._of[light]
                self._present.remove(body)
            return body
        transform = transform_of(light)
        if body is None:
            body = self._of[light] = Instance(*self._parts, transform, name=light.name)
            self._present.add(body)
        elif not np.array_equal(body.transform, transform):
            body.transform = transform
        return body

    def of(self, light: Light) -> Instance | None:
        """The body of a light, if it has one."""
        return self._of.get(light)


def has_body(light: Light | None) -> TypeGuard[PunctualLight]:
    """Whether it is a light with a body."""
    return isinstance(light, PunctualLight) and light.blocks_light


def transform_of(light: PunctualLight) -> NDArray[np.float64]:
    """Where the body of a light is (4, 4): world from object."""
    transform = np.diag([*(SHARE * light.radius,) * 3, 1.0])
    transform[:3, 3] = light.position
    return transform
