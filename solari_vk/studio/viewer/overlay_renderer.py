"""Draws what Dear ImGui has laid out over an image of the window."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.graphics import Targets
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import PipelineInfo, Pipelines
from solari_vk.gpu.frame.raster import rendering
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.studio.viewer.swapchain import Swapchain

_GRAPHICS = raw.VK_PIPELINE_BIND_POINT_GRAPHICS
_VERTEX_BYTES, _INDEX_BYTES = imgui.VERTEX_SIZE, imgui.INDEX_SIZE
_INDEX_TYPE = raw.VK_INDEX_TYPE_UINT32 if _INDEX_BYTES == 4 else raw.VK_INDEX_TYPE_UINT16


class OverlayRenderer:
    """Textures, pipeline, vertices and indices of the current ImGui context. `close` it before the context."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._pipeline: _Pipeline | None = None
        self._broken = False  # a shader has an error; compiling it again in each frame would be slow
        # By the number that ImGui's draw commands name a texture by; 0 is none.
        self._textures: dict[int, tuple[Image, DescriptorSets]] = {}
        self._named: dict[str, int] = {}  # the textures of `show`
        self._buffers: dict[tuple[str, int], Buffer] = {}  # by name and by the swapchain's slot
        # ImGui then makes and changes its fonts' textures as texts need them, and may number the vertices of large
        # lists from an offset.
        io = imgui.get_io()
        io.backend_flags |= imgui.BackendFlags_.renderer_has_textures | imgui.BackendFlags_.renderer_has_vtx_offset

    def draw(self, data: Any, commands: raw.CData, swapchain: Swapchain, index: int) -> None:
        """Record commands that draw `data` over an image of the swapchain.

        Raises CompilationError for an error in a shader, and then records nothing until `reload` is called.
        """
        if not self._use_format(swapchain.format):
            return
        self._update_textures(data)
        target = (swapchain.views[index], raw.VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL)
        with rendering(self.device, commands, swapchain.extent, [target], clears=False):
            if data.total_vtx_count:
                self._record(commands, data, swapchain.extent, swapchain.slot)

    def _buffer(self, name: str, slot: int, size: int) -> Buffer:
        """A mapped buffer of at least `size` bytes."""
        buffer = self._buffers.get((name, slot))
        if buffer is None or buffer.size < size:
            if buffer is not None:
                buffer.destroy()
            # Twice the size, so that a panel that opens slowly doesn't make a buffer in each frame.
            buffer = self.device.buffer(max(2 * size, 1 << 16), f"overlay {name}", host=True)
            self._buffers[name, slot] = buffer
        return buffer

    def _use_format(self, format: int) -> bool:
        """Make the pipeline for a format if there is none yet; returns False if it can't be made."""
        if self._pipeline is not None and self._pipeline.format == format:
            return True
        if self._broken:
            return False
        self._broken = True  # stays so if the next line raises an error
        self._make_pipeline(format)
        self._broken = False
        return True

    def _make_pipeline(self, format: int) -> None:
        """Replace the pipeline and its descriptor sets. The old ones stay in use after an error."""
        pipeline = _Pipeline(self.device, format)
        if self._pipeline is not None:
            self._pipeline.close()
        self._pipeline = pipeline
        for number, (image, sets) in self._textures.items():
            sets.destroy()
            self._textures[number] = image, pipeline.new_set(image)

    def reload(self) -> None:
        """Compile changed shaders. If there is no pipeline yet, the next `draw` makes it."""
        self._broken = False
        if self._pipeline is not None:
            self._make_pipeline(self._pipeline.format)

    # ---- triangles ----------------------------------------------------------------------------------

    def _record(self, commands: raw.CData, data: Any, extent: tuple[int, int], slot: int) -> None:
        assert self._pipeline is not None
        vertices = self._buffer("vertices", slot, data.total_vtx_count * _VERTEX_BYTES)
        indices = self._buffer("indices", slot, data.total_idx_count * _INDEX_BYTES)
        self.device.vk.vkCmdBindIndexBuffer(commands, indices.handle, 0, _INDEX_TYPE)
        scale = 2 / np.array((data.display_size.x, data.display_size.y))
        self._pipeline.bind(commands, vertices=vertices.address, scale=scale)
        first_vertex = first_index = 0
        for part in _items(data.cmd_lists):
            _copy(part.vtx_buffer, _VERTEX_BYTES, vertices, first_vertex)
            _copy(part.idx_buffer, _INDEX_BYTES, indices, first_index)
            for command in _items(part.cmd_buffer):
                self._draw(commands, command, data.framebuffer_scale, extent, first_index, first_vertex)
            first_vertex += part.vtx_buffer.size()
            first_index += part.idx_buffer.size()

    def _draw(
        self,
        commands: raw.CData,
        command: Any,
        factor: Any,
        extent: tuple[int, int],
        first_index: int,
        first_vertex: int,
    ) -> None:
        texture = self._textures.get(command.get_tex_id())
        clip = command.clip_rect
        # Clip rectangles are in window coordinates; Vulkan's scissors are in pixels and inside of the image.
        left, right = (int(min(max(x * factor.x, 0), extent[0])) for x in (clip.x, clip.z))
        top, bottom = (int(min(max(y * factor.y, 0), extent[1])) for y in (clip.y, clip.w))
        if texture is None or right <= left or bottom <= top:
            return
        vk = self.device.vk
        area = {"width": right - left, "height": bottom - top}
        vk.vkCmdSetScissor(commands, 0, 1, raw.struct("VkRect2D", offset={"x": left, "y": top}, extent=area))
        texture[1].bind(commands, _GRAPHICS)
        vk.vkCmdDrawIndexed(
            commands, command.elem_count, 1, first_index + command.idx_offset, first_vertex + command.vtx_offset, 0
        )

    # ---- textures -----------------------------------------------------------------------------------

    def _update_textures(self, data: Any) -> None:
        """Make, change and destroy textures, such as the font's, as ImGui asks for it."""
        status = imgui.ImTextureStatus
        for texture in _items(data.textures or ()):
            if texture.status in (status.want_create, status.want_updates):
                self._upload(texture)
                texture.set_status(status.ok)
            # A texture that the latest frame used may still be drawn.
            elif texture.status == status.want_destroy and texture.unused_frames > 0:
                self._destroy(texture.get_tex_id())
                texture.set_tex_id(0)
                texture.set_status(status.destroyed)

    def _upload(self, texture: Any) -> None:
        number = texture.get_tex_id()
        if number not in self._textures:
            number = self._make_texture(texture.width, texture.height)
            texture.set_tex_id(number)
        pixels = texture.get_pixels_array().reshape(texture.height, texture.width, 4)
        self._textures[number][0].upload([pixels])

    def show(self, name: str, pixels: NDArray[np.uint8] | None = None) -> Any:
        """ImGui's reference to a texture of this name; None before the first `draw`, and for a name without pixels.

        pixels: (height, width, 4), sRGB, that replace the texture's.
        """
        if self._pipeline is None:
            return None
        if pixels is not None:
            height, width = pixels.shape[:2]
            if self._size_of(name) != (width, height):
                self.forget(name)
                self._named[name] = self._make_texture(width, height)
            image, _ = self._textures[self._named[name]]
            image.upload([pixels])
        number = self._named.get(name)
        return None if number is None else imgui.ImTextureRef(number)

    def _size_of(self, name: str) -> tuple[int, int] | None:
        """The width and height of a texture of `show`, None if there is none."""
        if name not in self._named:
            return None
        image, _ = self._textures[self._named[name]]
        return image.width, image.height

    def forget(self, name: str) -> None:
        """Free a texture of `show`."""
        number = self._named.pop(name, None)
        if number is not None:
            self._destroy(number)

    def _make_texture(self, width: int, height: int) -> int:
        assert self._pipeline is not None
        number = next(i for i in count(1) if i not in self._textures)
        image = self.device.image(width, height, raw.VK_FORMAT_R8G8B8A8_UNORM, f"overlay texture {number}")
        self._textures[number] = image, self._pipeline.new_set(image)
        return number

    def _destroy(self, number: int) -> None:
        for item in self._textures.pop(number, ()):
            item.destroy()

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        for buffer in self._buffers.values():
            buffer.destroy()
        for number in list(self._textures):
            self._destroy(number)
        if self._pipeline is not None:
            self._pipeline.close()


def _items(vector: Any) -> list[Any]:
    """The items of a list of ImGui. Its iterators give items of other types in imgui-bundle 1.93 on Windows."""
    return [vector[index] for index in range(len(vector))]


class _Pipeline:
    """Draws blended, clipped triangles of one texture each over images of a VkFormat."""

    def __init__(self, device: Device, format: int) -> None:
        self.format = format
        self._device = device
        self._sampler = device.sampler(mipmap="none", wrap_u="clamp", wrap_v="clamp")
        paths = [f"passes/viewer/overlay.{suffix}" for suffix in ("vert", "frag")]
        modules = [reflect(compile_shader(path), path) for path in paths]
        self._placement = modules[0].push_constants
        self._interface = Interface(device, modules)
        self._pipelines = Pipelines(device)
        wanted = PipelineInfo("overlay", modules, {}, Targets((format,), blends=True))
        try:
            [(_, self._made)] = self._pipelines.make([wanted], self._interface)
        except BaseException:
            self.close()
            raise

    def bind(self, commands: raw.CData, **placement: Any) -> None:
        """Record the pipeline's binding, and the values of overlay.vert's push constants."""
        vk = self._device.vk
        pushed = np.zeros(1, self._placement)
        for field, value in placement.items():
            pushed[field] = value
        vk.vkCmdBindPipeline(commands, _GRAPHICS, self._made.handle)
        layout = self._interface.pipeline_layout
        data = raw.ffi.from_buffer(pushed)
        vk.vkCmdPushConstants(commands, layout, raw.VK_SHADER_STAGE_ALL, 0, pushed.nbytes, data)

    def new_set(self, image: Image) -> DescriptorSets:
        """Descriptor sets for a texture."""
        sets = DescriptorSets(self._interface, [0, 0])
        sets.write({"image": (image, self._sampler)})
        return sets

    def close(self) -> None:
        """Free the pipeline when the work submitted so far is done. Safe to call twice."""
        self._pipelines.destroy()
        self._interface.destroy()


def _copy(source: Any, item_bytes: int, target: Buffer, first: int) -> None:
    """Copy an ImVector into a mapped buffer, to the items from index `first` on."""
    size = source.size() * item_bytes
    if size:
        pointer = raw.ffi.cast("const char*", source.data_address())
        target.write(np.frombuffer(raw.ffi.buffer(pointer, size), np.uint8), first * item_bytes)
