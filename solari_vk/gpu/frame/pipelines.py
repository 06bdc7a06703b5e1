"""Compute, graphics and ray pipelines. The device keeps them by what they are made from: none is made twice."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, reworded
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.compiling import announced
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.graphics import Targets, graphics_create_info
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.ray_pipelines import RayGroups, ShaderBindingTable, ray_create_info
from solari_vk.gpu.shaders.specialized import has_many_switches, specialized
from solari_vk.gpu.shaders.spirv import Module

Constants = Mapping[str, "int | float | bool"]
PipelineKey = tuple[Any, ...]

_STAGES = {
    "comp": raw.VK_SHADER_STAGE_COMPUTE_BIT,
    "vert": raw.VK_SHADER_STAGE_VERTEX_BIT,
    "frag": raw.VK_SHADER_STAGE_FRAGMENT_BIT,
    "rgen": raw.VK_SHADER_STAGE_RAYGEN_BIT_KHR,
    "rmiss": raw.VK_SHADER_STAGE_MISS_BIT_KHR,
    "rchit": raw.VK_SHADER_STAGE_CLOSEST_HIT_BIT_KHR,
    "rahit": raw.VK_SHADER_STAGE_ANY_HIT_BIT_KHR,
    "rint": raw.VK_SHADER_STAGE_INTERSECTION_BIT_KHR,
}
_BIND_POINTS = {
    type(None): raw.VK_PIPELINE_BIND_POINT_COMPUTE,
    Targets: raw.VK_PIPELINE_BIND_POINT_GRAPHICS,
    RayGroups: raw.VK_PIPELINE_BIND_POINT_RAY_TRACING_KHR,
}


@dataclass(frozen=True)
class PipelineInfo:
    """What a pass needs: a compute shader; with `Targets` a vertex and a fragment shader; with `RayGroups` the shaders
    that the groups number; and their constants. robust: as in `Frame`."""

    name: str
    modules: Sequence[Module]
    constants: Constants
    kind: Targets | RayGroups | None = None
    robust: bool = False


@dataclass(eq=False)
class Pipeline:
    """A VkPipeline, the point to which it is bound, and the shader binding table of a ray pipeline.

    info: what it is made from. addresses: the buffers whose addresses are its push constants (`access_by_address`).
    has_run: whether it has run once to have a software driver compile it (`Slot.run_new`).
    """

    info: PipelineInfo
    handle: raw.CData
    bind_point: int
    table: ShaderBindingTable | None
    addresses: tuple[str, ...] = ()
    has_run: bool = False


class Pipelines:
    """The pipelines that one user of a device needs."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._shared = device.pipelines
        self._acquired: dict[PipelineKey, Pipeline] = {}
        self._addresses: dict[PipelineKey, tuple[str, ...]] = {}

    def make(self, wanted: Sequence[PipelineInfo], interface: Interface) -> list[tuple[PipelineKey, Pipeline]]:
        """A pipeline for each pass, and the key that keeps it in `retain`. What the device lacks is created in threads.

        Raises SolariError for a constant that no module has, DeviceError naming the pass if the driver fails.
        """
        layout = interface.pipeline_layout
        keys: list[PipelineKey] = []
        missing: dict[PipelineKey, tuple[PipelineInfo, Callable[[], raw.CData]]] = {}
        with ExitStack() as shaders:
            for item in wanted:
                specializations, values = _specializations(item.name, item.modules, item.constants)
                # The key says all that a driver sees: code, kind, values of constants, and layout.
                digests = tuple(hashlib.sha256(module.spirv).digest() for module in item.modules)
                key = (digests, item.kind, tuple(sorted(values.items())), interface.key, item.robust)
                keys.append(key)
                if not self._acquire(key) and key not in missing:
                    stages = self._stages(shaders, key, item, specializations, interface)
                    missing[key] = item, self._creation(stages, item, layout)
            self._create(missing)
        return [(key, self._acquired[key]) for key in keys]

    def _acquire(self, key: PipelineKey) -> bool:
        """Use a pipeline that the device has, if it has one with this key."""
        if key not in self._acquired:
            known = self._shared.acquire(key)
            if known is None:
                return False
            self._acquired[key] = known
        return True

    def _stages(
        self,
        shaders: ExitStack,
        key: PipelineKey,
        item: PipelineInfo,
        specializations: list[raw.CData | None],
        interface: Interface,
    ) -> list[raw.CData]:
        """The shaders of a pipeline, valid until `shaders` closes. specializations: of each module."""
        modules = list(item.modules)
        for at, module in enumerate(modules):
            # A software driver is faster with a module that has no code to switch off.
            if self._device.properties.kind == "cpu" and has_many_switches(module):
                modules[at] = specialized(module, item.constants)
                specializations[at] = None
        codes = [module.spirv for module in modules]
        # An address has no size that could be checked.
        if item.kind is None and not item.robust:
            codes[0], self._addresses[key] = interface.addressed(modules[0])
        linked = map(interface.linked, modules, codes)
        return [
            self._stage(shaders, item.name, module, code, specialization)
            for module, code, specialization in zip(item.modules, linked, specializations, strict=True)
        ]

    def _creation(self, stages: list[raw.CData], item: PipelineInfo, layout: raw.CData) -> Callable[[], raw.CData]:
        """A function for another thread that creates a pipeline."""
        device = self._device
        kind = item.kind
        cache = self._device.pipeline_cache.handle
        before: tuple[raw.CData, ...] = (device.handle,)
        if kind is None:
            # On a software device dispatches can be divided: see `Slot.in_parts`.
            flags = raw.VK_PIPELINE_CREATE_DISPATCH_BASE if device.properties.kind == "cpu" else 0
            info = raw.struct("VkComputePipelineCreateInfo", flags=flags, stage=stages[0], layout=layout)
            create = device.vk.vkCreateComputePipelines
        elif isinstance(kind, Targets):
            info = graphics_create_info(stages, kind, layout)
            create = device.vk.vkCreateGraphicsPipelines
        else:
            info = ray_create_info(stages, kind, layout)
            create = device.vk.vkCreateRayTracingPipelinesKHR
            before = (device.handle, raw.NULL)  # no deferred operation
        out = raw.ffi.new("VkPipeline*")
        chain = [info]
        if item.robust and "pipelineRobustness" in device.features:
            robustness = _robustness()
            robustness.pNext = info.pNext
            info.pNext = raw.ffi.cast("void*", robustness)
            chain.append(robustness)  # kept until the call, because `info` has its address alone

        def run() -> raw.CData:
            create(*before, cache, 1, chain[0], raw.NULL, out)
            return out[0]

        return run

    def _create(self, missing: Mapping[PipelineKey, tuple[PipelineInfo, Callable[[], raw.CData]]]) -> None:
        """Create pipelines in as many threads as there are processors: drivers compile for up to seconds."""
        if not missing:
            return
        # vkCreate*Pipelines run in C without Python's lock; the pipeline cache allows several threads.
        threads = ThreadPoolExecutor(os.cpu_count())
        futures: dict[PipelineKey, Future[raw.CData]] = {}
        try:
            for key, (_, create) in missing.items():
                futures[key] = threads.submit(create)
            names = [item.name for item, _ in missing.values()]
            with announced(self._device.on_compile, "pipelines", names, list(futures.values())) as items:
                for future in items:
                    wait([future])
        finally:  # after Ctrl-C too, because the threads use the shader modules
            threads.shutdown(cancel_futures=True)
            # All that succeeded is kept, whatever failed: the next attempt needn't make it again.
            done = [(key, future) for key, future in futures.items() if not future.cancelled()]
            errors = [self._keep(key, missing[key][0], future) for key, future in done]
            failures = [error for error in errors if error is not None]
        if failures:
            raise failures[0]
        self._device.pipeline_cache.save()

    def _keep(self, key: PipelineKey, item: PipelineInfo, future: Future[raw.CData]) -> SolariError | None:
        """Keep what a thread has created, with its table; returns the error if one of them has failed."""
        device = self._device
        table = None
        token = 0

        def destroy() -> None:
            device.release(token)
            if table is not None:
                table.destroy()

        try:
            handle = future.result()
            token = device.register(lambda: device.vk.vkDestroyPipeline(device.handle, handle, raw.NULL))
            device.name_object("Pipeline", handle, item.name)
            if isinstance(item.kind, RayGroups):
                table = ShaderBindingTable(device, handle, item.kind, item.name)
        except SolariError as error:
            destroy()
            return reworded(error, f"pass {item.name}: {error}")
        if self._acquire(key):  # another frame has made it meanwhile, called by `on_compile`
            destroy()
            return None
        # From here on the pipeline belongs to the device, and outlives the frame that asked for it.
        device.share(token)
        addresses = self._addresses.pop(key, ())
        self._acquired[key] = Pipeline(item, handle, _BIND_POINTS[type(item.kind)], table, addresses)
        self._shared.add(key, self._acquired[key], destroy)
        return None

    def _stage(
        self, shaders: ExitStack, name: str, module: Module, linked: bytes, specialization: raw.CData | None
    ) -> raw.CData:
        """A VkPipelineShaderStageCreateInfo, valid until `shaders` closes."""
        device = self._device
        code = np.frombuffer(linked, np.uint32)
        # A module is needed only until the pipelines that use it are made.
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
        """Give all others back to the device, which destroys those that go when the work submitted so far is done."""
        for key in self._acquired.keys() - used:
            del self._acquired[key]
            self._shared.release(key)

    def destroy(self) -> None:
        """Give everything back to the device. Safe to call twice."""
        self.retain(set())


def _robustness() -> raw.CData:
    buffers = raw.VK_PIPELINE_ROBUSTNESS_BUFFER_BEHAVIOR_ROBUST_BUFFER_ACCESS_EXT
    return raw.struct(
        "VkPipelineRobustnessCreateInfoEXT",
        storageBuffers=buffers,
        uniformBuffers=buffers,
        vertexInputs=buffers,
        images=raw.VK_PIPELINE_ROBUSTNESS_IMAGE_BEHAVIOR_ROBUST_IMAGE_ACCESS_EXT,
    )


def _specializations(
    name: str, modules: Sequence[Module], constants: Constants
) -> tuple[list[raw.CData | None], dict[str, int | float | bool]]:
    """A VkSpecializationInfo for each module (None without constants), and all values by name."""
    known = {constant: where.dtype for module in modules for constant, where in module.constants.items()}
    for constant in constants:
        if constant not in known:
            hint = "; ray generation shaders run without a local size, so leave out its constants on this device"
            raise SolariError(
                f"pass {name}: it has no specialization constant {constant}; those it uses are "
                f"{', '.join(sorted(known)) or 'none'}{hint if modules[0].main.stage == 'rgen' else ''}"
            )
    values = {constant: np.array(value, known[constant]).item() for constant, value in constants.items()}
    return [_specialization(module, constants) for module in modules], values


def _specialization(module: Module, constants: Constants) -> raw.CData | None:
    entries = []
    data = b""
    # In the same order in every process: pipeline caches compare the entries in their order.
    for constant in constants:
        known = module.constants.get(constant)
        if known is None:
            continue
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
