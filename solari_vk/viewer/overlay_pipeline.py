"""The pipeline that draws the panels: blended, clipped triangles of one texture each over an image of the window."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.graphics import Targets
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import Pipelines
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect

_GRAPHICS = raw.VK_PIPELINE_BIND_POINT_GRAPHICS


class OverlayPipeline:
    """The pipeline for images of a VkFormat. `close` frees it when the work submitted so far is done."""

    def __init__(self, device: Device, format: int) -> None:
        self.format = format
        self._device = device
        self._sampler = device.sampler(mipmap="none", wrap_u="clamp", wrap_v="clamp")
        paths = [f"passes/viewer/overlay.{suffix}" for suffix in ("vert", "frag")]
        modules = [reflect(compile_shader(path), path) for path in paths]
        self._placement = modules[0].push_constants
        self._interface = Interface(device, modules)
        self._pipelines = Pipelines(device)
        targets = Targets((format,), blends=True)
        try:
            _, self._handle = self._pipelines.graphics("overlay", modules, {}, self._interface, targets)
        except BaseException:
            self.close()
            raise

    def bind(self, commands: raw.CData, **placement: Any) -> None:
        """Record the pipeline's binding, and the values of overlay.vert's push constants."""
        vk = self._device.vk
        pushed = np.zeros(1, self._placement)
        for field, value in placement.items():
            pushed[field] = value
        vk.vkCmdBindPipeline(commands, _GRAPHICS, self._handle)
        layout, data = self._interface.pipeline_layout, raw.ffi.from_buffer(pushed)
        vk.vkCmdPushConstants(commands, layout, raw.VK_SHADER_STAGE_ALL, 0, pushed.nbytes, data)

    def new_set(self, image: Image) -> DescriptorSets:
        """Descriptor sets for a texture: `bind(commands, graphics bind point)` them, and `destroy` them."""
        sets = DescriptorSets(self._interface, [0, 0])
        sets.write({"image": (image, self._sampler)})
        return sets

    def close(self) -> None:
        """Free the pipeline. Safe to call twice."""
        self._pipelines.destroy()
        self._interface.destroy()
