"""Numbers of materials that tensors give on the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solari_vk.bound.given_numbers import GivenNumbers, is_takable, take
from solari_vk.bound.material_record import TYPES
from solari_vk.bound.table import Rows, Table, upload
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device
from solari_vk.scene.material import LAYERS, LIMITS, Material

COUNTS = {name: {"float": 1, "vec2": 2, "vec3": 3}[TYPES[name]] for name in Material._on_device}
# As `Given` of glsl/scene/given/materials.comp.
GIVEN = np.dtype(
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
        ("wrong", "u4"),
    ]
)


class GivenMaterials(GivenNumbers):
    """Writes numbers of tensors to the records of materials. table, rows: the records, and whose they are."""

    def __init__(self, device: Device, table: Table, rows: Rows[Material]) -> None:
        super().__init__(device, "", "", "")
        self._table, self._rows = table, rows
        self._list = Table(device, "given materials", GIVEN)

    def take(self, material: Material, fields: Mapping[str, Any], has_layers: bool) -> dict[str, Taken] | None:
        """Tensors of numbers that only shaders need; None for what the host must read. has_layers: the scene's shaders
        have coats, sheen and the other layers."""
        found = {}
        for name, value in fields.items():
            by_host = name in LAYERS and not has_layers
            # Rays pass smooth thin glass straight, which the host must know.
            by_host |= name == "perceptual_roughness" and material.transmission > 0 and not material.solid
            if by_host or not is_takable(self._device, value):
                return None
            if tuple(value.shape) not in ((), (1,), (COUNTS[name],)):
                return None
            if (given := take(self._device, value)) is None:
                return None
            found[name] = given
        return found

    def held_of(self, material: Material) -> dict[str, Taken]:
        """What tensors of this device gave."""
        held = {name: material._held(name) for name in material._given}
        return {name: it for name, it in held.items() if isinstance(it, Taken) and it.device is self._device}

    def write(self, materials: Mapping[Material, Mapping[str, Taken]]) -> None:
        """Have numbers in the records just before the next submission. Wrong ones leave what is there."""
        fields = self._table.records.dtype.fields
        assert fields is not None
        size, lines = self._table.records.dtype.itemsize // 4, []
        for material, numbers in materials.items():
            row = self._rows[material]
            for name, given in numbers.items():
                noted = self._noting(name)["what"] << 20 | min(row, 0xFFFFF)
                step = int(given.shape not in ((), (1,)))
                scale = material._reflectance_scale if name == "reflectance" else 1.0
                lines.append(
                    (
                        given.address,
                        given.address,
                        given.dtype == np.float64,
                        step,
                        COUNTS[name],
                        row * size + fields[name][1] // 4,
                        *LIMITS[name],
                        scale,
                        noted,
                    )
                )
        if not lines:
            return
        self._list.reserve(len(lines))
        self._list.replace()
        self._list.records[: len(lines)] = np.array(lines, GIVEN)
        self._list.marked = set(range(len(lines)))
        upload(self._device, [self._list])
        assert self._wrong is not None
        pushed = {
            "given": self._list.buffer.address,
            "target": self._table.buffer.address,
            "wrong": self._wrong.address,
            "count": len(lines),
        }
        kernel, vk = self._kernel("materials"), self._device.vk

        def record(commands: Any) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            kernel.record(commands, (len(lines), 1), **pushed)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start_with_next(record, "given materials")

    def _said(self, what: str, index: int) -> str:
        found = next((material for material, row in self._rows.items() if row == index), None)
        low, high = LIMITS[what]
        who = "a material" if found is None else found.describe()
        return f"{who}: {what} must be finite, and lie between {low:g} and {high:g}"

    def destroy(self) -> None:
        self._list.destroy()
        super().destroy()
