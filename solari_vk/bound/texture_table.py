"""Texture images on the device with their mip chains, samplers, and the `textures` table that points to them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.features import Features
from solari_vk.bound.table import RowAllocator, Table, content_of
from solari_vk.bound.texture_tensors import DTYPES, TextureTensors
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.device.sampler import Sampler
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.scene.images.mip_chain import mip_chain
from solari_vk.scene.matrices import by_columns
from solari_vk.scene.model import Material, Texture, TextureImage

# An image, and whether its colors are sRGB.
ImageKey = tuple[TextureImage, bool]
# The same with the options of a sampler.
DescriptorKey = tuple[TextureImage, bool, tuple[tuple[str, Any], ...]]

_FORMATS = {True: raw.VK_FORMAT_R8G8B8A8_SRGB, False: raw.VK_FORMAT_R8G8B8A8_UNORM}
_WRAPS = ("repeat", "mirror", "clamp")
_WRAP = {"repeat": "repeat", "mirrored_repeat": "mirror", "clamp_to_edge": "clamp"}


class TexelBuffer:
    """The levels of an image (height, width, 4), from the finest on, in one buffer: glsl/scene/texel_buffers.glsl."""

    def __init__(
        self, device: Device, levels: Sequence[NDArray[np.uint8]], srgb: bool, name: str, uploads: Uploads
    ) -> None:
        self.height, self.width = levels[0].shape[:2]
        self._level_count = len(levels)
        self._srgb = srgb
        self._buffer = device.buffer(sum(level.nbytes for level in levels), name)
        offset = 0
        for level in levels:
            uploads.buffer(self._buffer, level, offset)
            offset += level.nbytes

    def fields(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The fields of a Texture of glsl/scene/bindings.glsl. options: those of a Sampler."""
        return {
            "texels": divmod(self._buffer.address, 1 << 32)[::-1],
            "size": (self.width, self.height),
            "level_count": self._level_count if options["mipmap"] == "linear" else 1,
            "wrap": [_WRAPS.index(options[name]) for name in ("wrap_u", "wrap_v")],
            "magnifies_linearly": options["magnify"] == "linear",
            "minifies_linearly": options["minify"] == "linear",
            "is_srgb": self._srgb,
        }

    def destroy(self) -> None:
        """Free it when the work submitted so far is done."""
        self._buffer.destroy()


class TextureTable:
    """The table `textures` with a row for each (Texture, sRGB) pair, and what it points to: an array of images with
    samplers, or on devices without such arrays buffers of texels."""

    def __init__(
        self, device: Device, record: np.dtype[Any], features: Features, watcher: Any, port: TensorPort
    ) -> None:
        self.table = Table(device, "textures", record)
        self.rows: RowAllocator[tuple[Texture, bool]] = RowAllocator()
        self._device = device
        self._features = features
        self._watcher = watcher
        self._images: dict[ImageKey, Image | TexelBuffer] = {}
        # Equal pixels share an image. Edited ones have a content of their own, equal to no other.
        self._contents: RowAllocator[Hashable] = RowAllocator()
        self._content_of: dict[ImageKey, Hashable] = {}
        self._image_users: RowAllocator[ImageKey] = RowAllocator()
        self._descriptors: RowAllocator[DescriptorKey] = RowAllocator()
        self._linked: dict[tuple[Texture, bool], DescriptorKey] = {}
        self._to_upload: dict[ImageKey, None] = {}
        self._replaced = False  # something of `resources`
        self._to_link: dict[tuple[Texture, bool], None] = {}
        self._port = port
        self._tensors = TextureTensors(device, port)
        # Fills unused elements of the array, because every element must be valid.
        self._white = device.image(1, 1, _FORMATS[False], "white texture")
        with device.uploads() as uploads:
            uploads.image(self._white, [np.full((1, 1, 4), 255, np.uint8)])
        self._blank = (self._white, device.sampler())
        self._bound: list[tuple[Image, Sampler]] = [self._blank]
        self._in_buffers = not device.has_descriptor_indexing

    @property
    def resources(self) -> dict[str, Any]:
        """What shaders bind besides the table, by names."""
        return {} if self._in_buffers else {"texture_images": self._bound}

    def acquire(self, texture: Texture, srgb: bool, material: Material) -> int:
        """Add a use of a texture; returns its row."""
        key = (texture, srgb)
        if self.rows.acquire(key, material):
            texture.watch(self._watcher)
            self._to_link[key] = None
        return self.rows[key]

    def release(self, texture: Texture, srgb: bool, material: Material) -> None:
        """Undo one `acquire`."""
        key = (texture, srgb)
        if self.rows.release(key, material):
            self._to_link.pop(key, None)
            self._unlink(key)
            if (texture, not srgb) not in self.rows:
                texture.unwatch(self._watcher)

    def mark_changed(self, changed: Texture | TextureImage) -> None:
        """Have `update` follow an edit of a texture or an image."""
        for key in self.rows:
            if key[0] is changed:
                self._to_link[key] = None
        if isinstance(changed, TextureImage):
            for image in self._image_users:
                if image[0] is changed:
                    self._to_upload[image] = None

    def accept_tensors(self, image: TextureImage, fields: Mapping[str, Any]) -> dict[str, DeviceTensor] | None:
        """A tensor of an image's size with its pixels; None for what the host must read."""
        size = image._stored("pixels").shape[:2]
        keys = {(image, True), (image, False)}
        if not keys & self._images.keys() or keys & self._to_upload.keys():  # of which an upload failed
            return None
        if self._in_buffers:  # shaders write texels to images alone
            return None
        return self._port.accept_fields(fields, lambda _: (size, (*size, 3), (*size, 4)), DTYPES)

    def update(self) -> bool:
        """Upload new and changed images; returns whether `resources` have changed."""
        if not self._to_link and not self._to_upload and not self._replaced:
            return False
        self.table.reserve(self.rows.high_water_mark)
        # Links first: they tell which images are new.
        for key in self._to_link:
            self._link(key)
        with self._device.uploads() as uploads:
            for needed in self._to_upload:
                self._upload(needed, uploads)
        self._to_link.clear()
        self._to_upload.clear()
        if not self._replaced:
            return False
        self._replaced = False
        self._bound = [self._blank] * max(self._descriptors.high_water_mark, 1)
        for descriptor in self._descriptors:
            pixels, srgb, options = descriptor
            image = self._images[pixels, srgb]
            if isinstance(image, Image):
                self._bound[self._descriptors[descriptor]] = (image, self._device.sampler(**dict(options)))
                continue
            rows = [self.rows[key] for key in self._descriptors.users(descriptor)]
            for name, value in image.fields(dict(options)).items():
                self.table.records[name][rows] = value
            self.table.mark(rows)
        return True

    def _link(self, key: tuple[Texture, bool]) -> None:
        """Point a row at its image and sampler."""
        texture, srgb = key
        self._features.add_of(texture)
        self._replaced = True
        options = {
            "wrap_u": _WRAP[texture.wrap_u],
            "wrap_v": _WRAP[texture.wrap_v],
            "magnify": texture.magnification,
            "minify": texture.minification,
            "mipmap": "linear" if texture.mipmaps else "none",
        }
        descriptor = (texture.image, srgb, tuple(options.items()))
        if self._image_users.acquire((texture.image, srgb), key):
            texture.image.watch(self._watcher)
            self._to_upload[texture.image, srgb] = None
        # Acquired before the earlier one is released, so that an image which both have stays.
        self._descriptors.acquire(descriptor, key)
        self._unlink(key)
        self._linked[key] = descriptor
        row = self.rows[key]
        self.table.records[row]["uv_transform"] = by_columns(texture.uv_transform)
        self.table.records[row]["uv_set"] = texture.uv_set
        self.table.records[row]["tangent_frame"] = texture.tangent_frame
        self.table.records[row]["image"] = self._descriptors[descriptor]
        self.table.mark([row])

    def _unlink(self, key: tuple[Texture, bool]) -> None:
        descriptor = self._linked.pop(key, None)
        if descriptor is None:
            return
        self._replaced = True
        self._descriptors.release(descriptor, key)
        image = descriptor[:2]
        if self._image_users.release(image, key):
            self._to_upload.pop(image, None)
            if (image[0], not image[1]) not in self._image_users:
                image[0].unwatch(self._watcher)
            if image in self._images:
                self._drop(image, self._images.pop(image), self._content_of.pop(image))

    def _upload(self, key: ImageKey, uploads: Uploads) -> None:
        source, srgb = key
        before = self._images.get(key)
        pixels = source._stored("pixels")
        if before is not None and self._port.owns(pixels) and pixels.shape[:2] == (before.height, before.width):
            self._write_tensor(key, pixels)
            return
        self._replaced = True
        # What was edited is not compared, so that edits take no time for that.
        content: Hashable = (content_of(source.pixels), srgb) if before is None else object()
        equal = self._contents.users(content)
        if equal:
            image = self._images[equal[0]]
        else:
            image = self._made(source.name or "texture", mip_chain(source.pixels, srgb), srgb, uploads)
        self._contents.acquire(content, key)
        if before is not None:
            self._drop(key, before, self._content_of[key])
        self._images[key] = image
        self._content_of[key] = content

    def _made(self, name: str, levels: list[NDArray[np.uint8]], srgb: bool, uploads: Uploads) -> Image | TexelBuffer:
        if self._in_buffers:
            return TexelBuffer(self._device, levels, srgb, name, uploads)
        height, width = levels[0].shape[:2]
        image = self._device.image(width, height, _FORMATS[srgb], name, mip_levels=len(levels))
        uploads.image(image, levels)
        return image

    def _write_tensor(self, key: ImageKey, tensor: DeviceTensor) -> None:
        """Have a tensor's texels in an image, which is a new one if others share the earlier one."""
        source, srgb = key
        image = self._images[key]
        assert isinstance(image, Image)
        content = self._content_of[key]
        is_shared = len(self._contents.users(content)) > 1
        self._images[key] = self._tensors.write(source.describe(), image, tensor, srgb, in_place=not is_shared)
        self._content_of[key] = object()
        self._contents.acquire(self._content_of[key], key)
        self._contents.release(content, key)
        self._replaced |= is_shared

    def _drop(self, key: ImageKey, image: Image | TexelBuffer, content: Hashable) -> None:
        """Free an image unless it is another key's too."""
        if self._contents.release(content, key):
            image.destroy()

    def destroy(self) -> None:
        for image in {*self._images.values(), self._white}:
            image.destroy()
        self._tensors.destroy()
        self.table.destroy()
        for texture, _ in self.rows:
            texture.unwatch(self._watcher)
        for source, _ in self._image_users:
            source.unwatch(self._watcher)
