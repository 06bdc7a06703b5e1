"""Images, samplers and texture slots of a glTF file; images are decoded once, in parallel."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from solari_vk.scene import images
from solari_vk.scene.gltf.document import Document
from solari_vk.scene.gltf.report import Report
from solari_vk.scene.gltf.values import Entry
from solari_vk.scene.model import Texture, TextureImage

LARGEST_TOTAL_PIXEL_COUNT = 2**30  # of one file: 4 GiB as RGBA
_WRAP = {33071: "clamp_to_edge", 33648: "mirrored_repeat", 10497: "repeat"}
_MAGNIFICATION = {9728: "nearest", 9729: "linear"}
# What each filter does within a level, and whether it uses the smaller levels.
_MINIFICATION = {
    9728: ("nearest", False), 9729: ("linear", False), 9984: ("nearest", True), 9985: ("linear", True),
    9986: ("nearest", True), 9987: ("linear", True),
}  # fmt: skip
_OTHER_SOURCES = ("KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")

Choice = TypeVar("Choice")
Source = tuple[str, str | int]  # equal sources are the same image


@dataclass(frozen=True)
class Slot:
    """A material's use of a texture: its index, the set of uvs, and the 2x3 matrix that maps them."""

    entry: Entry
    texture: int
    image: int
    uv_set: int
    uv_transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


class Textures:
    """Creates the textures of the scene; equal uses share a texture."""

    def __init__(self, document: Document, report: Report) -> None:
        self._document = document
        self._report = report
        self._images: dict[int, TextureImage] = {}
        self._textures: dict[tuple[int, tuple[float, ...]], Texture] = {}

    def slot(self, user: Entry, key: str) -> Slot | None:
        """The texture under a key of an object; None without a texture, or (reported) without a usable image."""
        info = user.entry(key)
        if info is None:
            return None
        index, uv_set = info.integer("index"), info.integer("texCoord", 0, high=255)
        texture = self._document.item("texture", index, info)
        image = texture.index("source")
        if image is None:
            why = next((name for name in _OTHER_SOURCES if texture.extension(name)), None)
            remark = f"no image in a format that can be read ({why})" if why else "no image"
            self._report.add(f"textures have {remark} and are left out", texture.place)
            return None
        self._report.add_extensions(info, ("KHR_texture_transform",))
        transform = info.extension("KHR_texture_transform")
        if transform is None:
            return Slot(info, index, image, uv_set)
        u, v = transform.numbers("offset", (0.0, 0.0), low=-1e9, high=1e9)
        scale_u, scale_v = transform.numbers("scale", (1.0, 1.0), low=-1e9, high=1e9)
        angle = transform.number("rotation", 0.0, low=-1e9, high=1e9)
        cos, sin = math.cos(angle), math.sin(angle)
        # A counter-clockwise turn in the image, where v increases downwards.
        matrix = (cos * scale_u, sin * scale_v, u, -sin * scale_u, cos * scale_v, v)
        return Slot(info, index, image, transform.integer("texCoord", uv_set, high=255), matrix)

    def decode(self, slots: list[Slot]) -> None:
        """Read the images of all slots of the scene; images with the same source are one."""
        entries = {slot.image: self._document.item("image", slot.image, slot.entry) for slot in slots}
        sources = {index: self._source(entry) for index, entry in entries.items()}
        opened = {}
        pixel_count = 0
        for index, source in sources.items():
            if source in opened:
                continue
            entry = entries[index]
            image = images.open_image(self._bytes(entry, source), f"{entry.file}: {entry.place}")
            pixel_count += image.width * image.height
            if pixel_count > LARGEST_TOTAL_PIXEL_COUNT:
                limit = LARGEST_TOTAL_PIXEL_COUNT >> 20
                raise entry.error(f"brings the file's images above {limit} Mi pixels in all: scale them down")
            opened[source] = (image, entry)

        def decoded(source: Source) -> TextureImage:
            image, entry = opened[source]
            name = entry.name or (str(source[1]) if source[0] == "file" else entry.place)
            pixels = images.decode(image, f"{entry.file}: {entry.place}")
            return TextureImage(pixels=pixels, name=os.path.basename(name))

        with ThreadPoolExecutor(max_workers=min(8, os.cpu_count() or 1)) as pool:
            made = dict(zip(opened, pool.map(decoded, opened), strict=True))
        self._images = {index: made[source] for index, source in sources.items()}

    def _source(self, entry: Entry) -> Source:
        if "uri" not in entry:
            return "view", entry.integer("bufferView")
        uri = entry.text("uri")
        return ("data", uri) if uri[:5].lower() == "data:" else ("file", str(self._document.resource_path(entry)))

    def _bytes(self, entry: Entry, source: Source) -> bytes:
        if isinstance(source[1], int):
            return self._document.view(source[1], entry)[0].tobytes()
        return self._document.resource(entry).tobytes()

    def image(self, slot: Slot) -> TextureImage:
        """The image of a slot, after `decode`."""
        return self._images[slot.image]

    def texture(self, slot: Slot) -> Texture:
        """The texture of a slot, after `decode`."""
        key = (slot.texture, slot.uv_transform)
        if key not in self._textures:
            entry = self._document.item("texture", slot.texture, slot.entry)
            index = entry.index("sampler")
            sampler = None if index is None else self._document.item("sampler", index, entry)
            minification, mipmaps = _choice(sampler, "minFilter", 9987, _MINIFICATION)
            self._textures[key] = Texture(
                image=self.image(slot),
                wrap_u=_choice(sampler, "wrapS", 10497, _WRAP),
                wrap_v=_choice(sampler, "wrapT", 10497, _WRAP),
                magnification=_choice(sampler, "magFilter", 9729, _MAGNIFICATION),
                minification=minification,
                mipmaps=mipmaps,
                uv_transform=np.reshape(slot.uv_transform, (2, 3)),
            )
        return self._textures[key]


def _choice(sampler: Entry | None, key: str, default: int, choices: dict[int, Choice]) -> Choice:
    if sampler is None:
        return choices[default]
    code = sampler.integer(key, default)
    if code not in choices:
        raise sampler.wrong(key, f"one of {', '.join(map(str, choices))}")
    return choices[code]
