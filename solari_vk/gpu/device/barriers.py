"""Barriers as structures: global ones, and layout changes of a whole image."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING

from solari_vk.gpu.device import raw

if TYPE_CHECKING:
    from solari_vk.gpu.device.memory import Image

ALL_COMMANDS = raw.VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT
READ = raw.VK_ACCESS_2_MEMORY_READ_BIT
WRITE = raw.VK_ACCESS_2_MEMORY_WRITE_BIT


def memory_barrier(written: int, read: int, *, source: int = ALL_COMMANDS, target: int = ALL_COMMANDS) -> raw.CData:
    """A VkDependencyInfo with one global memory barrier: access masks, and stages where they matter."""
    barrier = raw.struct(
        "VkMemoryBarrier2", srcStageMask=source, srcAccessMask=written, dstStageMask=target, dstAccessMask=read
    )
    return raw.struct("VkDependencyInfo", memoryBarrierCount=1, pMemoryBarriers=barrier)


@cache
def full_barrier() -> raw.CData:
    """Everything before finishes, and its writes are seen, before anything after starts."""
    return memory_barrier(WRITE, READ | WRITE)


@cache
def host_read_barrier() -> raw.CData:
    """What the device wrote before becomes visible to the host."""
    return memory_barrier(WRITE, raw.VK_ACCESS_2_HOST_READ_BIT, target=raw.VK_PIPELINE_STAGE_2_HOST_BIT)


def image_barrier(image: Image, old: int, new: int) -> raw.CData:
    """All of an image from one layout to another, after everything before and before everything after."""
    return layout_barrier(image.handle, image.all_levels, old, new)


def layout_barrier(image: raw.CData, levels: Mapping[str, int], old: int, new: int) -> raw.CData:
    """As `image_barrier`, for a VkImage and its subresource range: also of images that a window owns."""
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
