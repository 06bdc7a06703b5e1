"""Draws what Dear ImGui laid out over the images of the window, with Vulkan."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from imgui_bundle import imgui

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.command_pool import CommandPool
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.device.swapchain import FRAMES, Swapchain
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.raster import rendering
from solari_vk.viewer.overlay_pipeline import OverlayPipeline
from solari_vk.viewer.presenter import layout_barrier

_ATTACHED = raw.VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL
_PRESENT = raw.VK_IMAGE_LAYOUT_PRESENT_SRC_KHR
_VERTEX_BYTES, _INDEX_BYTES = imgui.VERTEX_SIZE, imgui.INDEX_SIZE
_INDEX_TYPE = raw.VK_INDEX_TYPE_UINT32 if _INDEX_BYTES == 4 else raw.VK_INDEX_TYPE_UINT16


class _Frame:
    """One of the frames that may be under way: its commands, vertices and indices."""

    def __init__(self, commands: raw.CData) -> None:
        self.commands = commands
        self.value = 0  # of the timeline, when it is done
        self.buffers: dict[str, Buffer] = {}

    def room(self, device: Device, name: str, size: int) -> Buffer:
        """A mapped buffer of at least `size` bytes."""
        if name not in self.buffers or self.buffers[name].size < size:
            if name in self.buffers:
                self.buffers[name].destroy()
            self.buffers[name] = device.buffer(max(2 * size, 1 << 16), f"overlay {name}", host=True)
        return self.buffers[name]


class OverlayRenderer:
    """Textures and pipelines of the current ImGui context. `close` it before the context."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._pipeline: OverlayPipeline | None = None
        self._broken = False  # no pipeline could be made, and another try would take as long
        self._textures: dict[int, tuple[Image, DescriptorSets]] = {}
        self._pool = CommandPool(device, "overlay")
        self._frames = [_Frame(commands) for commands in self._pool.allocate(FRAMES)]
        self._frame = 0
        io = imgui.get_io()
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures | imgui.BackendFlags_.renderer_has_vtx_offset

    def draw(self, data: Any, swapchain: Swapchain, index: int) -> raw.CData:
        """Commands that draw `data` over an image of the window, which is and stays in PRESENT_SRC.

        Raises CompilationError when a shader can't be compiled; then there are none, None, until a `reload`.
        """
        device, vk = self.device, self.device.vk
        if not self._use_format(swapchain.format):
            return None
        self._update_textures(data)
        self._frames[self._frame].value = device.submitted  # the frame that was drawn before is among these
        self._frame = (self._frame + 1) % FRAMES
        frame = self._frames[self._frame]
        device.await_value(frame.value)
        vk.vkBeginCommandBuffer(frame.commands, raw.struct("VkCommandBufferBeginInfo"))
        vk.vkCmdPipelineBarrier2(frame.commands, layout_barrier(swapchain.images[index], _PRESENT, _ATTACHED))
        target = (swapchain.views[index], _ATTACHED)
        with rendering(device, frame.commands, swapchain.extent, [target], clears=False):
            if data.total_vtx_count:
                self._record(frame, data, swapchain.extent)
        vk.vkCmdPipelineBarrier2(frame.commands, layout_barrier(swapchain.images[index], _ATTACHED, _PRESENT))
        vk.vkEndCommandBuffer(frame.commands)
        return frame.commands

    def _use_format(self, format: int) -> bool:
        """Another pipeline where another surface has another format; whether there is one."""
        if self._pipeline is not None and self._pipeline.format == format:
            return True
        if not self._broken:
            self._broken = True
            self._make_pipeline(format)
            self._broken = False
        return not self._broken

    def _make_pipeline(self, format: int) -> None:
        """A pipeline in place of the one there was, whose sets go with it; it stays when there is an error."""
        pipeline = OverlayPipeline(self.device, format)
        if self._pipeline is not None:
            self._pipeline.close()
        self._pipeline = pipeline
        for number, (image, sets) in self._textures.items():
            sets.destroy()
            self._textures[number] = image, pipeline.new_set(image)

    def reload(self) -> None:
        """Take up changed shaders, for the first time at the next `draw`."""
        self._broken = False
        if self._pipeline is not None:
            self._make_pipeline(self._pipeline.format)

    # ---- triangles ----------------------------------------------------------------------------------

    def _record(self, frame: _Frame, data: Any, extent: tuple[int, int]) -> None:
        vk, commands = self.device.vk, frame.commands
        assert self._pipeline is not None
        vertices = frame.room(self.device, "vertices", data.total_vtx_count * _VERTEX_BYTES)
        indices = frame.room(self.device, "indices", data.total_idx_count * _INDEX_BYTES)
        vk.vkCmdBindIndexBuffer(commands, indices.handle, 0, _INDEX_TYPE)
        scale = 2 / np.array((data.display_size.x, data.display_size.y))
        translation = -1 - scale * (data.display_pos.x, data.display_pos.y)
        self._pipeline.bind(commands, vertices=vertices.address, scale=scale, translation=translation)
        first_vertex = first_index = 0
        for part in data.cmd_lists:
            _copy(part.vtx_buffer, _VERTEX_BYTES, vertices, first_vertex)
            _copy(part.idx_buffer, _INDEX_BYTES, indices, first_index)
            for command in part.cmd_buffer:
                self._draw(commands, command, data, extent, first_index, first_vertex)
            first_vertex += part.vtx_buffer.size()
            first_index += part.idx_buffer.size()

    def _draw(
        self, commands: raw.CData, command: Any, data: Any, extent: tuple[int, int], first_index: int, first_vertex: int
    ) -> None:
        texture = self._textures.get(command.get_tex_id())
        position, factor = data.display_pos, data.framebuffer_scale
        clip = command.clip_rect
        left, right = (int(min(max((x - position.x) * factor.x, 0), extent[0])) for x in (clip.x, clip.z))
        top, bottom = (int(min(max((y - position.y) * factor.y, 0), extent[1])) for y in (clip.y, clip.w))
        if texture is None or right <= left or bottom <= top:
            return
        vk = self.device.vk
        assert self._pipeline is not None
        area = {"width": right - left, "height": bottom - top}
        vk.vkCmdSetScissor(commands, 0, 1, raw.struct("VkRect2D", offset={"x": left, "y": top}, extent=area))
        texture[1].bind(commands, raw.VK_PIPELINE_BIND_POINT_GRAPHICS)
        vk.vkCmdDrawIndexed(
            commands, command.elem_count, 1, first_index + command.idx_offset, first_vertex + command.vtx_offset, 0
        )

    # ---- textures -----------------------------------------------------------------------------------

    def _update_textures(self, data: Any) -> None:
        """Make, change and destroy the textures that ImGui asks for, such as its font's."""
        status = imgui.ImTextureStatus
        for texture in data.textures or ():
            if texture.status in (status.want_create, status.want_updates):
                self._upload(texture)
                texture.set_status(status.ok)
            elif texture.status == status.want_destroy and texture.unused_frames > 0:
                self._destroy(texture.get_tex_id())
                texture.set_tex_id(0)
                texture.set_status(status.destroyed)

    def _upload(self, texture: Any) -> None:
        assert self._pipeline is not None
        number = texture.get_tex_id()
        if number not in self._textures:
            number = next(i for i in count(1) if i not in self._textures)
            image = self.device.image(
                texture.width, texture.height, raw.VK_FORMAT_R8G8B8A8_UNORM, f"overlay texture {number}"
            )
            self._textures[number] = image, self._pipeline.new_set(image)
            texture.set_tex_id(number)
        pixels = texture.get_pixels_array().reshape(texture.height, texture.width, 4)
        self._textures[number][0].upload([pixels])

    def _destroy(self, number: int) -> None:
        for item in self._textures.pop(number, ()):
            item.destroy()

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        for frame in self._frames:
            for buffer in frame.buffers.values():
                buffer.destroy()
        for number in list(self._textures):
            self._destroy(number)
        if self._pipeline is not None:
            self._pipeline.close()
        self._pool.destroy()


def _copy(source: Any, item_bytes: int, target: Buffer, first: int) -> None:
    """Copy all of an ImVector into a mapped buffer, `first` items behind its start."""
    size = source.size() * item_bytes
    if size:
        pointer = raw.ffi.cast("const char*", source.data_address())
        target.write(np.frombuffer(raw.ffi.buffer(pointer, size), np.uint8), first * item_bytes)
