"""The pipeline that draws the panels: blended triangles of one texture, clipped, over an image of the window."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.shaders.compiler import compile_shader

PUSHED_BYTES = 24  # of overlay.vert's Placement
MOST_TEXTURES = 16
_DYNAMIC = [raw.VK_DYNAMIC_STATE_VIEWPORT, raw.VK_DYNAMIC_STATE_SCISSOR]
_SAMPLED = raw.VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER


class OverlayPipeline:
    """`handle` and `layout` of the pipeline for images of a format; descriptor sets for textures. `close` frees all,
    when the work submitted so far is done."""

    def __init__(self, device: Device, format: int) -> None:
        self.device, self.format = device, format
        self.closed = False
        self._sampler = device.sampler(mipmap="none", wrap_u="clamp", wrap_v="clamp")
        with ExitStack() as undo:
            binding = raw.struct(
                "VkDescriptorSetLayoutBinding",
                descriptorType=_SAMPLED,
                descriptorCount=1,
                stageFlags=raw.VK_SHADER_STAGE_FRAGMENT_BIT,
            )
            sets = raw.struct("VkDescriptorSetLayoutCreateInfo", bindingCount=1, pBindings=binding)
            self._set_layout = self._create(undo, "DescriptorSetLayout", sets)
            pushed = raw.struct("VkPushConstantRange", stageFlags=raw.VK_SHADER_STAGE_VERTEX_BIT, size=PUSHED_BYTES)
            layout = raw.struct(
                "VkPipelineLayoutCreateInfo",
                setLayoutCount=1,
                pSetLayouts=[self._set_layout],
                pushConstantRangeCount=1,
                pPushConstantRanges=pushed,
            )
            self.layout = self._create(undo, "PipelineLayout", layout)
            size = raw.struct("VkDescriptorPoolSize", type=_SAMPLED, descriptorCount=MOST_TEXTURES)
            pool = raw.struct(
                "VkDescriptorPoolCreateInfo",
                flags=raw.VK_DESCRIPTOR_POOL_CREATE_FREE_DESCRIPTOR_SET_BIT,
                maxSets=MOST_TEXTURES,
                poolSizeCount=1,
                pPoolSizes=size,
            )
            self._pool = self._create(undo, "DescriptorPool", pool)
            self.handle = self._make_pipeline(undo)
            self._token = device.own(undo.pop_all().close)

    def _create(self, undo: ExitStack, kind: str, info: raw.CData) -> raw.CData:
        device = self.device
        handle = device.create("Vk" + kind, info, "overlay")
        undo.callback(getattr(device.vk, "vkDestroy" + kind), device.handle, handle, raw.NULL)
        return handle

    def _make_pipeline(self, undo: ExitStack) -> raw.CData:
        device = self.device
        with ExitStack() as shaders:
            stages = []
            for suffix, stage in (("vert", raw.VK_SHADER_STAGE_VERTEX_BIT), ("frag", raw.VK_SHADER_STAGE_FRAGMENT_BIT)):
                code = np.frombuffer(compile_shader(f"passes/viewer/overlay.{suffix}"), np.uint32)
                create = raw.struct("VkShaderModuleCreateInfo", codeSize=code.nbytes, pCode=code)
                module = self._create(shaders, "ShaderModule", create)
                stages.append(raw.struct("VkPipelineShaderStageCreateInfo", stage=stage, module=module, pName="main"))
            out = raw.ffi.new("VkPipeline*")
            info = _create_info(stages, self.format, self.layout)
            device.vk.vkCreateGraphicsPipelines(device.handle, raw.NULL, 1, info, raw.NULL, out)
        undo.callback(device.vk.vkDestroyPipeline, device.handle, out[0], raw.NULL)
        device.name_object("pipeline", out[0], "overlay")
        return out[0]

    def new_set(self, image: Image) -> raw.CData:
        """A descriptor set of a texture; give it back with `free_set`."""
        device = self.device
        allocate = raw.struct(
            "VkDescriptorSetAllocateInfo",
            descriptorPool=self._pool,
            descriptorSetCount=1,
            pSetLayouts=[self._set_layout],
        )
        out = raw.ffi.new("VkDescriptorSet*")
        device.vk.vkAllocateDescriptorSets(device.handle, allocate, out)
        info = raw.struct(
            "VkDescriptorImageInfo", sampler=self._sampler.handle, imageView=image.view, imageLayout=image.layout
        )
        write = raw.struct(
            "VkWriteDescriptorSet", dstSet=out[0], descriptorCount=1, descriptorType=_SAMPLED, pImageInfo=info
        )
        device.vk.vkUpdateDescriptorSets(device.handle, 1, write, 0, raw.NULL)
        return out[0]

    def free_set(self, handle: raw.CData) -> None:
        """Give a set back, when the work submitted so far is done."""
        device = self.device
        sets = raw.ffi.new("VkDescriptorSet[]", [handle])

        def free() -> None:
            if not self.closed:
                device.vk.vkFreeDescriptorSets(device.handle, self._pool, 1, sets)

        device.retire(free)

    def close(self) -> None:
        """Free all, the sets too. Safe to call twice."""
        self.closed = True
        self.device.release(self._token)


def _create_info(stages: list[raw.CData], format: int, layout: raw.CData) -> raw.CData:
    """VkGraphicsPipelineCreateInfo: no vertex input, no depth, colours blended by their alpha."""
    blend = raw.struct(
        "VkPipelineColorBlendAttachmentState",
        blendEnable=1,
        srcColorBlendFactor=raw.VK_BLEND_FACTOR_SRC_ALPHA,
        dstColorBlendFactor=raw.VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        srcAlphaBlendFactor=raw.VK_BLEND_FACTOR_ONE,
        dstAlphaBlendFactor=raw.VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        colorWriteMask=raw.VK_COLOR_COMPONENT_R_BIT
        | raw.VK_COLOR_COMPONENT_G_BIT
        | raw.VK_COLOR_COMPONENT_B_BIT
        | raw.VK_COLOR_COMPONENT_A_BIT,
    )
    return raw.struct(
        "VkGraphicsPipelineCreateInfo",
        pNext=raw.struct("VkPipelineRenderingCreateInfo", colorAttachmentCount=1, pColorAttachmentFormats=[format]),
        stageCount=len(stages),
        pStages=stages,
        pVertexInputState=raw.struct("VkPipelineVertexInputStateCreateInfo"),
        pInputAssemblyState=raw.struct(
            "VkPipelineInputAssemblyStateCreateInfo", topology=raw.VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST
        ),
        pViewportState=raw.struct("VkPipelineViewportStateCreateInfo", viewportCount=1, scissorCount=1),
        pRasterizationState=raw.struct("VkPipelineRasterizationStateCreateInfo", lineWidth=1),
        pMultisampleState=raw.struct(
            "VkPipelineMultisampleStateCreateInfo", rasterizationSamples=raw.VK_SAMPLE_COUNT_1_BIT
        ),
        pColorBlendState=raw.struct("VkPipelineColorBlendStateCreateInfo", attachmentCount=1, pAttachments=blend),
        pDynamicState=raw.struct(
            "VkPipelineDynamicStateCreateInfo", dynamicStateCount=len(_DYNAMIC), pDynamicStates=_DYNAMIC
        ),
        layout=layout,
    )
