"""Drawing inside a frame: the pipeline of a Draw and its commands, with dynamic rendering and no vertex input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from solari_vk.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.resources import DEPTH_FORMAT
from solari_vk.gpu.frame.stages import Draw

_DYNAMIC = [raw.VK_DYNAMIC_STATE_VIEWPORT, raw.VK_DYNAMIC_STATE_SCISSOR, raw.VK_DYNAMIC_STATE_CULL_MODE]
_COMMAND_BYTES = raw.ffi.sizeof("VkDrawIndirectCommand")
_NEEDED = (
    "multiDrawIndirect",
    "drawIndirectFirstInstance",
    "vertexPipelineStoresAndAtomics",
    "fragmentStoresAndAtomics",
)


def check_draw(device: Device, name: str, item: Draw, interface: Interface) -> None:
    """Raise SolariError for what the device or the shaders can't draw."""
    missing = [feature for feature in _NEEDED if feature not in device.features]
    if missing:
        raise SolariError(f"pass {name}: this device can't draw as many meshes at once: it misses {', '.join(missing)}")
    for image in item.colors:
        if interface[image].kind != "storage_image":
            raise SolariError(f"pass {name}: {image} is a {interface[image].kind}, not an image to draw into")
    most = device.properties.limits.maxDrawIndirectCount
    for draws in item.draws:
        if not 0 < draws.most <= most:
            raise SolariError(f"pass {name}: {draws.most:,} draws, but this device does 1 to {most:,} at once")


def graphics_create_info(stages: list[raw.CData], formats: Sequence[str], layout: raw.CData) -> raw.CData:
    """VkGraphicsPipelineCreateInfo: counter-clockwise triangles are fronts, and what has more depth is nearer."""
    mask = (
        raw.VK_COLOR_COMPONENT_R_BIT | raw.VK_COLOR_COMPONENT_G_BIT | raw.VK_COLOR_COMPONENT_B_BIT
        | raw.VK_COLOR_COMPONENT_A_BIT
    )  # fmt: skip
    return raw.struct(
        "VkGraphicsPipelineCreateInfo",
        pNext=raw.struct(
            "VkPipelineRenderingCreateInfo",
            colorAttachmentCount=len(formats),
            pColorAttachmentFormats=[getattr(raw, "VK_FORMAT_" + name) for name in formats],
            depthAttachmentFormat=getattr(raw, "VK_FORMAT_" + DEPTH_FORMAT),
        ),
        stageCount=len(stages),
        pStages=stages,
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
            depthTestEnable=1,
            depthWriteEnable=1,
            depthCompareOp=raw.VK_COMPARE_OP_GREATER,
        ),
        pColorBlendState=raw.struct(
            "VkPipelineColorBlendStateCreateInfo",
            attachmentCount=len(formats),
            pAttachments=[raw.struct("VkPipelineColorBlendAttachmentState", colorWriteMask=mask) for _ in formats],
        ),
        pDynamicState=raw.struct(
            "VkPipelineDynamicStateCreateInfo", dynamicStateCount=len(_DYNAMIC), pDynamicStates=_DYNAMIC
        ),
        layout=layout,
    )


def record_draw(device: Device, cmd: raw.CData, item: Draw, bound: Mapping[str, Any]) -> None:
    """Record a Draw; its pipeline and the descriptor sets are bound, and what it reads and writes is ready."""
    vk = device.vk
    depth = bound[item.depth]
    for name in item.colors:
        if (bound[name].width, bound[name].height) != (depth.width, depth.height):
            raise SolariError(f"pass {item.name}: {name} and {item.depth} differ in size")
    extent = {"width": depth.width, "height": depth.height}
    rendering = raw.struct(
        "VkRenderingInfo",
        renderArea={"extent": extent},
        layerCount=1,
        colorAttachmentCount=len(item.colors),
        pColorAttachments=[_attachment(bound[name], item.clears) for name in item.colors],
        pDepthAttachment=_attachment(depth, item.clears),
    )
    vk.vkCmdBeginRendering(cmd, rendering)
    vk.vkCmdSetViewport(cmd, 0, 1, raw.struct("VkViewport", **extent, maxDepth=1))
    vk.vkCmdSetScissor(cmd, 0, 1, raw.struct("VkRect2D", extent=extent))
    for draws in item.draws:
        vk.vkCmdSetCullMode(cmd, raw.VK_CULL_MODE_BACK_BIT if draws.culls_backs else raw.VK_CULL_MODE_NONE)
        commands, count = bound[draws.commands].handle, bound[draws.count].handle
        if "drawIndirectCount" in device.features:
            vk.vkCmdDrawIndirectCount(cmd, commands, 0, count, draws.count_offset, draws.most, _COMMAND_BYTES)
        else:
            vk.vkCmdDrawIndirect(cmd, commands, 0, draws.most, _COMMAND_BYTES)
    vk.vkCmdEndRendering(cmd)


def _attachment(image: Any, clears: bool) -> raw.CData:
    return raw.struct(
        "VkRenderingAttachmentInfo",
        imageView=image.view,
        imageLayout=image.layout,
        loadOp=raw.VK_ATTACHMENT_LOAD_OP_CLEAR if clears else raw.VK_ATTACHMENT_LOAD_OP_LOAD,
        storeOp=raw.VK_ATTACHMENT_STORE_OP_STORE,
    )
