"""Texels that stay on the device as tensors, and the smaller levels of their images."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.tensors.imports import FLOATS, DeviceTensor
from solari_vk.gpu.tensors.port import Dispatch, TensorPort, rule
from solari_vk.scene.images.mip_chain import CODE_OF_LIGHT, LIGHT_OF_CODE

DTYPES = (np.uint8, *FLOATS)
_LIGHT = 16  # bytes of a texel that levels are averaged of: a vec4
_TARGET = raw.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL


class TextureTensors:
    """Writes texels in tensors to images, with the levels that `mip_chain` makes, bit by bit."""

    def __init__(self, device: Device, port: TensorPort) -> None:
        self._device = device
        self._port = port
        self._scratch: Buffer | None = None
        self._curves: Buffer | None = None

    def write(self, what: str, image: Image, tensor: DeviceTensor, srgb: bool, *, in_place: bool) -> Image:
        """Have a tensor's texels in an image, or a copy of it, which is returned. what: the image, for messages. Texels
        that are wrong stay."""
        with ExitStack() as undo:
            target = image
            if not in_place:
                target = self._device.image(
                    image.width, image.height, image.format, image.name, mip_levels=image.mip_levels
                )
                undo.callback(target.destroy)
            self._write(what, image, target, tensor, srgb)
            undo.pop_all()
        return target

    def _write(self, what: str, image: Image, target: Image, tensor: DeviceTensor, srgb: bool) -> None:
        # Scratch memory holds the codes of all levels, then the light of the latest even level and of the latest odd
        # one: each level is averaged of the light before it was rounded to codes, as `mip_chain` does.
        sizes = [image.level_shape(level)[:2] for level in range(image.mip_levels)]
        counts = [height * width for height, width in sizes]
        starts = np.cumsum([0, *(4 * count for count in counts)]).tolist()  # of the levels' codes
        odd_levels = -(-starts[-1] // _LIGHT) * _LIGHT
        even_levels = odd_levels + _LIGHT * sum(counts[1:2])
        memory = self._scratch_of(even_levels + _LIGHT * sum(counts[2:3]))
        dispatches = [self._texels(what, image, tensor, memory.address)]
        level_memory = even_levels, odd_levels
        curves = self._light_curves().address
        for level in range(1, image.mip_levels):
            height, width = sizes[level - 1]
            rows, columns = sizes[level]
            averages = {
                "codes": memory.address,
                "target_codes": memory.address + starts[level],
                "source": memory.address + level_memory[1 - level % 2],
                "target": memory.address + level_memory[level % 2],
                "light_of_code": curves,
                "code_of_light": curves + LIGHT_OF_CODE.nbytes,
                "width": width,
                "height": height,
                "is_first": level == 1,
                "is_srgb": srgb,
            }
            dispatches.append(Dispatch("smaller_level", (columns, rows), averages))
        vk = self._device.vk

        def read_texels(commands: raw.CData) -> None:
            image.record_copy(commands, memory.handle)

        def copy_levels(commands: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(commands, target.layout_change(raw.VK_IMAGE_LAYOUT_UNDEFINED, _TARGET))
            regions = raw.array("VkBufferImageCopy", [target.copy_region(*level) for level in enumerate(starts[:-1])])
            vk.vkCmdCopyBufferToImage(commands, memory.handle, target.handle, _TARGET, len(sizes), regions)
            vk.vkCmdPipelineBarrier2(commands, target.layout_change(_TARGET, target.layout))

        # Bytes are always right; of floats, the image keeps the texels that the shader refuses.
        before = read_texels if tensor.dtype != np.uint8 else None
        self._port.write(dispatches, f"texels of {image.name}", before=before, after=copy_levels)

    def _texels(self, what: str, image: Image, tensor: DeviceTensor, target: int) -> Dispatch:
        field = f"{what}: pixels"
        pushed = {
            **self._port.source(tensor),
            **self._port.refusal(field, rule(field, "texel", "lie between 0 and 1")),
            "is_bytes": tensor.dtype == np.uint8,
            # Bytes are read by words, the first of which may begin before the tensor.
            "words": tensor.address & ~3,
            "first_byte": tensor.address & 3,
            "channels": 1 if len(tensor.shape) == 2 else tensor.shape[2],
            "width": image.width,
            "height": image.height,
            "target": target,
        }
        return Dispatch("texels", (image.width, image.height), pushed)

    def _scratch_of(self, size: int) -> Buffer:
        """Memory that each call uses anew, which stays for the next one."""
        if self._scratch is None or self._scratch.size < size:
            if self._scratch is not None:
                self._scratch.destroy()
                self._scratch = None
            self._scratch = self._device.buffer(size, "mip levels of images from tensors")
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
