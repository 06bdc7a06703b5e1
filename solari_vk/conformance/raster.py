"""A graphics pipeline that draws one triangle over a row of pixels: what a fragment shader needs to run."""

from __future__ import annotations

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.graphics import Targets
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import Pipelines
from solari_vk.gpu.frame.raster import rendering
from solari_vk.gpu.shaders.spirv import Module

_FORMAT = raw.VK_FORMAT_R32_UINT


class Raster:
    """A pipeline with dynamic rendering and its one-row R32_UINT picture `image`. A context manager."""

    def __init__(self, device: Device, vertex: Module, fragment: Module, interface: Interface, width: int) -> None:
        self._device = device
        usage = raw.VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT
        self.image = device.image(width, 1, _FORMAT, "conformance row", usage=usage)
        self._pipelines = Pipelines(device)
        targets = Targets((_FORMAT,))
        _, self._pipeline = self._pipelines.graphics("conformance", (vertex, fragment), {}, interface, targets)

    def record(self, cmd: raw.CData, sets: DescriptorSets) -> None:
        """Draw the row with these descriptor sets; everything after sees what was written."""
        vk, point, image = self._device.vk, raw.VK_PIPELINE_BIND_POINT_GRAPHICS, self.image
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        with rendering(self._device, cmd, (image.width, 1), [(image.view, image.layout)]):
            vk.vkCmdBindPipeline(cmd, point, self._pipeline)
            sets.bind(cmd, point)
            vk.vkCmdDraw(cmd, 3, 1, 0, 0)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    def __enter__(self) -> Raster:
        return self

    def __exit__(self, *_: object) -> None:
        self._pipelines.destroy()
        self.image.destroy()
