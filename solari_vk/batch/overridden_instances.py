"""What the instances of a scene have of their own in each world of a batch, as the tables and rays need it."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.overrides import WorldOverrides
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.blockers import blocker_transform, blocks_light
from solari_vk.bound.traced_instances import flags_of, mask_of
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene.model import Instance, Material


class InstanceOverride(NamedTuple):
    """What an instance has of its own in each world (worlds, ...), None for what the scene has: its transforms, the
    rows of its materials, and the flags and masks of what rays hit."""

    transforms: NDArray[np.float64] | DeviceTensor | None = None
    materials: NDArray[np.uint32] | None = None
    flags: NDArray[np.uint32] | None = None
    masks: NDArray[np.uint32] | None = None


class OverriddenInstances:
    """The instances of a scene that differ from world to world."""

    def __init__(self, binder: SceneBinder) -> None:
        self._binder = binder
        self._surfaces: dict[Instance, InstanceOverride] = {}  # of those with materials of their own
        # Those that are blended in some world by a material of their own, and all that their looks depend on.
        self._blended: dict[Instance, tuple[Any, ...]] = {}

    def is_blended(self, instance: Instance) -> bool:
        """Whether an instance is blended in some world."""
        return instance in self._blended or (instance not in self._surfaces and instance.alpha_mode == "blend")

    def follow_materials(self, overrides: WorldOverrides) -> None:
        """Find the surfaces of instances that have materials of their own, which must be in the binder's tables."""
        self._surfaces = {}
        blended: dict[Instance, tuple[Any, ...]] = {}
        built_anew = False
        for instance, materials in overrides.materials.current().items():
            found = {material: self._surface(instance, material) for material in dict.fromkeys(materials)}
            if any(mode == "blend" for mode, *_ in found.values()):
                blended[instance] = instance.transform.tobytes(), instance.visible, instance.mesh, *materials
                built_anew |= self._binder.use_no_duplicate_any_hit(instance.ray_mesh or instance.mesh)
            columns = np.array([found[material][1:] for material in materials], np.uint32).T
            self._surfaces[instance] = InstanceOverride(None, *columns)
        # Temporal antialiasing drops history of blended surfaces that are gone in frames in which one has changed.
        if blended != self._blended:
            self._binder.records.blended_changes += 1
        self._blended = blended
        if built_anew:
            self._binder.update()

    def _surface(self, instance: Instance, material: Material) -> tuple[str, int, int, int]:
        """The alpha mode of an instance with a material, the material's row, and the flags and mask for rays."""
        # The alpha mode depends on the mesh too, whose colors may have alpha: a copy of the instance says it.
        variant = copy.copy(instance)
        variant.update(material=material)
        mode = variant.alpha_mode
        if mode != "opaque":
            self._binder.add_feature(variant)
        row = self._binder.materials.rows[material]
        return mode, row, flags_of(material.hides_back, mode), mask_of(instance.visible, mode)

    def blockers(self, overrides: WorldOverrides) -> dict[Instance, InstanceOverride]:
        """The balls that block the light of sphere lights: elsewhere in each world, or hidden from rays."""
        found = {}
        for light, lights in overrides.lights.current().items():
            blocker = self._binder.lights.blockers.of(light)
            if blocker is None:
                wrong = [world for world, one in enumerate(lights) if blocks_light(one)]
                if wrong:
                    raise SolariError(
                        f"Batch.world_lights: {light.describe()} blocks light in world {wrong[0]}, for "
                        "which it needs a body in the scene: set blocks_light there too"
                    )
                continue
            transforms = [blocker_transform(one) if blocks_light(one) else blocker.transform for one in lights]
            masks = [mask_of(blocks_light(one), "opaque") for one in lights]
            found[blocker] = InstanceOverride(np.stack(transforms), None, None, np.array(masks, np.uint32))
        return found

    def all(
        self, overrides: WorldOverrides, blockers: Mapping[Instance, InstanceOverride]
    ) -> dict[Instance, InstanceOverride]:
        """All instances that differ, with these blockers."""
        differing = {**self._surfaces, **blockers}
        for instance, transforms in overrides.transforms.current().items():
            differing[instance] = differing.get(instance, InstanceOverride())._replace(transforms=transforms)
        return differing
