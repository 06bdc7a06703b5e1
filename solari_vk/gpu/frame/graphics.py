"""The one builder of graphics pipelines: triangles without vertex input, for dynamic rendering."""

from __future__ import annotations

from dataclasses import dataclass

from solari_vk.gpu.device import raw

_DYNAMIC = [raw.VK_DYNAMIC_STATE_VIEWPORT, raw.VK_DYNAMIC_STATE_SCISSOR, raw.VK_DYNAMIC_STATE_CULL_MODE]
_ALL_CHANNELS = (
    raw.VK_COLOR_COMPONENT_R_BIT
    | raw.VK_COLOR_COMPONENT_G_BIT
    | raw.VK_COLOR_COMPONENT_B_BIT
    | raw.VK_COLOR_COMPONENT_A_BIT
)


@dataclass(frozen=True)
class Targets:
    """What a graphics pipeline draws into: VkFormats of its color images and of its depth image (0: no depth test).

    blends: mix each color with what its image holds, by the color's alpha.
    """

    colors: tuple[int, ...]
    depth: int = 0
    blends: bool = False


def graphics_create_info(stages: list[raw.CData], targets: Targets, layout: raw.CData) -> raw.CData:
    """VkGraphicsPipelineCreateInfo. Counter-clockwise triangles are front faces; larger depths are nearer."""
    # The color over what is there, by its alpha; the alpha channel keeps the coverage of both.
    blend = raw.struct(
        "VkPipelineColorBlendAttachmentState",
        blendEnable=int(targets.blends),
        srcColorBlendFactor=raw.VK_BLEND_FACTOR_SRC_ALPHA,
        dstColorBlendFactor=raw.VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        srcAlphaBlendFactor=raw.VK_BLEND_FACTOR_ONE,
        dstAlphaBlendFactor=raw.VK_BLEND_FACTOR_ONE_MINUS_SRC_ALPHA,
        colorWriteMask=_ALL_CHANNELS,
    )
    count = len(targets.colors)
    return raw.struct(
        "VkGraphicsPipelineCreateInfo",
        # Dynamic rendering: the formats of the attachments, in place of a render pass.
        pNext=raw.struct(
            "VkPipelineRenderingCreateInfo",
            colorAttachmentCount=count,
            pColorAttachmentFormats=targets.colors,
            depthAttachmentFormat=targets.depth,
        ),
        stageCount=len(stages),
        pStages=stages,
        # No vertex attributes: shaders read vertices from buffers by gl_VertexIndex.
        pVertexInputState=raw.struct("VkPipelineVertexInputStateCreateInfo"),
        pInputAssemblyState=raw.struct(
            "VkPipelineInputAssemblyStateCreateInfo", topology=raw.VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST
        ),
        pViewportState=raw.struct("VkPipelineViewportStateCreateInfo", viewportCount=1, scissorCount=1),
        pRasterizationState=raw.struct(
            "VkPipelineRasterizationStateCreateInfo", frontFace=raw.VK_FRONT_FACE_COUNTER_CLOCKWISE, lineWidth=1
        ),
        pMultisampleState=raw.struct(
            "VkPipelineMultisampleStateCreateInfo", rasterizationSamples=raw.VK_SAMPLE_COUNT_1_BIT
        ),
        pDepthStencilState=raw.struct(
            "VkPipelineDepthStencilStateCreateInfo",
            depthTestEnable=int(targets.depth != 0),
            depthWriteEnable=int(targets.depth != 0),
            # Reversed depth, whose floats are spread evenly over distances.
            depthCompareOp=raw.VK_COMPARE_OP_GREATER,
        ),
        pColorBlendState=raw.struct(
            "VkPipelineColorBlendStateCreateInfo", attachmentCount=count, pAttachments=[blend] * count
        ),
        pDynamicState=raw.struct(
            "VkPipelineDynamicStateCreateInfo", dynamicStateCount=len(_DYNAMIC), pDynamicStates=_DYNAMIC
        ),
        layout=layout,
    )
