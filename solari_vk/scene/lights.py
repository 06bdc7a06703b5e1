"""The list of light sources: every visible emissive instance, then every directional light."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.scene.constants import LIGHT_DIRECTIONAL, LIGHT_EMISSIVE_MESH
from solari_vk.scene.model import DirectionalLight, Instance
from solari_vk.scene.table import Table

SUN_DISTANCE = 10.0  # metres to what casts its shadows, about: how far they go when it turns
Place = tuple[float, float, float]
NOWHERE = (0.0, 0.0, 0.0)


class Lights:
    """The tables `light_sources`, `directional_lights` and `scene_info`.

    Removing a light moves the last one of its kind into its place, so that a change costs the same in
    a scene of ten lights and of a million.
    """

    def __init__(self, device: Device, source: np.dtype[Any], directional: np.dtype[Any], info: np.dtype[Any]) -> None:
        self.sources = Table(device, "light_sources", source)
        self.directional = Table(device, "directional_lights", directional)
        self.info = Table(device, "scene_info", info)
        self._emissive: list[Instance] = []
        self._index: dict[Instance, int] = {}
        self._directional: dict[DirectionalLight, None] = {}
        self._changed = True
        self._id_of: dict[Instance | DirectionalLight, int] = {}
        self._last_id = 0
        self.ids: NDArray[np.uint32] = np.zeros(0, np.uint32)
        """For each row of `sources` a number that stays with the light and is never used again; another array after
        each change of the list."""
        self._power_of: dict[Instance | DirectionalLight, float] = {}
        self._powers_changed = True
        self.powers: NDArray[np.float64] = np.zeros(0)
        """About how much light each gives, in lumens; another array after each change."""
        self._emissive_places = np.zeros((16, 3))
        self._places_changed = True
        self.places: NDArray[np.float64] = np.zeros((0, 3))
        """Where each is, (N, 3) in metres, to tell how far it moved; another array after each change."""

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """All tables."""
        return self.sources, self.directional, self.info

    def index(self, instance: Instance) -> int | None:
        """An instance's place in the list, None when it is no light."""
        return self._index.get(instance)

    def set_emissive(
        self, instance: Instance, row: int, emits: bool, area: float = 0.0, place: Place = NOWHERE
    ) -> Instance | None:
        """List an instance of that row or take it off; returns the instance whose index changed thereby.

        area: of its surface in the world, in square metres. place: its middle.
        """
        index = self._index.get(instance)
        if emits:
            self._set_power(instance, math.pi * area * _luminance(instance.material.emissive))
            if index is None:
                index = self._index[instance] = len(self._emissive)
                self._emissive.append(instance)
                self.renew(instance)
            self.sources.reserve(index + 1)
            self.sources.records[index] = (LIGHT_EMISSIVE_MESH, row)
            self.sources.mark([index])
            self._set_place(index, place)
            return None
        if index is None:
            return None
        self._changed = self._places_changed = True
        self._powers_changed = True
        del self._index[instance], self._id_of[instance], self._power_of[instance]
        last = self._emissive.pop()
        if last is instance:
            return None
        self._emissive[index] = last
        self._emissive_places[index] = self._emissive_places[len(self._emissive)]
        self._index[last] = index
        self.sources.records[index] = self.sources.records[len(self._emissive)]
        self.sources.mark([index])
        return last

    def renew(self, light: Instance | DirectionalLight) -> None:
        """Give a light another id: what was sampled on it, such as a triangle, no longer means the same."""
        self._last_id += 1
        self._id_of[light] = self._last_id
        self._changed = True

    def set_directional(self, light: DirectionalLight, present: bool) -> None:
        """List a directional light, take up its changes, or take it off."""
        if not present:
            for known in (self._directional, self._id_of, self._power_of):
                known.pop(light, None)
        elif light not in self._directional:
            self._directional[light] = None
            self.renew(light)
        self._changed = True

    def _set_place(self, index: int, place: Place) -> None:
        if index >= len(self._emissive_places):
            self._emissive_places = np.concatenate([self._emissive_places, np.zeros((index + 1, 3))])
        if tuple(self._emissive_places[index].tolist()) != place:
            self._emissive_places[index] = place
            self._places_changed = True

    def _set_power(self, light: Instance | DirectionalLight, power: float) -> None:
        known = self._power_of.get(light, 0.0)
        if not math.isclose(power, known, rel_tol=1e-5):  # turning a light rounds its area
            self._powers_changed = True
        self._power_of[light] = power

    def update(self, lit_area: Callable[[], float]) -> None:
        """Write what follows from the changes. lit_area(): of the scene as a sun sees it, about, in square metres."""
        if self._changed or self._places_changed:
            suns = [-SUN_DISTANCE * light.direction for light in self._directional]
            emissive = self._emissive_places[: len(self._emissive)]
            self.places = np.concatenate([emissive, np.reshape(suns, (-1, 3))])
            self._places_changed = False
        if not (self._changed or self._powers_changed):
            return
        listed: list[Instance | DirectionalLight] = [*self._emissive, *self._directional]
        if self._changed and self._directional:
            area = lit_area()
            for light in self._directional:
                self._set_power(light, area * light.illuminance * _luminance(light.color))
        self.powers = np.fromiter((self._power_of[light] for light in listed), np.float64, len(listed))
        self._powers_changed = False
        if not self._changed:
            return
        self._changed = False
        self.ids = np.fromiter((self._id_of[light] for light in listed), np.uint32, len(listed))
        first, count = len(self._emissive), len(self._directional)
        self.sources.reserve(first + count)
        self.directional.reserve(count)
        for i, light in enumerate(self._directional):
            self.sources.records[first + i] = (LIGHT_DIRECTIONAL, i)
            half_angle = light.angular_diameter / 2
            one_minus_cos = 2 * math.sin(half_angle / 2) ** 2
            solid_angle = 2 * math.pi * one_minus_cos
            record = self.directional.records[i]
            record["direction_to_light"] = -light.direction
            record["one_minus_cos_half_angle"] = one_minus_cos
            # The disk's cosine-weighted integral, pi sin^2, rather than its solid angle: a surface that
            # faces the light's centre then gets the stated illuminance however wide the disk is.
            record["radiance"] = light.color * (light.illuminance / (math.pi * math.sin(half_angle) ** 2))
            record["solid_angle"] = solid_angle
        self.sources.mark(range(first, first + count))
        self.directional.mark(range(count))
        info = self.info.records[0]
        info["light_count"] = first + count
        info["directional_light_count"] = count
        info["first_directional_light"] = first
        self.info.mark([0])

    def destroy(self) -> None:
        """Free the tables."""
        for table in self.tables:
            table.destroy()


def _luminance(color: NDArray[np.float32]) -> float:
    red, green, blue = color.tolist()
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue  # type: ignore[no-any-return]
