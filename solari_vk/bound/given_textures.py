"""Texels that tensors give on the device, and the smaller levels of their images."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.bound.given_numbers import GivenNumbers
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.cuda_input import FLOATS, Taken
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.scene.images.mip_chain import CODE_OF_LIGHT, LIGHT_OF_CODE

DTYPES = (np.uint8, *FLOATS)
_LIGHT = 16  # bytes of a texel that levels are averaged of
_TARGET = raw.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL


class GivenTextures(GivenNumbers):
    """Writes texels of tensors to images, with the levels that `mip_chain` makes, bit by bit."""

    def __init__(self, device: Device) -> None:
        super().__init__(device, "", "texel", "lie between 0 and 1")
        self._scratch: Buffer | None = None
        self._curves: Buffer | None = None

    def fits(self, image: Image, given: Taken) -> bool:
        """Whether a tensor of this device has the size of an image."""
        return given.device is self._device and given.shape[:2] == (image.height, image.width)

    def write(self, what: str, image: Image, given: Taken, srgb: bool, *, in_place: bool) -> Image:
        """Have a tensor's texels in an image, or a copy of it, which is returned. what: the image, for messages. Texels
        that are wrong stay."""
        with ExitStack() as undo:
            target = image
            if not in_place:
                target = self._device.image(
                    image.width, image.height, image.format, image.name, mip_levels=image.mip_levels
                )
                undo.callback(target.destroy)
            self._write(what, image, target, given, srgb)
            undo.pop_all()
        return target

    def _write(self, what: str, image: Image, target: Image, given: Taken, srgb: bool) -> None:
        sizes = [image.level_shape(level)[:2] for level in range(image.mip_levels)]
        counts = [height * width for height, width in sizes]
        starts = np.cumsum([0, *(4 * count for count in counts)]).tolist()  # of the levels' codes
        light = -(-starts[-1] // _LIGHT) * _LIGHT
        lights = light + _LIGHT * sum(counts[1:2]), light  # of even levels and of odd ones; the largest has none
        memory = self._memory(lights[0] + _LIGHT * sum(counts[2:3]))
        channels = 1 if len(given.shape) == 2 else given.shape[2]
        texels = {
            **self._source(given, f"{what}: pixels"),
            "is_bytes": given.dtype == np.uint8,
            "words": given.address & ~3,
            "first_byte": given.address & 3,
            "channels": channels,
            "width": image.width,
            "height": image.height,
            "target": memory.address,
        }
        steps: list[tuple[str, tuple[int, int], dict[str, Any]]] = [("texels", (image.width, image.height), texels)]
        curves = self._light_curves().address
        for level in range(1, image.mip_levels):
            (height, width), (rows, columns) = sizes[level - 1 : level + 1]
            averages = {
                "codes": memory.address,
                "target_codes": memory.address + starts[level],
                "source": memory.address + lights[1 - level % 2],
                "target": memory.address + lights[level % 2],
                "light_of_code": curves,
                "code_of_light": curves + LIGHT_OF_CODE.nbytes,
                "width": width,
                "height": height,
                "is_first": level == 1,
                "is_srgb": srgb,
            }
            steps.append(("smaller_level", (columns, rows), averages))
        kernels = {name: self._kernel(name) for name, _, _ in steps}
        vk = self._device.vk

        def record(commands: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            if given.dtype != np.uint8:
                image.record_copy(commands, memory.handle)  # texels that may stay
            for name, threads, pushed in steps:
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
                kernels[name].record(commands, threads, **pushed)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, target.layout_change(raw.VK_IMAGE_LAYOUT_UNDEFINED, _TARGET))
            regions = raw.array("VkBufferImageCopy", [target.copy_region(*level) for level in enumerate(starts[:-1])])
            vk.vkCmdCopyBufferToImage(commands, memory.handle, target.handle, _TARGET, len(sizes), regions)
            vk.vkCmdPipelineBarrier2(commands, target.layout_change(_TARGET, target.layout))
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start(record, f"texels of {image.name}")

    def _memory(self, size: int) -> Buffer:
        """Memory that each call uses anew, which stays for the next one."""
        if self._scratch is None or self._scratch.size < size:
            if self._scratch is not None:
                self._scratch.destroy()
                self._scratch = None
            self._scratch = self._device.buffer(size, "levels of given textures")
        return self._scratch

    def _light_curves(self) -> Buffer:
        """The light of each sRGB code, and back."""
        if self._curves is None:
            curves = LIGHT_OF_CODE.tobytes() + CODE_OF_LIGHT.tobytes()
            with self._device.undone_on_error():
                buffer = self._device.buffer(len(curves), "sRGB curves")
                buffer.upload(curves)
            self._curves = buffer
        return self._curves

    def destroy(self) -> None:
        for owned in (self._scratch, self._curves):
            if owned is not None:
                owned.destroy()
        super().destroy()
