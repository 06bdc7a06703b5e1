"""Images: 2D textures and render targets with their views, uploaded and read back as arrays."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.allocator import Allocation
from solari_vk.gpu.device.barriers import layout_barrier
from solari_vk.gpu.device.uploads import StagingPool, Uploads

_COPIES = raw.VK_IMAGE_USAGE_TRANSFER_SRC_BIT | raw.VK_IMAGE_USAGE_TRANSFER_DST_BIT
# Images that shaders or attachments write stay in one layout, so that frames need memory barriers only.
_WRITTEN = (
    raw.VK_IMAGE_USAGE_STORAGE_BIT
    | raw.VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT
    | raw.VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT
)


class Image:
    """A 2D image with its view. Its `layout` is GENERAL if shaders or attachments write it, else
    SHADER_READ_ONLY_OPTIMAL. Its contents are undefined until written. Raises DeviceError if the device can't make it.
    """

    def __init__(
        self,
        staging: StagingPool,
        width: int,
        height: int,
        format: int,
        name: str,
        *,
        usage: int = raw.VK_IMAGE_USAGE_SAMPLED_BIT,
        mip_levels: int = 1,
    ) -> None:
        self.device = device = staging.device
        memory = staging.memory
        self._staging = staging
        self.width = int(width)
        self.height = int(height)
        self.mip_levels = int(mip_levels)
        self.format = format
        self.name = name
        self.usage = usage | _COPIES
        self.layout: int = (
            raw.VK_IMAGE_LAYOUT_GENERAL if usage & _WRITTEN else raw.VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL
        )
        self.dtype, self.channels = texel_layout(format)
        depth = format_name(format).startswith("VK_FORMAT_D")
        self.aspect: int = raw.VK_IMAGE_ASPECT_DEPTH_BIT if depth else raw.VK_IMAGE_ASPECT_COLOR_BIT
        self.all_levels = self._levels(0, self.mip_levels)
        self._check_limits()
        create = raw.struct(
            "VkImageCreateInfo",
            imageType=raw.VK_IMAGE_TYPE_2D,
            format=format,
            extent={"width": self.width, "height": self.height, "depth": 1},
            mipLevels=self.mip_levels,
            arrayLayers=1,
            samples=raw.VK_SAMPLE_COUNT_1_BIT,
            tiling=raw.VK_IMAGE_TILING_OPTIMAL,
            usage=self.usage,
        )
        self.handle = handle = device.create("VkImage", create, name)
        requirements = raw.ffi.new("VkMemoryRequirements*")
        device.vk.vkGetImageMemoryRequirements(device.handle, handle, requirements)
        allocation: Allocation | None = None
        # Views are made when they are first asked for, and destroyed with the image.
        self._views: dict[tuple[int, int], raw.CData] = {}
        views = self._views

        def destroy() -> None:
            for view in views.values():
                device.vk.vkDestroyImageView(device.handle, view, raw.NULL)
            device.vk.vkDestroyImage(device.handle, handle, raw.NULL)
            if allocation is not None:
                memory.free(allocation)

        with device.undone_on_error():
            self._token = device.register(destroy)
            allocation = memory.allocate(requirements, f"image {name}", host=False, image=True)
            device.vk.vkBindImageMemory(device.handle, handle, allocation.memory, allocation.offset)
            self.view = self.level_view(0, self.mip_levels)
        # A new image is in UNDEFINED layout, from which descriptors can't use it.
        device.before_next_submit(self._enter_layout)

    def __repr__(self) -> str:
        return f"<Image {self.name}: {self.width} x {self.height} {format_name(self.format)[10:]}>"

    @property
    def size(self) -> int:
        """The bytes of the texels of all mip levels."""
        return sum(math.prod(self.level_shape(level)) for level in range(self.mip_levels)) * self.dtype.itemsize

    def _levels(self, first: int, count: int) -> dict[str, int]:
        return {"aspectMask": self.aspect, "baseMipLevel": first, "levelCount": count, "layerCount": 1}

    def _check_limits(self) -> None:
        what = f"image {self.name} of {self.width} x {self.height} in {format_name(self.format)}"
        out = raw.ffi.new("VkImageFormatProperties*")
        try:
            # Limits depend on format, tiling and usage together; an error means that the combination is unsupported.
            self.device.instance_vk.vkGetPhysicalDeviceImageFormatProperties(
                self.device.physical_device,
                self.format,
                raw.VK_IMAGE_TYPE_2D,
                raw.VK_IMAGE_TILING_OPTIMAL,
                self.usage,
                0,
                out,
            )
        except DeviceError as error:
            raise DeviceError(f"{what}: the device doesn't support this format with this usage ({error})") from error
        extent = out.maxExtent
        if not (0 < self.width <= extent.width and 0 < self.height <= extent.height):
            raise DeviceError(f"{what}: this device supports sizes from 1 x 1 to {extent.width} x {extent.height}")
        if not 0 < self.mip_levels <= min(max(self.width, self.height).bit_length(), out.maxMipLevels):
            raise DeviceError(f"{what}: it can't have {self.mip_levels} mip levels")

    def _enter_layout(self, cmd: raw.CData) -> None:
        if self.handle is not None:
            self.device.vk.vkCmdPipelineBarrier2(cmd, self.layout_change(raw.VK_IMAGE_LAYOUT_UNDEFINED, self.layout))

    def layout_change(self, old: int, new: int) -> raw.CData:
        """A transition of all mip levels from one layout to another, with the ordering of a full barrier."""
        return layout_barrier(self.handle, self.all_levels, old, new)

    def level_view(self, first: int, count: int = 1) -> raw.CData:
        """A VkImageView of `count` mip levels from `first` on; it lives as long as the image."""
        if (first, count) not in self._views:
            create = raw.struct(
                "VkImageViewCreateInfo",
                image=self.handle,
                viewType=raw.VK_IMAGE_VIEW_TYPE_2D,
                format=self.format,
                subresourceRange=self._levels(first, count),
            )
            self._views[first, count] = self.device.create("VkImageView", create, self.name)
        return self._views[first, count]

    def level_shape(self, level: int) -> tuple[int, int, int]:
        """(height, width, channels) of a mip level."""
        return max(self.height >> level, 1), max(self.width >> level, 1), self.channels

    def check_levels(self, levels: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The levels as arrays; raises SolariError unless they have this image's level count, dtype and shapes."""
        if self.handle is None:
            raise SolariError(f"upload of image {self.name}, which was destroyed")
        if len(levels) != self.mip_levels:
            raise SolariError(f"image {self.name} has {self.mip_levels} mip levels, not {len(levels)}")
        arrays = [np.asarray(level) for level in levels]
        for i, array in enumerate(arrays):
            shape = self.level_shape(i)
            if array.dtype != self.dtype or array.size != int(np.prod(shape)) or array.shape[:2] != shape[:2]:
                raise SolariError(
                    f"image {self.name}, level {i}: {array.shape} of {array.dtype}, expected {shape} of {self.dtype}"
                )
        return arrays

    def copy_region(self, level: int, buffer_offset: int) -> dict[str, Any]:
        """The VkBufferImageCopy of one whole level."""
        height, width, _ = self.level_shape(level)
        return {
            "bufferOffset": buffer_offset,
            "imageSubresource": {"aspectMask": self.aspect, "mipLevel": level, "layerCount": 1},
            "imageExtent": {"width": width, "height": height, "depth": 1},
        }

    def upload(self, levels: Sequence[np.ndarray]) -> None:
        """Replace all mip levels; ordered after all work submitted so far and before all later work."""
        with Uploads(self._staging) as uploads:
            uploads.image(self, levels)

    def read(self, level: int = 0) -> np.ndarray:
        """A mip level as (height, width, channels) of the format's dtype; waits for all work submitted so far."""
        if self.handle is None:
            raise SolariError(f"read of image {self.name}, which was destroyed")
        shape = self.level_shape(level)
        size = int(np.prod(shape)) * self.dtype.itemsize
        read = self._staging.read_back(size, lambda cmd, target: self.record_copy(cmd, target, level))
        return read.view(self.dtype).reshape(shape)

    def record_copy(self, cmd: raw.CData, target: raw.CData, level: int = 0, *, begin: int = 0) -> None:
        """Record a copy of a mip level to a VkBuffer, packed row by row, from its byte `begin` on."""
        vk = self.device.vk
        general = self.layout == raw.VK_IMAGE_LAYOUT_GENERAL
        layout = self.layout if general else raw.VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL
        region = raw.struct("VkBufferImageCopy", **self.copy_region(level, begin))
        if not general:
            vk.vkCmdPipelineBarrier2(cmd, self.layout_change(self.layout, layout))
        vk.vkCmdCopyImageToBuffer(cmd, self.handle, layout, target, 1, region)
        if not general:
            vk.vkCmdPipelineBarrier2(cmd, self.layout_change(layout, self.layout))

    def destroy(self) -> None:
        """Destroy the image when the work submitted so far is done. Safe to call twice."""
        self.handle = None
        self.device.release(self._token)


def format_name(format: int) -> str:
    """The name of a VkFormat."""
    return str(raw.ffi.typeof("enum VkFormat").elements.get(format, f"format {format}"))


def texel_layout(format: int) -> tuple[np.dtype[Any], int]:
    """The numpy dtype and channel count of a format's texel; a packed texel is one uint32.

    Raises SolariError for formats whose texels no dtype can hold, such as block-compressed ones.
    """
    name = format_name(format)
    found = re.fullmatch(r"VK_FORMAT_((?:[RGBADEX]\d+)+)_(UNORM|SNORM|UINT|SINT|SFLOAT|UFLOAT|SRGB)(_PACK32)?", name)
    if not found:
        raise SolariError(f"{name}: its texels can't be seen as numpy arrays")
    if found[3]:
        return np.dtype(np.uint32), 1
    bits = [int(digits) for digits in re.findall(r"\d+", found[1])]
    kind = {"SNORM": "i", "SINT": "i", "SFLOAT": "f"}.get(found[2], "u")
    if len(set(bits)) != 1 or bits[0] not in (8, 16, 32, 64):
        raise SolariError(f"{name}: its texels can't be seen as numpy arrays")
    return np.dtype(f"{kind}{bits[0] // 8}"), len(bits)
