"""Compute and graphics pipelines, kept by what they are made from, so that only what changed is made again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.graphics import Targets, graphics_create_info
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.shaders.spirv import Module

Constants = Mapping[str, "int | float | bool"]
PipelineKey = tuple[Any, ...]

_STAGES = {
    "comp": raw.VK_SHADER_STAGE_COMPUTE_BIT,
    "vert": raw.VK_SHADER_STAGE_VERTEX_BIT,
    "frag": raw.VK_SHADER_STAGE_FRAGMENT_BIT,
}


class Pipelines:
    """The pipelines made so far, with one VkPipelineCache."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._cache = device.create("VkPipelineCache", raw.struct("VkPipelineCacheCreateInfo"), "pipeline cache")
        self._cache_token = device.own(lambda: device.vk.vkDestroyPipelineCache(device.handle, self._cache, raw.NULL))
        self._made: dict[PipelineKey, tuple[raw.CData, int]] = {}

    def pipeline(
        self, name: str, modules: Sequence[Module], constants: Constants, interface: Interface, targets: Targets | None
    ) -> tuple[PipelineKey, raw.CData]:
        """A pipeline with these specialization constants, and the key that keeps it in `retain`.

        modules: a compute shader, or with `targets` a vertex and a fragment shader. Raises SolariError for a constant
        that no module has.
        """
        specializations, values = _specializations(name, modules, constants)
        digests = tuple(hashlib.sha256(module.spirv).digest() for module in modules)
        layout = interface.pipeline_layout
        key = (*digests, targets, tuple(sorted(values.items())), int(raw.ffi.cast("uintptr_t", layout)))
        if key not in self._made:
            device = self._device
            out = raw.ffi.new("VkPipeline*")
            with ExitStack() as shaders:
                stages = [self._stage(shaders, name, *pair) for pair in zip(modules, specializations, strict=True)]
                if targets is None:
                    info = raw.struct("VkComputePipelineCreateInfo", stage=stages[0], layout=layout)
                    make = device.vk.vkCreateComputePipelines
                else:
                    info = graphics_create_info(stages, targets, layout)
                    make = device.vk.vkCreateGraphicsPipelines
                make(device.handle, self._cache, 1, info, raw.NULL, out)
            pipeline = out[0]
            device.name_object("Pipeline", pipeline, name)
            token = device.own(lambda: device.vk.vkDestroyPipeline(device.handle, pipeline, raw.NULL))
            self._made[key] = pipeline, token
        return key, self._made[key][0]

    def _stage(self, shaders: ExitStack, name: str, module: Module, specialization: raw.CData | None) -> raw.CData:
        """A VkPipelineShaderStageCreateInfo, valid until `shaders` closes."""
        device = self._device
        code = np.frombuffer(module.spirv, np.uint32)
        create = raw.struct("VkShaderModuleCreateInfo", codeSize=code.nbytes, pCode=code)
        shader = device.create("VkShaderModule", create, name)
        shaders.callback(device.vk.vkDestroyShaderModule, device.handle, shader, raw.NULL)
        return raw.struct(
            "VkPipelineShaderStageCreateInfo",
            stage=_STAGES[module.main.stage],
            module=shader,
            pName="main",
            pSpecializationInfo=specialization,
        )

    def retain(self, used: set[PipelineKey]) -> None:
        """Destroy all other pipelines when the work submitted so far is done."""
        for key in [key for key in self._made if key not in used]:
            self._device.release(self._made.pop(key)[1])

    def destroy(self) -> None:
        """Destroy everything when the work submitted so far is done. Safe to call twice."""
        self.retain(set())
        self._device.release(self._cache_token)


def _specializations(
    name: str, modules: Sequence[Module], constants: Constants
) -> tuple[list[raw.CData | None], dict[str, int | float | bool]]:
    """A VkSpecializationInfo for each module (None without constants), and all values by name."""
    known = {constant: where.dtype for module in modules for constant, where in module.constants.items()}
    for constant in constants:
        if constant not in known:
            raise SolariError(
                f"pass {name}: it has no specialization constant {constant}; those it uses are "
                f"{', '.join(sorted(known)) or 'none'}"
            )
    values = {constant: np.array(value, known[constant]).item() for constant, value in constants.items()}
    return [_specialization(module, constants) for module in modules], values


def _specialization(module: Module, constants: Constants) -> raw.CData | None:
    entries, data = [], b""
    for constant in constants.keys() & module.constants.keys():
        known = module.constants[constant]
        entries.append({"constantID": known.id, "offset": len(data), "size": known.dtype.itemsize})
        data += np.array(constants[constant], known.dtype).tobytes()
    if not entries:
        return None
    return raw.struct(
        "VkSpecializationInfo",
        mapEntryCount=len(entries),
        pMapEntries=entries,
        dataSize=len(data),
        pData=np.frombuffer(data, np.uint8),
    )
