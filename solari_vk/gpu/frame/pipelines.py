"""Compute and graphics pipelines, kept by what they are made from, so that only what changed is made again."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.errors import DeviceError, SolariError
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


@dataclass(frozen=True)
class PipelineInfo:
    """What a pass needs: a compute shader, or with `targets` a vertex and a fragment shader, and their constants."""

    name: str
    modules: Sequence[Module]
    constants: Constants
    targets: Targets | None = None


class Pipelines:
    """The pipelines made so far."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._made: dict[PipelineKey, tuple[raw.CData, int]] = {}

    def make(self, wanted: Sequence[PipelineInfo], interface: Interface) -> list[tuple[PipelineKey, raw.CData]]:
        """A pipeline for each pass, and the key that keeps it in `retain`. Missing ones are created in threads.

        Raises SolariError for a constant that no module has, DeviceError naming the pass if the driver fails.
        """
        layout = interface.pipeline_layout
        keys: list[PipelineKey] = []
        missing: dict[PipelineKey, tuple[str, Callable[[], raw.CData]]] = {}
        with ExitStack() as shaders:
            for item in wanted:
                specializations, values = _specializations(item.name, item.modules, item.constants)
                digests = tuple(hashlib.sha256(module.spirv).digest() for module in item.modules)
                handle = int(raw.ffi.cast("uintptr_t", layout))
                keys.append((*digests, item.targets, tuple(sorted(values.items())), handle))
                if keys[-1] not in self._made and keys[-1] not in missing:
                    stages = [self._stage(shaders, item.name, *pair)
                              for pair in zip(item.modules, specializations, strict=True)]  # fmt: skip
                    missing[keys[-1]] = item.name, self._creation(stages, item.targets, layout)
            self._create(missing)
        return [(key, self._made[key][0]) for key in keys]

    def _creation(self, stages: list[raw.CData], targets: Targets | None, layout: raw.CData) -> Callable[[], raw.CData]:
        """A function for another thread that creates a pipeline."""
        device, cache = self._device, self._device.pipeline_cache.handle
        if targets is None:
            info = raw.struct("VkComputePipelineCreateInfo", stage=stages[0], layout=layout)
            create = device.vk.vkCreateComputePipelines
        else:
            info = graphics_create_info(stages, targets, layout)
            create = device.vk.vkCreateGraphicsPipelines
        out = raw.ffi.new("VkPipeline*")

        def run() -> raw.CData:
            create(device.handle, cache, 1, info, raw.NULL, out)
            return out[0]

        return run

    def _create(self, missing: Mapping[PipelineKey, tuple[str, Callable[[], raw.CData]]]) -> None:
        """Create pipelines in as many threads as there are processors: drivers compile for up to seconds."""
        if not missing:
            return
        threads = ThreadPoolExecutor(os.cpu_count())
        futures: dict[PipelineKey, Future[raw.CData]] = {}
        try:
            for key, (_, create) in missing.items():
                futures[key] = threads.submit(create)
            wait(futures.values())
        finally:  # after Ctrl-C too, because the threads use the shader modules
            threads.shutdown(cancel_futures=True)
            done = [(key, future) for key, future in futures.items() if not future.cancelled()]
            failures = [failed for key, future in done if (failed := self._keep(key, missing[key][0], future))]
        if failures:
            raise failures[0]
        self._device.pipeline_cache.save()

    def _keep(self, key: PipelineKey, name: str, future: Future[raw.CData]) -> DeviceError | None:
        """Keep what a thread has created; returns the error if it has failed."""
        device = self._device
        try:
            pipeline = future.result()
        except DeviceError as error:
            return DeviceError(f"pass {name}: {error}")
        device.name_object("Pipeline", pipeline, name)
        token = device.own(lambda: device.vk.vkDestroyPipeline(device.handle, pipeline, raw.NULL))
        self._made[key] = pipeline, token
        return None

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
