"""Shows pictures in the window: they are copied to an image of the swapchain, and panels are drawn over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import barriers, raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import CommandPool
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.swapchain import FRAMES, Swapchain

_WHOLE = {"aspectMask": raw.VK_IMAGE_ASPECT_COLOR_BIT, "levelCount": 1, "layerCount": 1}
_LAYER = {"aspectMask": raw.VK_IMAGE_ASPECT_COLOR_BIT, "layerCount": 1}
_UNDEFINED, _PRESENT = raw.VK_IMAGE_LAYOUT_UNDEFINED, raw.VK_IMAGE_LAYOUT_PRESENT_SRC_KHR
_TARGET, _SOURCE = raw.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, raw.VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL
_ATTACHMENT = raw.VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL
TRIES = 3  # of `capture`: a window that has just been resized gives no image at first

Draw = Callable[[raw.CData, int], object]
"""draw(commands, index): record commands that draw over the swapchain's image of this index, whose layout is
COLOR_ATTACHMENT_OPTIMAL."""


@dataclass(frozen=True)
class Part:
    """The columns of an image from `begin` to `end`, which are shares of its width. They fill the same share of the
    window. The border of two parts is rounded to a border between texels."""

    image: Image
    begin: float = 0.0
    end: float = 1.0

    def columns(self, width: int, min_count: int = 0) -> tuple[int, int]:
        """The part's columns in an image of this width: the first, and one past the last; at least `min_count`."""
        # A blit from an empty region is invalid, even where it is stretched over a few columns of the target.
        begin, end = min(round(self.begin * width), width - min_count), round(self.end * width)
        return begin, max(end, begin + min_count)


def pixels_of(parts: Sequence[Part]) -> NDArray[np.uint8]:
    """The pixels (height, width, 3) of parts side by side, at the size of the largest image. Raises SolariError without
    parts."""
    if not parts:
        raise SolariError("there is no picture yet")
    width = max(part.image.width for part in parts)
    height = max(part.image.height for part in parts)
    found = []
    for part in parts:
        rows = np.arange(height) * part.image.height // height
        columns = np.arange(*part.columns(width)) * part.image.width // width
        found.append(part.image.read()[rows[:, None], columns, :3])
    return np.concatenate(found, axis=1)


class PictureCopy:
    """A copy of a picture on a device, which stays as it is while its renderer makes the next one. `drop` frees it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._image: Image | None = None

    def store(self, pixels: NDArray[np.uint8]) -> None:
        """Copy these pixels (height, width, 3)."""
        height, width = pixels.shape[:2]
        if self._image is None or (self._image.width, self._image.height) != (width, height):
            self.drop()
            usage = raw.VK_IMAGE_USAGE_STORAGE_BIT  # storage images stay in a layout that copies may read
            self._image = self._device.image(width, height, raw.VK_FORMAT_R8G8B8A8_UNORM, "copied picture", usage=usage)
        opaque = np.full((height, width, 4), 255, np.uint8)
        opaque[..., :3] = pixels
        self._image.upload([opaque])

    @property
    def parts(self) -> list[Part]:
        """What the window shows, an empty list without a picture."""
        return [] if self._image is None else [Part(self._image)]

    def drop(self) -> None:
        """Free the picture. Safe to call twice."""
        if self._image is not None:
            self._image.destroy()
            self._image = None


class Presenter:
    """Shows images of any size in a window, with linear filtering. `close` frees what it made.

    Call it after the work that makes the images was submitted. Images of another device are copied by the host.
    """

    def __init__(self, device: Device, swapchain: Swapchain) -> None:
        self.device = device
        self.swapchain = swapchain
        self.area: Area | None = None
        """Where the parts are in the window, in pixels; None: all of it."""
        self._composed: Image | None = None  # several parts side by side
        self._latest: Sequence[Part] = ()  # that were shown
        self._copy = PictureCopy(device)  # of parts of another device
        self._copied: tuple[Sequence[Part], int] = (), 0  # which parts, and after which work of their device
        self._pool = CommandPool(device, "window")
        self._commands = self._pool.allocate(FRAMES)

    def show(self, parts: Sequence[Part], draw: Draw) -> bool:
        """Show parts that together cover `area`, or black without parts; returns whether a frame was shown."""
        return self._show(self._own(parts), draw, lambda: None)

    def show_again(self, draw: Draw) -> bool:
        """Show what was shown last, with other panels over it; if its device isn't this one, without waiting for it."""
        return self._show(self._latest, draw, lambda: None)

    def _own(self, parts: Sequence[Part]) -> Sequence[Part]:
        """The parts as images of this device."""
        self._latest = parts
        if parts and parts[0].image.device is not self.device:
            other = parts[0].image.device
            # To read a picture takes long, and only work of its device changes it.
            if self._copied != (tuple(parts), other.submitted):
                self._copy.store(pixels_of(parts))
                self._copied = tuple(parts), other.submitted
            self._latest = self._copy.parts
        return self._latest

    def capture(self, parts: Sequence[Part], draw: Draw) -> NDArray[np.uint8] | None:
        """Do what `show` does; returns the window's pixels, (height, width, 3), or None when they can't be read."""
        own = self._own(parts)
        targets: list[Buffer] = []  # one at most, because the first frame that is shown is the last attempt

        # The size of the window's images is known only once one is acquired.
        def new_target() -> Buffer | None:
            if self.swapchain.readable:
                width, height = self.swapchain.extent
                targets.append(self.device.buffer(4 * width * height, "window pixels", host=True))
            return targets[0] if targets else None

        try:
            if not any(self._show(own, draw, new_target) for _ in range(TRIES)) or not targets:
                return None
            width, height = self.swapchain.extent
            pixels = targets[0].read().reshape(height, width, 4)[..., :3].copy()
        finally:
            for target in targets:
                target.destroy()
        if self.swapchain.format == raw.VK_FORMAT_B8G8R8A8_UNORM:
            return pixels[..., ::-1].copy()
        return pixels

    def _show(self, parts: Sequence[Part], draw: Draw, new_target: Callable[[], Buffer | None]) -> bool:
        index = self.swapchain.acquire()
        if index is None:
            return False
        try:
            commands = self._commands[self.swapchain.slot]
            self._record(commands, index, parts, draw, new_target())
            self.swapchain.present(index, [commands])
        except BaseException:
            self.swapchain.stale = True  # its acquired image was never presented: it must be made again
            raise
        return True

    def _record(
        self, commands: raw.CData, index: int, parts: Sequence[Part], draw: Draw, target: Buffer | None
    ) -> None:
        """Record a frame: the parts, what `draw` adds, and a copy of the window's pixels to `target`, if given."""
        vk = self.device.vk
        shown = self.swapchain.images[index]
        width, height = self.swapchain.extent
        vk.vkResetCommandBuffer(commands, 0)  # an error may have interrupted the last recording
        vk.vkBeginCommandBuffer(commands, raw.struct("VkCommandBufferBeginInfo"))
        vk.vkCmdPipelineBarrier2(commands, full_barrier())  # the renderers wrote the parts
        # From "undefined": what the image held is of no use, and it may be a new image.
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(shown, _UNDEFINED, _TARGET))
        # The blit covers the area; the rest is black, where panels are drawn.
        area = self._area_in(width, height)
        if not parts or area != Area(0, 0, width, height):
            black = raw.ffi.new("VkClearColorValue*")
            whole = raw.struct("VkImageSubresourceRange", **_WHOLE)
            vk.vkCmdClearColorImage(commands, shown, _TARGET, black, 1, whole)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
        if parts:
            image = parts[0].image if len(parts) == 1 else self._compose(commands, parts)
            columns, rows = (area.x, area.x + area.width), (area.y, area.y + area.height)
            # A blit and not a copy: it scales, filters, and orders the channels as the window has them.
            blit = _blit((0, image.width), (0, image.height), columns, rows)
            vk.vkCmdBlitImage(commands, image.handle, image.layout, shown, _TARGET, 1, blit, raw.VK_FILTER_LINEAR)
        vk.vkCmdPipelineBarrier2(commands, layout_barrier(shown, _TARGET, _ATTACHMENT))
        draw(commands, index)
        if target is None:
            vk.vkCmdPipelineBarrier2(commands, layout_barrier(shown, _ATTACHMENT, _PRESENT))
        else:
            extent = {"width": width, "height": height, "depth": 1}
            region = raw.struct("VkBufferImageCopy", imageSubresource=_LAYER, imageExtent=extent)
            vk.vkCmdPipelineBarrier2(commands, layout_barrier(shown, _ATTACHMENT, _SOURCE))
            vk.vkCmdCopyImageToBuffer(commands, shown, _SOURCE, target.handle, 1, region)
            vk.vkCmdPipelineBarrier2(commands, layout_barrier(shown, _SOURCE, _PRESENT))
        vk.vkEndCommandBuffer(commands)

    def _area_in(self, width: int, height: int) -> Area:
        """`area`, as far as it is in an image of this size: the window may have been resized since it was assigned."""
        area = self.area or Area(0, 0, width, height)
        left, top = min(area.x, width - 1), min(area.y, height - 1)
        return Area(left, top, min(area.width, width - left), min(area.height, height - top))

    def _compose(self, commands: raw.CData, parts: Sequence[Part]) -> Image:
        """Copy the parts side by side into an image of the largest one's size.

        Stretching each part to the window by itself would shift it, because the target of a blit begins and ends at
        whole pixels of the window.
        """
        width, height = max(part.image.width for part in parts), max(part.image.height for part in parts)
        composed = self._composed
        if composed is None or (composed.width, composed.height) != (width, height):
            self._destroy_composed()
            usage = raw.VK_IMAGE_USAGE_STORAGE_BIT  # storage images stay in a layout that copies may write and read
            composed = self.device.image(width, height, parts[0].image.format, "window parts", usage=usage)
            self._composed = composed
        # A part may be narrower than a column of the target; then its neighbors cover it.
        for part in parts:
            image = part.image
            target = part.columns(width)
            if target[0] < target[1]:
                blit = _blit(part.columns(image.width, min_count=1), (0, image.height), target, (0, height))
                self.device.vk.vkCmdBlitImage(
                    commands,
                    image.handle,
                    image.layout,
                    composed.handle,
                    composed.layout,
                    1,
                    blit,
                    raw.VK_FILTER_LINEAR,
                )
        self.device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
        return composed

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._destroy_composed()
        self._copy.drop()
        self._pool.destroy()

    def _destroy_composed(self) -> None:
        if self._composed is not None:
            self._composed.destroy()
            self._composed = None


def _blit(
    columns: tuple[int, int], rows: tuple[int, int], to_columns: tuple[int, int], to_rows: tuple[int, int]
) -> raw.CData:
    """A VkImageBlit between columns and rows (begin, end) of two images."""
    blit = raw.struct("VkImageBlit", srcSubresource=_LAYER, dstSubresource=_LAYER)
    blit.srcOffsets[0].x, blit.srcOffsets[1].x = columns
    blit.srcOffsets[0].y, blit.srcOffsets[1].y = rows
    blit.dstOffsets[0].x, blit.dstOffsets[1].x = to_columns
    blit.dstOffsets[0].y, blit.dstOffsets[1].y = to_rows
    blit.srcOffsets[1].z = blit.dstOffsets[1].z = 1
    return blit


def layout_barrier(image: raw.CData, old: int, new: int) -> raw.CData:
    """A layout transition of an image of the window, with the ordering of a full barrier."""
    return barriers.layout_barrier(image, _WHOLE, old, new)
