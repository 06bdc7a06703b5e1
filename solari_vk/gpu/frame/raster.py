"""Draws inside a frame: the check of what they need, and their commands, with dynamic rendering."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.stages import Draw

Attachment = tuple[raw.CData, int]
"""A VkImageView and the layout that its image is in."""

# The stride between commands in the indirect buffer: they lie without gaps.
_COMMAND_BYTES = raw.ffi.sizeof("VkDrawIndirectCommand")
# One indirect command for each instance, and shaders of draws that write the G-buffer's storage buffers.
NEEDED = (
    "multiDrawIndirect",
    "drawIndirectFirstInstance",
    "vertexPipelineStoresAndAtomics",
    "fragmentStoresAndAtomics",
)


def check_draw(device: Device, name: str, item: Draw, interface: Interface) -> None:
    """Raise SolariError if the device lacks what a Draw needs, or the Draw doesn't fit the shaders or the limits."""
    missing = [feature for feature in NEEDED if feature not in device.features]
    if missing:
        raise SolariError(f"pass {name}: this device can't draw it, since it lacks {', '.join(missing)}")
    for image in item.colors:
        if interface[image].kind != "storage_image":
            raise SolariError(f"pass {name}: {image} is a {interface[image].kind}, not an image to draw into")
    limit = device.properties.limits.maxDrawIndirectCount
    for draws in item.draws:
        if not 0 < draws.max_count <= limit:
            raise SolariError(
                f"pass {name}: {draws.max_count:,} draws, but this device supports 1 to {limit:,} at once"
            )


@contextmanager
def rendering(
    device: Device,
    cmd: raw.CData,
    size: tuple[int, int],
    colors: Sequence[Attachment],
    depth: Attachment | None = None,
    *,
    clears: bool = True,
) -> Iterator[None]:
    """Dynamic rendering around the draws that are recorded inside the `with` block.

    Viewport and scissor cover the size (width, height) in pixels; faces are not culled. `clears`: the attachments are
    set to zero first.
    """
    vk = device.vk
    extent = {"width": size[0], "height": size[1]}
    load = raw.VK_ATTACHMENT_LOAD_OP_CLEAR if clears else raw.VK_ATTACHMENT_LOAD_OP_LOAD

    def attachment(target: Attachment) -> raw.CData:
        return raw.struct(
            "VkRenderingAttachmentInfo",
            imageView=target[0],
            imageLayout=target[1],
            loadOp=load,
            storeOp=raw.VK_ATTACHMENT_STORE_OP_STORE,
        )

    info = raw.struct(
        "VkRenderingInfo",
        renderArea={"extent": extent},
        layerCount=1,
        colorAttachmentCount=len(colors),
        pColorAttachments=[attachment(target) for target in colors],
        pDepthAttachment=None if depth is None else attachment(depth),
    )
    vk.vkCmdBeginRendering(cmd, info)
    # Viewport, scissor and culling are dynamic state: a pipeline serves all sizes.
    vk.vkCmdSetViewport(cmd, 0, 1, raw.struct("VkViewport", **extent, maxDepth=1))
    vk.vkCmdSetScissor(cmd, 0, 1, raw.struct("VkRect2D", extent=extent))
    vk.vkCmdSetCullMode(cmd, raw.VK_CULL_MODE_NONE)
    yield
    vk.vkCmdEndRendering(cmd)


def record_draw(device: Device, cmd: raw.CData, item: Draw, bound: Mapping[str, Any]) -> None:
    """Record a Draw. Its pipeline and descriptor sets must be bound, and barriers recorded."""
    vk = device.vk
    images = [bound[name] for name in (*item.colors, item.depth)]
    for name, image in zip(item.colors, images, strict=False):
        if (image.width, image.height) != (images[-1].width, images[-1].height):
            raise SolariError(f"pass {item.name}: {name} and {item.depth} differ in size")
    # All images stay in one layout (GENERAL), so drawing needs no transition.
    *colors, depth = [(image.view, image.layout) for image in images]
    with rendering(device, cmd, (images[-1].width, images[-1].height), colors, depth, clears=item.clears):
        for draws in item.draws:
            vk.vkCmdSetCullMode(cmd, raw.VK_CULL_MODE_BACK_BIT if draws.culls_backs else raw.VK_CULL_MODE_NONE)
            commands, count = bound[draws.commands].handle, bound[draws.count].handle
            # Without the feature all max_count commands run; those behind the count must draw nothing.
            if "drawIndirectCount" in device.features:
                vk.vkCmdDrawIndirectCount(cmd, commands, 0, count, draws.count_offset, draws.max_count, _COMMAND_BYTES)
            else:
                vk.vkCmdDrawIndirect(cmd, commands, 0, draws.max_count, _COMMAND_BYTES)
