"""A graphics pipeline that draws one triangle over a row of pixels: what a fragment shader needs to run."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.shaders.spirv import Module

_FORMAT = raw.VK_FORMAT_R32_UINT


class Raster:
    """A pipeline with dynamic rendering and its one-row R32_UINT picture `image`. A context manager."""

    def __init__(self, device: Device, vertex: Module, fragment: Module, interface: Interface, width: int) -> None:
        self._device = device
        self._interface = interface
        self._width = width
        self._open = ExitStack()
        usage = raw.VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT
        self.image = device.image(width, 1, _FORMAT, "conformance row", usage=usage)
        self._open.callback(self.image.destroy)
        with ExitStack() as modules:
            stages = [
                self._stage(modules, module, stage)
                for module, stage in (
                    (vertex, raw.VK_SHADER_STAGE_VERTEX_BIT),
                    (fragment, raw.VK_SHADER_STAGE_FRAGMENT_BIT),
                )
            ]
            self._pipeline = self._make(stages)

    def _stage(self, stack: ExitStack, module: Module, stage: int) -> raw.CData:
        device = self._device
        code = np.frombuffer(module.spirv, np.uint32)
        info = raw.struct("VkShaderModuleCreateInfo", codeSize=code.nbytes, pCode=code)
        shader = device.create("VkShaderModule", info, module.name)
        stack.callback(lambda: device.vk.vkDestroyShaderModule(device.handle, shader, raw.NULL))
        return raw.struct("VkPipelineShaderStageCreateInfo", stage=stage, module=shader, pName="main")

    def _make(self, stages: list[raw.CData]) -> raw.CData:
        device = self._device
        extent = {"width": self._width, "height": 1}
        mask = raw.VK_COLOR_COMPONENT_R_BIT
        blend = raw.struct("VkPipelineColorBlendAttachmentState", colorWriteMask=mask)
        create = raw.struct(
            "VkGraphicsPipelineCreateInfo",
            pNext=raw.struct(
                "VkPipelineRenderingCreateInfo", colorAttachmentCount=1, pColorAttachmentFormats=[_FORMAT]
            ),
            stageCount=len(stages),
            pStages=stages,
            pVertexInputState=raw.struct("VkPipelineVertexInputStateCreateInfo"),
            pInputAssemblyState=raw.struct(
                "VkPipelineInputAssemblyStateCreateInfo", topology=raw.VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST
            ),
            pViewportState=raw.struct(
                "VkPipelineViewportStateCreateInfo",
                viewportCount=1,
                pViewports=[{"width": self._width, "height": 1, "maxDepth": 1}],
                scissorCount=1,
                pScissors=[{"extent": extent}],
            ),
            pRasterizationState=raw.struct("VkPipelineRasterizationStateCreateInfo", lineWidth=1),
            pMultisampleState=raw.struct("VkPipelineMultisampleStateCreateInfo", rasterizationSamples=1),
            pColorBlendState=raw.struct(
                "VkPipelineColorBlendStateCreateInfo", attachmentCount=1, pAttachments=blend
            ),
            layout=self._interface.pipeline_layout,
        )
        out = raw.ffi.new("VkPipeline*")
        device.vk.vkCreateGraphicsPipelines(device.handle, raw.NULL, 1, create, raw.NULL, out)
        token = device.own(lambda: device.vk.vkDestroyPipeline(device.handle, out[0], raw.NULL))
        self._open.callback(lambda: device.release(token))
        return out[0]

    def record(self, cmd: raw.CData, sets: Any) -> None:
        """Draw the row with these descriptor sets; everything after sees what was written."""
        vk, point = self._device.vk, raw.VK_PIPELINE_BIND_POINT_GRAPHICS
        attachment = raw.struct(
            "VkRenderingAttachmentInfo",
            imageView=self.image.view,
            imageLayout=self.image.layout,
            loadOp=raw.VK_ATTACHMENT_LOAD_OP_CLEAR,
            storeOp=raw.VK_ATTACHMENT_STORE_OP_STORE,
        )
        rendering = raw.struct(
            "VkRenderingInfo",
            renderArea={"extent": {"width": self._width, "height": 1}},
            layerCount=1,
            colorAttachmentCount=1,
            pColorAttachments=attachment,
        )
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBeginRendering(cmd, rendering)
        vk.vkCmdBindPipeline(cmd, point, self._pipeline)
        layout = self._interface.pipeline_layout
        vk.vkCmdBindDescriptorSets(cmd, point, layout, 0, len(sets.handles), sets.handles, 0, raw.NULL)
        vk.vkCmdDraw(cmd, 3, 1, 0, 0)
        vk.vkCmdEndRendering(cmd)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    def __enter__(self) -> Raster:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()
