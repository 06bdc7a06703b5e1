"""Materials on the device: the `materials` table, and which textures and instances use which material."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

import numpy as np

from solari_vk.base.errors import warn
from solari_vk.bound.constants import (
    MATERIAL_BLEND,
    MATERIAL_DOUBLE_SIDED,
    MATERIAL_HIDES_BACK,
    MATERIAL_MASK,
    MATERIAL_NUMBERS,
    MATERIAL_SOLID,
    MATERIAL_UNLIT,
    MATERIAL_WALL,
    NO_INDEX,
)
from solari_vk.bound.features import Features
from solari_vk.bound.material_tensors import MaterialTensors
from solari_vk.bound.table import RowAllocator, Table
from solari_vk.bound.texture_table import TextureTable
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.scene.material import LAYERS, TEXTURES, UNLIT_RADIANCE
from solari_vk.scene.model import Instance, Material, Texture, TextureImage
from solari_vk.scene.observable import Observable

_ALPHA_FLAGS = {"opaque": 0, "mask": MATERIAL_MASK, "blend": MATERIAL_BLEND}


class MaterialTable:
    """The `materials` table. watcher: is notified of edits of the materials in use."""

    def __init__(
        self,
        device: Device,
        record: np.dtype[Any],
        textures: TextureTable,
        features: Features,
        watcher: Any,
        port: TensorPort,
    ) -> None:
        self.table = Table(device, "materials", record)
        self.rows: RowAllocator[Material] = RowAllocator()
        self.emitting: set[Material] = set()
        """The materials that emit light, as of the last `update`."""
        self._textures = textures
        self._features = features
        self._watcher = watcher
        self._textures_of: dict[Material, dict[str, Texture]] = {}
        self._to_write: dict[Material, None] = {}
        self._written: dict[Material, int] = {}  # how many edits of the host its record has
        self._tensors_of: dict[Material, dict[str, DeviceTensor]] = {}  # the fields that the host's record lacks
        self._other_tensors: set[int] = set()  # rows of materials that have others of these
        self._tensors = MaterialTensors(device, port, self.table, self.rows)

    @property
    def by_row(self) -> dict[int, Material]:
        """The materials in use, by the shaders' indices."""
        return {row: material for material, row in self.rows.items()}

    def acquire(self, material: Material, user: Instance) -> None:
        """Add a use of a material."""
        if self.rows.acquire(material, user):
            material.watch(self._watcher)
            self._follow_textures(material)

    def release(self, material: Material, user: Instance) -> None:
        """Undo one `acquire`."""
        if self.rows.release(material, user):
            material.unwatch(self._watcher)
            for of_materials in (self._to_write, self._written, self._tensors_of):
                of_materials.pop(material, None)
            self.emitting.discard(material)
            for slot, texture in self._textures_of.pop(material).items():
                is_srgb = TEXTURES[slot]
                self._textures.release(texture, is_srgb, material)

    def accept_tensors(self, material: Material, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """Tensors of numbers of a material; None for what the host must read: of new materials, and what shaders may
        not have."""
        if material not in self._written:
            return None
        return self._tensors.accept(material, fields, "SCENE_LAYERS" in self._features.constants)

    def mark_changed(self, material: Material) -> list[Instance]:
        """Have `update` write a material again that was edited; returns the instances whose records may depend on
        it."""
        if self._differs_by_tensors(material):
            self._to_write[material] = None
            return []
        if material in self.rows:
            self._follow_textures(material)
        return self.rows.users(material)

    def was_blended(self, material: Material) -> bool:
        """Whether a material was blended, or a wall of glass, when its record was written."""
        blended = MATERIAL_BLEND | MATERIAL_WALL
        return material in self._written and bool(self.table.records["flags"][self.rows[material]] & blended)

    def users_of(self, asset: Observable) -> list[Instance]:
        """The instances that use a material, a texture or an image."""
        if isinstance(asset, Material):
            return self.rows.users(asset)
        found: list[Instance] = []
        for material, textures in self._textures_of.items():
            if any(asset in (texture, texture.image) for texture in textures.values()):
                found += self.rows.users(material)
        return found

    def alpha_users_of(self, changed: Texture | TextureImage) -> list[Instance]:
        """The instances whose alpha depends on a texture or an image."""
        found: list[Instance] = []
        for material in self.rows:
            texture = material.base_color_texture
            if texture is None or material.alpha_mode == "opaque":
                continue
            if changed in (texture, texture.image):
                found += self.rows.users(material)
        return found

    def _follow_textures(self, material: Material) -> None:
        """Use the textures that a material has now, and have its record written."""
        before = self._textures_of.get(material, {})
        slots = {slot: getattr(material, slot) for slot in TEXTURES}
        after = {slot: texture for slot, texture in slots.items() if texture is not None}
        # Acquired before the others are released, so that a texture that stays isn't uploaded again.
        for slot, texture in after.items():
            is_srgb = TEXTURES[slot]
            self._textures.acquire(texture, is_srgb, material)
        for slot, texture in before.items():
            is_srgb = TEXTURES[slot]
            self._textures.release(texture, is_srgb, material)
        self._textures_of[material] = after
        self._to_write[material] = None

    def update(self) -> None:
        """Write the records of new and changed materials; their textures must have rows."""
        self.table.reserve(self.rows.high_water_mark)
        for material in self._to_write:
            # The host reads the tensors of a material that is new here.
            tensors = self._tensors.tensors_of(material) if material in self._written else {}
            if not tensors.keys().isdisjoint(LAYERS):
                self._features.add_of(material)  # another renderer's shaders may have had layers before
            if self._differs_by_tensors(material):
                self._other_tensors.add(self.rows[material])
            else:
                self._write(material, tensors)
            self._written[material] = material._host_edits
            self._tensors_of[material] = tensors
        self._to_write.clear()

    def _differs_by_tensors(self, material: Material) -> bool:
        """Whether nothing but tensors of this device changed since the record was written."""
        unchanged = self._written.get(material) == material._host_edits
        return unchanged and len(self._tensors.tensors_of(material)) == len(material._tensors)

    def _write(self, material: Material, tensors: Mapping[str, DeviceTensor]) -> None:
        """Write a record but for the fields that are tensors."""
        self._features.add_of(material)
        _warn_of_solid_fields(material)
        row = self.rows[material]
        record = self.table.records[row]
        for name in MATERIAL_NUMBERS:
            if name not in tensors:
                record[name] = material.relative_reflectance if name == "reflectance" else getattr(material, name)
        textures = self._textures_of[material]
        for slot, srgb in TEXTURES.items():
            record[slot] = self._textures.rows[textures[slot], srgb] if slot in textures else NO_INDEX
        if material.unlit:
            record["emissive"] = UNLIT_RADIANCE
            record["emissive_texture"] = NO_INDEX
        record["flags"] = _flags_of(material)
        if material.emits:
            self.emitting.add(material)
        else:
            self.emitting.discard(material)
        self.table.mark([row])

    def write_tensors(self, uploaded: Set[int]) -> None:
        """Have numbers in tensors in the records that have other ones, or were uploaded without them."""
        rows = self._other_tensors | uploaded
        if rows:
            self._tensors.write(
                {
                    material: tensors
                    for material, tensors in self._tensors_of.items()
                    if tensors and self.rows[material] in rows
                }
            )
        self._other_tensors.clear()

    def destroy(self) -> None:
        self._tensors.destroy()
        self.table.destroy()
        for material in self.rows:
            material.unwatch(self._watcher)


def _warn_of_solid_fields(material: Material) -> None:
    """Warn of what only solids have, where the surface bounds none that light enters."""
    used = {
        "attenuation_color": material.bounds_solid or bool((material.attenuation_color == 1).all()),
        "dispersion": material.disperses or material.dispersion == 0,
    }
    unused = [name for name, is_used in used.items() if not is_used]
    if unused:
        warn(
            f"{material.describe()}: {', '.join(unused)}: without effect, since light enters no volume here: set "
            "solid=True and a transmission above 0 (in glTF thicknessFactor, transmissionFactor)"
        )


def _flags_of(material: Material) -> int:
    flags = _ALPHA_FLAGS[material.alpha_mode]
    if material.hides_back:
        flags |= MATERIAL_HIDES_BACK
    elif material.double_sided or material.unlit:  # the back of a lamp is dark unless it is double-sided
        flags |= MATERIAL_DOUBLE_SIDED
    if material.bounds_solid:
        flags |= MATERIAL_SOLID
    if material.is_wall:
        flags |= MATERIAL_WALL
    if material.unlit:
        flags |= MATERIAL_UNLIT
    return flags
