"""Brings pictures to the window: a small command buffer for each image of the swapchain, recorded when it changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device import barriers, raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.command_pool import CommandPool
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.device.swapchain import Swapchain

_WHOLE = {"aspectMask": raw.VK_IMAGE_ASPECT_COLOR_BIT, "levelCount": 1, "layerCount": 1}
_LAYER = {"aspectMask": raw.VK_IMAGE_ASPECT_COLOR_BIT, "layerCount": 1}
_UNDEFINED, _PRESENT = raw.VK_IMAGE_LAYOUT_UNDEFINED, raw.VK_IMAGE_LAYOUT_PRESENT_SRC_KHR
_TARGET, _SOURCE = raw.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, raw.VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL
TRIES = 3  # a window that was resized just now gives no image at first


@dataclass(frozen=True)
class Part:
    """The columns of an image from `begin` to `end`, parts of its width, shown in the same columns of the window.

    Parts meet between two texels of the first one's image."""

    image: Image
    begin: float = 0.0
    end: float = 1.0


class Presenter:
    """Shows images of any size in a window, filtered linearly. Use it with the device's one queue, after the work
    that makes the images. `close` frees what it made."""

    def __init__(self, device: Device, swapchain: Swapchain) -> None:
        self.device = device
        self.swapchain = swapchain
        self._generation = -1
        self._commands: list[raw.CData] = []
        self._read_commands: raw.CData = None
        self._composed: Image | None = None  # several parts side by side
        self._shown: list[list[Part] | None] = []
        self._values: list[int] = []
        self._pool = CommandPool(device, "window")

    def show(self, parts: Sequence[Part], draw: Callable[[int], raw.CData] | None = None) -> bool:
        """Show the parts, which cover the window, or black without any; False when the window shows nothing now.

        draw: gives commands that draw over image `index` of the swapchain, in the layout PRESENT_SRC, or None.
        """
        return self._show(parts, draw, lambda _: [])

    def capture(
        self, parts: Sequence[Part], draw: Callable[[int], raw.CData] | None = None
    ) -> NDArray[np.uint8] | None:
        """As `show`; returns what the window then shows, (height, width, 3), or None when that can't be read."""
        targets: list[Buffer] = []  # one at most: a frame that is shown ends the tries

        def read(index: int) -> list[raw.CData]:
            if not self.swapchain.readable:
                return []
            width, height = self.swapchain.extent
            targets.append(self.device.buffer(4 * width * height, "window pixels", host=True))
            return [self._record_read(self.swapchain.images[index], targets[0])]

        try:
            if not any(self._show(parts, draw, read) for _ in range(TRIES)) or not targets:
                return None
            width, height = self.swapchain.extent
            pixels = targets[0].read().reshape(height, width, 4)[..., :3].copy()
        finally:
            for target in targets:
                target.destroy()
        return pixels[..., ::-1].copy() if self.swapchain.format == raw.VK_FORMAT_B8G8R8A8_UNORM else pixels

    def _show(
        self, parts: Sequence[Part], draw: Callable[[int], raw.CData] | None, after: Callable[[int], list[raw.CData]]
    ) -> bool:
        index = self.swapchain.acquire()
        if index is None:
            return False
        try:
            if self._generation != self.swapchain.generation:
                self._allocate()
            if self._shown[index] != list(parts):
                self.device.await_value(self._values[index])
                self._record(self._commands[index], self.swapchain.images[index], parts)
                self._shown[index] = list(parts)
            drawn = None if draw is None else draw(index)
            commands = [self._commands[index], *([] if drawn is None else [drawn]), *after(index)]
            self._values[index] = self.swapchain.present(index, commands)
        except BaseException:
            self.swapchain.stale = True  # the image was acquired and not presented: others take its place
            raise
        return True

    def _record_read(self, image: raw.CData, target: Buffer) -> raw.CData:
        """Commands that copy an image of the window to a buffer."""
        if self._read_commands is None:
            [self._read_commands] = self._pool.allocate(1)
        vk, commands = self.device.vk, self._read_commands
        width, height = self.swapchain.extent
        extent = {"width": width, "height": height, "depth": 1}
        region = raw.struct("VkBufferImageCopy", imageSubresource=_LAYER, imageExtent=extent)
        vk.vkBeginCommandBuffer(commands, raw.struct("VkCommandBufferBeginInfo"))
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(image, _PRESENT, _SOURCE))
        vk.vkCmdCopyImageToBuffer(commands, image, _SOURCE, target.handle, 1, region)
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(image, _SOURCE, _PRESENT))
        vk.vkEndCommandBuffer(commands)
        return commands

    def _allocate(self) -> None:
        """Command buffers for another swapchain; those of the old one aren't running any more."""
        missing = len(self.swapchain.images) - len(self._commands)
        if missing > 0:
            self._commands += self._pool.allocate(missing)
        self._shown = [None] * len(self._commands)
        self._values = [0] * len(self._commands)
        self._generation = self.swapchain.generation

    def _record(self, commands: raw.CData, target: raw.CData, parts: Sequence[Part]) -> None:
        vk = self.device.vk
        vk.vkBeginCommandBuffer(commands, raw.struct("VkCommandBufferBeginInfo"))
        vk.vkCmdPipelineBarrier2(commands, full_barrier())  # the parts were written by the renderers
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(target, _UNDEFINED, _TARGET))
        if not parts:
            black, whole = raw.ffi.new("VkClearColorValue*"), raw.struct("VkImageSubresourceRange", **_WHOLE)
            vk.vkCmdClearColorImage(commands, target, _TARGET, black, 1, whole)
        else:
            image = parts[0].image if len(parts) == 1 else self._compose(commands, parts)
            blit = _blit((0, image.width), image.height, (0, self.swapchain.extent[0]), self.swapchain.extent[1])
            vk.vkCmdBlitImage(commands, image.handle, image.layout, target, _TARGET, 1, blit, raw.VK_FILTER_LINEAR)
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(target, _TARGET, _PRESENT))
        vk.vkEndCommandBuffer(commands)

    def _compose(self, commands: raw.CData, parts: Sequence[Part]) -> Image:
        """Put parts side by side in an image of the first one's size: stretched each by itself, they would be shifted
        against the whole, since a blit's regions begin and end at whole pixels of the window."""
        first = parts[0].image
        composed = self._composed
        if composed is None or (composed.width, composed.height) != (first.width, first.height):
            if composed is not None:
                composed.destroy()
                self._composed = None
            usage = raw.VK_IMAGE_USAGE_STORAGE_BIT  # which keeps it in a layout that copies write and read
            composed = self.device.image(first.width, first.height, first.format, "window parts", usage=usage)
            self._composed = composed
        for part in parts:
            image, target = part.image, _columns(part, first.width)
            if target[0] < target[1]:
                blit = _blit(_columns(part, image.width, least=1), image.height, target, first.height)
                self.device.vk.vkCmdBlitImage(
                    commands, image.handle, image.layout, composed.handle, composed.layout, 1, blit,
                    raw.VK_FILTER_LINEAR,
                )  # fmt: skip
        self.device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
        return composed

    def close(self) -> None:
        """Free the command buffers when the work submitted so far is done. Safe to call twice."""
        if self._composed is not None:
            self._composed.destroy()
            self._composed = None
        self._pool.destroy()


def _columns(part: Part, width: int, least: int = 0) -> tuple[int, int]:
    """The columns of a part in an image of a width, at least so many."""
    begin, end = min(round(part.begin * width), width - least), round(part.end * width)
    return begin, max(end, begin + least)


def _blit(source: tuple[int, int], source_height: int, target: tuple[int, int], target_height: int) -> raw.CData:
    """VkImageBlit from columns to columns, from top to bottom."""
    blit = raw.struct("VkImageBlit", srcSubresource=_LAYER, dstSubresource=_LAYER)
    for offsets, columns, height in (
        (blit.srcOffsets, source, source_height),
        (blit.dstOffsets, target, target_height),
    ):
        offsets[0].x, offsets[1].x = columns
        offsets[1].y, offsets[1].z = height, 1
    return blit


def layout_barrier(image: raw.CData, old: int, new: int) -> raw.CData:
    """An image of the window from one layout to another, after everything before and before everything after."""
    return barriers.layout_barrier(image, _WHOLE, old, new)
