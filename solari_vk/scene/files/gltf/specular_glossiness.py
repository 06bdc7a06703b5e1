"""KHR_materials_pbrSpecularGlossiness: materials of a diffuse color, a specular color and a glossiness, without metal.

The specular color is F0. It is stated as for an index of refraction of 0 in glTF, with which all light is reflected, as
glTF-Transform's `metalRough` does. The extension asks for the diffuse light diffuse * (1 - max(F0)), which is what
three.js' GLTFMeshStandardSGMaterial shows. Shaders show base_color * (1 - F0) of smooth surfaces that are seen straight
on, by channel, so that only the quotient of the two remains to be put into the base color: 1 for a gray F0.
"""

from __future__ import annotations

from dataclasses import fields as fields_of
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB, srgb_of_linear
from solari_vk.scene.model import Texture, TextureImage

EXTENSION = "KHR_materials_pbrSpecularGlossiness"
FULL_REFLECTION = 1e6  # the index of refraction for which glTF writes 0
TEXTURES = {
    "base_color_texture": "diffuseTexture",
    "specular_color_texture": "specularGlossinessTexture",
    "metallic_roughness_texture": "specularGlossinessTexture",
}
_WORKING_BYTES = 64  # a pixel
_SAMPLING = [field.name for field in fields_of(Texture) if field.name != "image"]

Floats = NDArray[np.floating[Any]]


def read(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    """The fields of Material that the factors set. `Baker.bake` completes them."""
    *diffuse, alpha = extension.numbers("diffuseFactor", (1.0, 1.0, 1.0, 1.0), low=0, high=1)
    specular = extension.numbers("specularFactor", (1.0, 1.0, 1.0), low=0, high=1)
    return {
        "base_color": np.array(diffuse),
        "alpha": alpha,
        "metallic": 0.0,
        "perceptual_roughness": 1 - extension.number("glossinessFactor", 1.0, low=0, high=1),
        "ior": FULL_REFLECTION,
        "specular": 1.0,
        "reflectance": 0.5 * np.sqrt(specular),
    }


def diffuse_share(f0: Floats) -> Floats:
    """(1 - max(F0)) / (1 - F0) by channel, of colors (..., 3)."""
    most = f0.max(axis=-1, keepdims=True)
    share: Floats = (1 - most) / np.where(f0 < most, 1 - f0, 1)
    return np.where(f0 < most, share, 1)


class Baker:
    """Makes the textures of such materials, and keeps them."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._made: dict[Any, Texture] = {}

    def bake(self, fields: dict[str, Any], entry: Entry) -> dict[str, Any]:
        """The fields that differ from those of `read` with the file's textures. entry: the material's."""
        # The inverse of what `read` made of the specular factor.
        f0 = 4 * fields["reflectance"] ** 2
        texture, painted = fields.get("specular_color_texture"), fields.get("base_color_texture")
        if texture is None:
            return {"base_color": fields["base_color"] * diffuse_share(f0)}
        gloss = 1 - fields["perceptual_roughness"]
        sizes = [one.image.pixels.shape[:2] for one in (texture, painted) if one is not None]
        area = max(height for height, _ in sizes) * max(width for _, width in sizes)
        entry.charge(0, "splitting its textures", working=_WORKING_BYTES * area)
        changed: dict[str, Any] = {
            "perceptual_roughness": 1.0,
            "metallic_roughness_texture": self._texture(entry, texture, (gloss,), partial(_roughness, texture, gloss)),
        }
        share = diffuse_share(f0 * LINEAR_OF_SRGB[texture.image.pixels[..., :3]])
        # Less than one code of 8 bits.
        if share.min() > 1 - 1 / 255 or not fields["base_color"].any():
            return changed
        # Pixels can be multiplied only where both textures lie alike on the surface.
        if painted is None or _sampling(painted) == _sampling(texture):
            key = (id(painted), *f0)
            make = partial(_painted, painted, share)
            changed["base_color_texture"] = self._texture(entry, texture, key, make)
        else:
            changed["base_color"] = fields["base_color"] * share.mean(axis=(0, 1))
            self._report.add(
                "colors of reflections change the diffuse color by their mean only, because their "
                "textures lie differently",
                entry.place,
            )
        return changed

    def _texture(self, entry: Entry, texture: Texture, key: tuple[Any, ...], make: Any) -> Texture:
        found = self._made.get((id(texture), *key))
        if found is None:
            pixels = make()
            entry.charge(pixels.nbytes, "its textures")
            sampling = {name: getattr(texture, name) for name in _SAMPLING}
            image = TextureImage(pixels=pixels, name=texture.image.name)
            found = self._made[(id(texture), *key)] = Texture(image=image, **sampling)
        return found


def _roughness(texture: Texture, gloss: float) -> NDArray[np.uint8]:
    """1 - glossiness in green, of a texture with glossiness in alpha."""
    pixels = np.full_like(texture.image.pixels, 255)
    pixels[..., 1] = np.rint(255 - gloss * texture.image.pixels[..., 3].astype(np.float32))
    return pixels


def _painted(painted: Texture | None, share: Floats) -> NDArray[np.uint8]:
    """The pixels of a base color texture times shares (h, w, 3), in the larger of both sizes."""
    pixels = np.full((1, 1, 4), 255, np.uint8) if painted is None else painted.image.pixels
    height, width = np.maximum(pixels.shape[:2], share.shape[:2])
    pixels, share = (
        # The nearest pixel, so that a mask stays sharp.
        grid[np.arange(height)[:, None] * len(grid) // height, np.arange(width) * grid.shape[1] // width]
        for grid in (pixels, share)
    )
    color = srgb_of_linear(LINEAR_OF_SRGB[pixels[..., :3]] * share)
    return np.concatenate([color, pixels[..., 3:]], axis=-1)


def _sampling(texture: Texture) -> tuple[Any, ...]:
    """Where a texture's pixels lie on a surface."""
    return texture.wrap_u, texture.wrap_v, texture.uv_set, texture.uv_transform.tolist()
