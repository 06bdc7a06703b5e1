"""What scenes on a device may share: meshes, textures and materials, and the features of shaders."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.features import Features
from solari_vk.bound.geometry import Geometry
from solari_vk.bound.material_table import MaterialTable
from solari_vk.bound.table import Table, upload_tables
from solari_vk.bound.texture_table import TextureTable
from solari_vk.bound.texture_tensors import DTYPES
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders import spirv
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.scene.model import Material, Mesh, TextureImage
from solari_vk.scene.observable import Observable, Watcher
from solari_vk.scene.tensor_fields import TensorFields


class Assets:
    """The meshes, textures and materials of scenes. watcher: is notified of their edits.
    block_dtypes: the records of the shaders' blocks, by name."""

    def __init__(self, device: Device, watcher: Watcher) -> None:
        layout = "scene/layout.comp"
        bindings = spirv.reflect(compile_shader(layout, lacking=device.lacking), layout).bindings
        self.block_dtypes: dict[str, Any] = {
            n: b.dtype if b.element is None else b.element for n, b in bindings.items()
        }
        self._device = device
        self.features = Features()
        self.tensors = TensorPort(device)
        self.geometry = Geometry(device, self.block_dtypes, self.features, watcher, self.tensors)
        self.textures = TextureTable(device, self.block_dtypes["textures"], self.features, watcher, self.tensors)
        self.materials = MaterialTable(
            device, self.block_dtypes["materials"], self.textures, self.features, watcher, self.tensors
        )
        posed = self.geometry.posed
        self.tables: tuple[Table, ...] = (self.geometry.table, *posed.tables, self.textures.table, self.materials.table)

    def accept_tensor(self, values: Any) -> DeviceTensor | None:
        """A tensor with the values of many objects, whose rows `accept_tensors` accepts without a copy."""
        return self.tensors.accept(values, dtypes=DTYPES)

    def accept_tensors(self, item: TensorFields, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """Tensors that are assigned to fields of an object in use, in the device's memory; None for what the host must
        read."""
        if isinstance(item, Mesh):
            return self.geometry.accept_tensors(item, fields)
        if isinstance(item, TextureImage):
            # Whether instances are opaque depends on alpha.
            return None if self.materials.alpha_users_of(item) else self.textures.accept_tensors(item, fields)
        return self.materials.accept_tensors(item, fields) if isinstance(item, Material) else None

    @property
    def triangle_orders(self) -> dict[int, NDArray[np.int64]]:
        """For each row of `meshes` in use: the mesh's triangle of each uploaded triangle."""
        return {self.geometry.rows[mesh]: order for mesh, order in self.geometry.orders.items()}

    def users(self, asset: Observable) -> list[Any]:
        """The instances that use a mesh, a material, a texture or an image."""
        return self.geometry.rows.users(asset) if isinstance(asset, Mesh) else self.materials.users_of(asset)

    def set_previous_positions(self, renderer: Any) -> None:
        """Have the previous positions be those that a renderer has shown last, where no scene changed."""
        if self.geometry.posed.set_previous_positions(renderer):
            upload_tables(self._device, [self.geometry.table])
            self.geometry.tensors.write_bounds()

    def upload(self, tables: Iterable[Table]) -> int:
        """Upload what has changed in tables; returns how many have other buffers now."""
        changed = [table for table in tables if table.marked]
        replaced = sum(table.replace() for table in changed)
        # Rows that are uploaded lack what tensors gave, and get it after the upload.
        materials = set(self.materials.table.marked)
        upload_tables(self._device, changed)
        self.materials.write_tensors(materials)
        if self.geometry.table in changed:
            self.geometry.tensors.write_bounds()
        return replaced

    def destroy(self) -> None:
        for owner in (self.geometry, self.materials, self.textures, self.tensors):
            owner.destroy()
