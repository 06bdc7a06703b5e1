"""Builds of many bottom-level structures: batched by a scratch budget, compacted, or refitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.barriers import full_barrier
from solari_vk.gpu.structure import make_scratch, scratch_size

if TYPE_CHECKING:
    from solari_vk.gpu.acceleration import Blas
    from solari_vk.gpu.device import Device

SCRATCH_BUDGET = 256 << 20


def build_blases(
    device: Device,
    blases: Sequence[Blas],
    *,
    compact: bool = True,
    update: bool = False,
    scratch_budget: int = SCRATCH_BUDGET,
) -> None:
    """Build structures in as few batches as the scratch budget (bytes) allows, and compact them.

    Batches overlap nothing else that is submitted. With `compact`, waits for each batch, so that at most
    one batch is held uncompacted; their addresses are final when this returns. `update` refits structures
    that were built with allow_update. Raises SolariError for one that was destroyed, or compacted before.
    """
    for blas in blases:
        blas._check_alive("build")
        if blas.compacted:
            raise SolariError(f"build of Blas {blas.name}, which was compacted: make a new one")
        if update:
            blas._check_update()
    if len(set(map(id, blases))) != len(blases):
        raise SolariError("the same Blas twice in one build")
    for batch in _batches(device, blases, scratch_budget, update):
        _build_batch(device, batch, update)
        shrinking = [blas for blas in batch if compact and blas.allow_compaction and not update]
        if shrinking:
            _compact(device, shrinking)


def _batches(device: Device, blases: Sequence[Blas], budget: int, update: bool) -> list[list[Blas]]:
    """Consecutive structures whose scratch fits the budget together; one that doesn't is alone."""
    batches: list[list[Blas]] = []
    scratch = storage = 0
    for blas in blases:
        need = scratch_size(device, blas, update)
        # Storage before compaction is bounded too: it is several times the scratch.
        if not batches or scratch + need > budget or storage + blas.size > 4 * budget:
            batches.append([])
            scratch = storage = 0
        batches[-1].append(blas)
        scratch += need
        storage += blas.size
    return batches


def _build_batch(device: Device, batch: Sequence[Blas], update: bool) -> None:
    scratch, address = make_scratch(device, sum(scratch_size(device, b, update) for b in batch), "blas scratch")
    infos = []
    for blas in batch:
        if blas.handle is None:
            blas._create(blas.size)
        infos.append(blas._build_info(address, update=update))
        address += scratch_size(device, blas, update)
    infos_array = raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos)
    ranges = raw.array("VkAccelerationStructureBuildRangeInfoKHR*", [blas.ranges for blas in batch])

    def record(cmd: raw.CData) -> None:
        vk = device.vk
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBuildAccelerationStructuresKHR(cmd, len(batch), infos_array, ranges)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    device.start(record, "build blases")
    for blas in batch:
        blas.build_count += 1
    scratch.destroy()


def _compact(device: Device, blases: Sequence[Blas]) -> None:
    """Copy structures just built into storage of the size that they turned out to need."""
    vk = device.vk
    create = raw.struct(
        "VkQueryPoolCreateInfo",
        queryType=raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR,
        queryCount=len(blases),
    )
    pool = device.create("VkQueryPool", create, "compacted sizes")
    try:
        vk.vkResetQueryPool(device.handle, pool, 0, len(blases))
        handles = raw.array("VkAccelerationStructureKHR", [blas.handle for blas in blases])
        kind = raw.VK_QUERY_TYPE_ACCELERATION_STRUCTURE_COMPACTED_SIZE_KHR
        device.run(
            lambda cmd: vk.vkCmdWriteAccelerationStructuresPropertiesKHR(cmd, len(blases), handles, kind, pool, 0),
            "compacted sizes",
        )
        sizes = np.zeros(len(blases), np.uint64)
        flags = raw.VK_QUERY_RESULT_64_BIT | raw.VK_QUERY_RESULT_WAIT_BIT
        target = raw.ffi.from_buffer(sizes)
        vk.vkGetQueryPoolResults(device.handle, pool, 0, len(blases), sizes.nbytes, target, 8, flags)
    finally:
        device.retire(lambda: vk.vkDestroyQueryPool(device.handle, pool, raw.NULL))
    copies = []
    for blas, size in zip(blases, sizes.tolist(), strict=True):
        if 0 < size < blas.size:
            source, storage, token = blas.handle, blas._storage, blas._token
            blas._create(size)
            copies.append((source, blas.handle, storage, token))
            blas.compacted = True

    def record(cmd: raw.CData) -> None:
        for source, target, _, _ in copies:
            info = raw.struct(
                "VkCopyAccelerationStructureInfoKHR",
                src=source,
                dst=target,
                mode=raw.VK_COPY_ACCELERATION_STRUCTURE_MODE_COMPACT_KHR,
            )
            vk.vkCmdCopyAccelerationStructureKHR(cmd, info)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    if copies:
        device.start(record, "compact blases")
    for _, _, storage, token in copies:
        device.release(token)
        storage.destroy()
