"""The instances of a scene that emit light: what they emit, for the list of lights."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from solari_vk.bound.geometry import Geometry, Shape
from solari_vk.bound.lights.emissive_meshes import Emission, Emissions
from solari_vk.bound.lights.light_list import LightList, Position
from solari_vk.gpu.device.device import Device
from solari_vk.scene.matrices import placed_box
from solari_vk.scene.model import Instance, Material


class Lamps:
    """The emissions of instances. layout: the records of the shaders' blocks, by name. lights: that these are in. uses:
    the meshes and materials of the scene's instances, as raster and rays see them."""

    def __init__(
        self,
        device: Device,
        layout: dict[str, Any],
        lights: LightList,
        geometry: Geometry,
        uses: Mapping[Instance, tuple[Shape, Shape, Material]],
    ) -> None:
        self.emissions = Emissions(device, layout["light_leaves"]["by_power"])
        self._lights, self._geometry, self._uses = lights, geometry, uses

    def set(self, instance: Instance, row: int, emits: bool) -> list[Instance]:
        """Add, update or remove the light of the instance of a row; returns other instances whose index among the
        lights changed."""
        if emits:
            moved = self._lights.set_emissive(instance, row, *self.of(instance, instance))
        else:
            self.emissions.release(instance)
            moved = self._lights.set_emissive(instance, row, None)
        return [] if moved is None else [moved]

    def of(self, instance: Instance, original: Instance) -> tuple[Emission, float, Position, Position]:
        """What `LightList.set_emissive` is told of an instance that emits light: its emission, which is kept until it
        is released, area, position and half size. original: the scene's instance with its meshes."""
        _, shape, _ = self._uses[original]
        position, half_size, volume = placed_box(instance.transform, *self._geometry.box(shape))
        emission = self.emissions.acquire(instance, self._geometry.orders[shape])
        return emission, volume ** (2 / 3) * emission.area_in(instance.joint_matrices), position, half_size
