"""Barriers as structures: global memory barriers, and layout transitions of an image."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from solari_vk.gpu.device import raw

ALL_COMMANDS = raw.VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT
READ = raw.VK_ACCESS_2_MEMORY_READ_BIT
WRITE = raw.VK_ACCESS_2_MEMORY_WRITE_BIT


def memory_barrier(written: int, read: int, *, source: int = ALL_COMMANDS, target: int = ALL_COMMANDS) -> raw.CData:
    """A VkDependencyInfo with one global memory barrier: access masks and, optionally, stage masks."""
    barrier = raw.struct(
        "VkMemoryBarrier2", srcStageMask=source, srcAccessMask=written, dstStageMask=target, dstAccessMask=read
    )
    return raw.struct("VkDependencyInfo", memoryBarrierCount=1, pMemoryBarriers=barrier)


@cache
def full_barrier() -> raw.CData:
    """Orders all commands and memory accesses before it ahead of all after it."""
    return memory_barrier(WRITE, READ | WRITE)


@cache
def host_read_barrier() -> raw.CData:
    """Makes all device writes before it visible to the host."""
    return memory_barrier(WRITE, raw.VK_ACCESS_2_HOST_READ_BIT, target=raw.VK_PIPELINE_STAGE_2_HOST_BIT)


def layout_barrier(image: raw.CData, levels: Mapping[str, int], old: int, new: int) -> raw.CData:
    """A layout transition of a VkImage's subresource range, with the ordering of a full barrier."""
    barrier = raw.struct(
        "VkImageMemoryBarrier2",
        srcStageMask=ALL_COMMANDS,
        srcAccessMask=WRITE,
        dstStageMask=ALL_COMMANDS,
        dstAccessMask=READ | WRITE,
        oldLayout=old,
        newLayout=new,
        srcQueueFamilyIndex=raw.VK_QUEUE_FAMILY_IGNORED,
        dstQueueFamilyIndex=raw.VK_QUEUE_FAMILY_IGNORED,
        image=image,
        subresourceRange=levels,
    )
    return raw.struct("VkDependencyInfo", imageMemoryBarrierCount=1, pImageMemoryBarriers=barrier)
