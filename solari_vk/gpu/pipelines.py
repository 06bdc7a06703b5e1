"""Compute pipelines of a frame's passes, kept by what they are made of so that only what changed is made again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.device import Device
from solari_vk.gpu.interface import Interface
from solari_vk.gpu.spirv import Module

Constants = Mapping[str, "int | float | bool"]
PipelineKey = tuple[bytes, tuple[tuple[str, Any], ...], int]


class Pipelines:
    """Pipelines made so far, behind one VkPipelineCache."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._cache = device.create("VkPipelineCache", raw.struct("VkPipelineCacheCreateInfo"), "pipeline cache")
        self._cache_token = device.own(
            lambda: device.vk.vkDestroyPipelineCache(device.handle, self._cache, raw.NULL)
        )
        self._made: dict[PipelineKey, tuple[raw.CData, int]] = {}

    def compute(
        self, name: str, module: Module, constants: Constants, interface: Interface
    ) -> tuple[PipelineKey, raw.CData]:
        """The pipeline of a module with these specialization constants, and the key that keeps it in `retain`.

        Raises SolariError for a constant that the module hasn't got.
        """
        specialization, values = _specialization(name, module, constants)
        digest = hashlib.sha256(module.spirv).digest()
        key = (digest, tuple(sorted(values.items())), int(raw.ffi.cast("uintptr_t", interface.pipeline_layout)))
        if key not in self._made:
            self._made[key] = self._make(name, module, specialization, interface)
        return key, self._made[key][0]

    def _make(
        self, name: str, module: Module, specialization: raw.CData | None, interface: Interface
    ) -> tuple[raw.CData, int]:
        device = self._device
        code = np.frombuffer(module.spirv, np.uint32)
        create_module = raw.struct("VkShaderModuleCreateInfo", codeSize=code.nbytes, pCode=code)
        shader = device.create("VkShaderModule", create_module, name)
        try:
            stage = raw.struct(
                "VkPipelineShaderStageCreateInfo",
                stage=raw.VK_SHADER_STAGE_COMPUTE_BIT,
                module=shader,
                pName="main",
                pSpecializationInfo=specialization,
            )
            create = raw.struct("VkComputePipelineCreateInfo", stage=stage, layout=interface.pipeline_layout)
            out = raw.ffi.new("VkPipeline*")
            device.vk.vkCreateComputePipelines(device.handle, self._cache, 1, create, raw.NULL, out)
        finally:
            device.vk.vkDestroyShaderModule(device.handle, shader, raw.NULL)
        pipeline = out[0]
        device.name_object("pipeline", pipeline, name)
        return pipeline, device.own(lambda: device.vk.vkDestroyPipeline(device.handle, pipeline, raw.NULL))

    def retain(self, used: set[PipelineKey]) -> None:
        """Destroy all other pipelines when the work submitted so far is done."""
        for key in [key for key in self._made if key not in used]:
            self._device.release(self._made.pop(key)[1])

    def destroy(self) -> None:
        """Destroy everything when the work submitted so far is done. Safe to call twice."""
        self.retain(set())
        self._device.release(self._cache_token)


def _specialization(
    name: str, module: Module, constants: Constants
) -> tuple[raw.CData | None, dict[str, int | float | bool]]:
    """VkSpecializationInfo for constants by name, and their values."""
    if not constants:
        return None, {}
    entries, data, values = [], b"", {}
    for constant, value in constants.items():
        known = module.constants.get(constant)
        if known is None:
            raise SolariError(
                f"pass {name}: it has no specialization constant {constant}; those it uses are "
                f"{', '.join(sorted(module.constants)) or 'none'}"
            )
        stored = np.array(value, known.dtype)
        values[constant] = stored.item()
        entries.append({"constantID": known.id, "offset": len(data), "size": known.dtype.itemsize})
        data += stored.tobytes()
    info = raw.struct(
        "VkSpecializationInfo",
        mapEntryCount=len(entries),
        pMapEntries=entries,
        dataSize=len(data),
        pData=np.frombuffer(data, np.uint8),
    )
    return info, values
