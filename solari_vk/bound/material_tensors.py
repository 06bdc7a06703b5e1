"""Numbers of materials that stay on the device as tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solari_vk.bound.constants import MATERIAL_FIELDS
from solari_vk.bound.table import RowAllocator, Table, upload_tables
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import LAST_INDEX, Dispatch, TensorPort
from solari_vk.scene.material import LAYERS, LIMITS, Material

COUNTS = {name: {"float": 1, "vec2": 2, "vec3": 3}[MATERIAL_FIELDS[name]] for name in Material._tensor_fields}
# As `Number` of glsl/scene/tensors/materials.comp.
NUMBER = np.dtype(
    [
        ("floats", "u8"),
        ("doubles", "u8"),
        ("is_double", "u4"),
        ("step", "u4"),
        ("count", "u4"),
        ("target", "u4"),
        ("low", "f4"),
        ("high", "f4"),
        ("scale", "f4"),
        ("what", "u4"),
        ("wrong", "u8"),
    ]
)


class MaterialTensors:
    """Writes numbers in tensors to the records of materials. table, rows: the records, and whose they are."""

    def __init__(self, device: Device, port: TensorPort, table: Table, rows: RowAllocator[Material]) -> None:
        self._device = device
        self._port = port
        self._table = table
        self._rows = rows
        self._list = Table(device, "numbers in tensors", NUMBER)

    def accept(self, material: Material, fields: Mapping[str, Any], has_layers: bool) -> dict[str, DeviceTensor] | None:
        """Tensors of numbers that only shaders need; None for what the host must read. has_layers: the scene's shaders
        have coats, sheen and the other layers."""
        if not has_layers and not fields.keys().isdisjoint(LAYERS):
            return None
        # Rays pass smooth thin glass straight, which the host must know.
        if "perceptual_roughness" in fields and material.transmission > 0 and not material.solid:
            return None
        return self._port.accept_fields(fields, lambda name: ((), (1,), (COUNTS[name],)))

    def tensors_of(self, material: Material) -> dict[str, DeviceTensor]:
        """The fields that are tensors of this device."""
        return {name: tensor for name, tensor in material._tensors.items() if self._port.owns(tensor)}

    def write(self, materials: Mapping[Material, Mapping[str, DeviceTensor]]) -> None:
        """Write the numbers in tensors to the records just before the next submission. A number out of its limits is
        not written: the record keeps the earlier one, and a later call raises SolariError."""
        numbers = []
        for material, tensors in materials.items():
            numbers += [self._number(material, name, tensor) for name, tensor in tensors.items()]
        if not numbers:
            return
        self._list.reserve(len(numbers))
        self._list.replace()
        self._list.records[: len(numbers)] = np.array(numbers, NUMBER)
        self._list.marked = set(range(len(numbers)))
        upload_tables(self._device, [self._list])
        pushed = {"numbers": self._list.buffer.address, "target": self._table.buffer.address, "count": len(numbers)}
        self._port.write([Dispatch("materials", (len(numbers), 1), pushed)], "numbers of materials", with_next=True)

    def _number(self, material: Material, name: str, tensor: DeviceTensor) -> tuple[Any, ...]:
        """A row of NUMBER."""
        fields = self._table.records.dtype.fields
        assert fields is not None
        row = self._rows[material]
        source = self._port.source(tensor)
        refusal = self._port.refusal(("material", name), lambda index: self._message(name, index))
        return (
            source["floats"],
            source["doubles"],
            source["is_double"],
            int(tensor.shape not in ((), (1,))),
            COUNTS[name],
            (row * self._table.records.dtype.itemsize + fields[name][1]) // 4,
            *LIMITS[name],
            material._reflectance_scale if name == "reflectance" else 1.0,
            refusal["what"] << 20 | min(row, LAST_INDEX),
            refusal["wrong"],
        )

    def _message(self, name: str, row: int) -> str:
        found = next((material for material, of_material in self._rows.items() if of_material == row), None)
        low, high = LIMITS[name]
        described = "a material" if found is None else found.describe()
        return f"{described}: {name} must be finite, and lie between {low:g} and {high:g}"

    def destroy(self) -> None:
        self._list.destroy()
