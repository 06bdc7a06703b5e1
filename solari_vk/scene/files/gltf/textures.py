"""Samplers and texture slots of a glTF file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.model import Texture, TextureImage

# glTF 2.0, 5.26 (Sampler): the values of OpenGL's GL_TEXTURE_WRAP_S and of its filters.
WRAP = {33071: "clamp_to_edge", 33648: "mirrored_repeat", 10497: "repeat"}
MAGNIFICATION = {9728: "nearest", 9729: "linear"}
# What each filter does within a level, and whether it uses the smaller levels.
MINIFICATION = {
    9728: ("nearest", False),
    9729: ("linear", False),
    9984: ("nearest", True),
    9985: ("linear", True),
    9986: ("nearest", True),
    9987: ("linear", True),
}
# A texture may name images of one picture in several formats. The first that can be read is taken, in this order.
_PREFERRED_SOURCES = (
    "KHR_texture_basisu",
    "KHR_texture_ktx",
    "EXT_texture_exr",
    "EXT_texture_webp",
    "MSFT_texture_dds",
)
_UNREAD_SOURCES = ("EXT_texture_avif",)

Choice = TypeVar("Choice")


@dataclass(frozen=True)
class Slot:
    """A material's use of a texture: its index, the set of uvs, and the 2x3 matrix that maps them."""

    entry: Entry
    texture: int
    images: tuple[int, ...]
    """Numbers of images: the preferred one, and those that replace it if it can't be read."""
    uv_set: int
    uv_transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


class Textures:
    """Creates the textures of the scene; equal uses share a texture."""

    def __init__(self, document: Document, report: Report, strict: bool) -> None:
        self._document = document
        self._report = report
        self._images = Images(document, report, strict)
        self._textures: dict[tuple[int, tuple[float, ...], int], Texture] = {}
        self.uv_sets: tuple[int, ...] = (0, 1)
        """The file's sets of uvs, by the numbers that they have in the scene's textures and meshes: the first two, and
        those that textures use."""

    def slot(self, user: Entry, key: str) -> Slot | None:
        """The texture under a key of an object; None without a texture, or (reported) without a usable image."""
        info = user.entry(key)
        if info is None:
            return None
        index = info.integer("index")
        uv_set = info.integer("texCoord", 0, high=255)
        texture = self._document.item("texture", index, info)
        images = images_of(texture)
        if not images:
            why = next((name for name in _UNREAD_SOURCES if texture.extension(name)), None)
            remark = f"no image in a format that can be read ({why})" if why else "no image"
            self._report.add(f"textures have {remark} and are left out", texture.place)
            return None
        self._report.add_extensions(info, ("KHR_texture_transform",))
        transform = info.extension("KHR_texture_transform")
        if transform is None:
            return Slot(info, index, images, uv_set)
        # offset, rotation and scale make one matrix; texCoord replaces that of the texture.
        u, v = np.clip(transform.numbers("offset", (0.0, 0.0)), -1e9, 1e9).tolist()
        scale_u, scale_v = np.clip(transform.numbers("scale", (1.0, 1.0)), -1e9, 1e9).tolist()
        angle = transform.limited("rotation", 0.0, limit=1e9)
        cos, sin = math.cos(angle), math.sin(angle)
        # KHR_texture_transform: uvs are scaled, then turned counter-clockwise in the image (v increases downwards),
        # then moved.
        matrix = (cos * scale_u, sin * scale_v, u, -sin * scale_u, cos * scale_v, v)
        return Slot(info, index, images, transform.integer("texCoord", uv_set, high=255), matrix)

    def decode(self, slots: list[tuple[Slot, bool]]) -> None:
        """Read the images of all slots of the scene, each with whether its values are colors."""
        colors = {image for slot, is_color in slots if is_color for image in slot.images}
        data = {image for slot, is_color in slots if not is_color for image in slot.images}
        self.uv_sets = tuple(sorted({0, 1} | {slot.uv_set for slot, _ in slots}))
        self._images.read({slot.images: slot.entry for slot, _ in slots}, data - colors)

    def __contains__(self, slot: Slot) -> bool:
        """Whether a slot has an image that could be read, after `decode`."""
        return self._images[slot.images] is not None

    def image(self, slot: Slot) -> TextureImage:
        """The image of a slot, after `decode`."""
        image = self._images[slot.images]
        assert image is not None, "the slot must be among the textures"
        return image

    def texture(self, slot: Slot) -> Texture:
        """The texture of a slot, after `decode`."""
        key = (slot.texture, slot.uv_transform, slot.uv_set)
        if key not in self._textures:
            entry = self._document.item("texture", slot.texture, slot.entry)
            index = entry.index("sampler")
            sampler = None if index is None else self._document.item("sampler", index, entry)
            minification, mipmaps = _choice(sampler, "minFilter", 9987, MINIFICATION)
            self._textures[key] = Texture(
                image=self.image(slot),
                wrap_u=_choice(sampler, "wrapS", 10497, WRAP),
                wrap_v=_choice(sampler, "wrapT", 10497, WRAP),
                magnification=_choice(sampler, "magFilter", 9729, MAGNIFICATION),
                minification=minification,
                mipmaps=mipmaps,
                uv_transform=np.reshape(slot.uv_transform, (2, 3)),
                uv_set=self.uv_sets.index(slot.uv_set),
            )
        return self._textures[key]


def images_of(texture: Entry) -> tuple[int, ...]:
    """The numbers of a texture's images, the preferred one first."""
    users = [texture.extension(name) for name in _PREFERRED_SOURCES]
    images = [user.index("source") for user in (*users, texture) if user is not None]
    return tuple(image for image in images if image is not None)


def _choice(sampler: Entry | None, key: str, default: int, choices: dict[int, Choice]) -> Choice:
    if sampler is None:
        return choices[default]
    code = sampler.integer(key, default)
    if code not in choices:
        raise sampler.wrong(key, f"one of {', '.join(map(str, choices))}")
    return choices[code]
