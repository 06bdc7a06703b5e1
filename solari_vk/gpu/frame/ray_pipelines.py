"""The one builder of ray pipelines and of their shader binding tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError, quoted
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device

_TABLE_USAGE = (
    raw.VK_BUFFER_USAGE_SHADER_BINDING_TABLE_BIT_KHR
    | raw.VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT
    | raw.VK_BUFFER_USAGE_TRANSFER_DST_BIT
)


@dataclass(frozen=True)
class RayGroups:
    """The groups of a ray pipeline, by the indices of its shaders; shader 0 generates the rays.

    `hits` are triples: the shaders for the closest hit, for any hit, and for intersections with AABBs; None for none.
    The order of the groups is that of the records in the shader binding table.
    """

    misses: tuple[int, ...]
    hits: tuple[tuple[int | None, int | None, int | None], ...]
    depth: int = 1  # of nested rays


def ray_create_info(stages: Sequence[raw.CData], groups: RayGroups, layout: raw.CData) -> raw.CData:
    """VkRayTracingPipelineCreateInfoKHR."""
    # Groups are numbered in this order: ray generation, misses, hits; records of the table follow it.
    infos = [_group(raw.VK_RAY_TRACING_SHADER_GROUP_TYPE_GENERAL_KHR, general=i) for i in (0, *groups.misses)]
    for closest, any_hit, intersection in groups.hits:
        kind = (
            raw.VK_RAY_TRACING_SHADER_GROUP_TYPE_TRIANGLES_HIT_GROUP_KHR
            if intersection is None
            else raw.VK_RAY_TRACING_SHADER_GROUP_TYPE_PROCEDURAL_HIT_GROUP_KHR
        )
        infos.append(_group(kind, closest=closest, any_hit=any_hit, intersection=intersection))
    return raw.struct(
        "VkRayTracingPipelineCreateInfoKHR",
        stageCount=len(stages),
        pStages=list(stages),
        groupCount=len(infos),
        pGroups=infos,
        # A deeper stack takes memory for each thread.
        maxPipelineRayRecursionDepth=groups.depth,
        layout=layout,
    )


def _group(
    kind: int,
    *,
    general: int | None = None,
    closest: int | None = None,
    any_hit: int | None = None,
    intersection: int | None = None,
) -> raw.CData:
    shaders = {
        "generalShader": general,
        "closestHitShader": closest,
        "anyHitShader": any_hit,
        "intersectionShader": intersection,
    }
    unused = raw.VK_SHADER_UNUSED_KHR
    indices = {field: unused if index is None else index for field, index in shaders.items()}
    return raw.struct("VkRayTracingShaderGroupCreateInfoKHR", type=kind, **indices)


class ShaderBindingTable:
    """The shader binding table of a ray pipeline: a record of one handle for each group, in their order.

    `regions` are the arguments of vkCmdTraceRaysKHR: ray generation, miss, hit and callable records.
    """

    def __init__(self, device: Device, pipeline: raw.CData, groups: RayGroups, name: str) -> None:
        properties = device.properties.ray_pipelines
        # Handles lie at multiples of one alignment, and the regions of a table at multiples of another, larger one.
        size, base = properties.shaderGroupHandleSize, properties.shaderGroupBaseAlignment
        stride = _aligned(size, properties.shaderGroupHandleAlignment)
        counts = (1, len(groups.misses), len(groups.hits))
        handles = np.zeros((sum(counts), size), np.uint8)
        device.vk.vkGetRayTracingShaderGroupHandlesKHR(
            device.handle, pipeline, 0, len(handles), handles.nbytes, raw.ffi.from_buffer(handles)
        )
        # Where each region begins: ray generation, misses, hits.
        starts = np.cumsum([0, *(_aligned(count * stride, base) for count in counts)]).tolist()
        self._buffer = device.buffer(
            starts[-1] + base, f"shader binding table of {name}", usage=_TABLE_USAGE, shared=True
        )
        # The address of the buffer itself may be less aligned.
        first = _aligned(self._buffer.address, base)
        records = np.zeros(starts[-1], np.uint8)
        self.regions = []
        at = 0
        for count, start in zip(counts, starts, strict=False):
            rows = np.ndarray((count, size), np.uint8, records, start, (stride, 1))
            rows[:] = handles[at : at + count]
            at += count
            region = {"deviceAddress": first + start, "stride": stride, "size": count * stride} if count else {}
            self.regions.append(raw.struct("VkStridedDeviceAddressRegionKHR", **region))
        # No callable shaders.
        self.regions.append(raw.struct("VkStridedDeviceAddressRegionKHR"))
        try:
            self._buffer.upload(records, first - self._buffer.address)
        except BaseException:
            self.destroy()
            raise

    def destroy(self) -> None:
        """Destroy the table when the work submitted so far is done. Safe to call twice."""
        self._buffer.destroy()


def _aligned(value: int, alignment: int) -> int:
    return -(-value // alignment) * alignment


def check_depth(device: Device, name: str, depth: Any) -> int:
    """How deep rays of a pass nest. Raises SolariError for a number that the device can't have."""
    most = int(device.properties.ray_pipelines.maxRayRecursionDepth)
    if not isinstance(depth, Integral) or not 1 <= int(depth) <= most:
        raise SolariError(
            f"pass {name}: max_recursion_depth is a whole number from 1 to {most} on this device, not {quoted(depth)}"
        )
    return int(depth)


def check_launch(device: Device, name: str, threads: tuple[int, int, int]) -> None:
    """Raise SolariError if the device can't launch so many threads at once."""
    limits = device.properties.limits
    most = device.properties.ray_pipelines.maxRayDispatchInvocationCount
    # vkCmdTraceRaysKHR is limited in each dimension by the product of the compute limits.
    sides = [
        count * size
        for count, size in zip(limits.maxComputeWorkGroupCount, limits.maxComputeWorkGroupSize, strict=True)
    ]
    if any(count > side for count, side in zip(threads, sides, strict=True)) or np.prod(threads, dtype=object) > most:
        raise SolariError(
            f"pass {name}: {threads} threads, but this device's ray pipelines launch at most {most:,}, and at most "
            f"{tuple(sides)} in each dimension"
        )
