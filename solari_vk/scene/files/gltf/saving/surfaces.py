"""Materials, textures and images of a scene as glTF has them."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from solari_vk.scene.files.gltf.extensions import OF_MATERIALS
from solari_vk.scene.files.gltf.extras import FRONT_EMITS
from solari_vk.scene.files.gltf.extras import KEY as EXTRAS
from solari_vk.scene.files.gltf.saving.content import Content, plain
from solari_vk.scene.files.gltf.specular_glossiness import FULL_REFLECTION
from solari_vk.scene.files.gltf.textures import MAGNIFICATION, MINIFICATION, WRAP
from solari_vk.scene.material import Material, Texture, TextureImage

FACTORS = {
    "KHR_materials_anisotropy": {"anisotropyStrength": "anisotropy", "anisotropyRotation": "anisotropy_rotation"},
    "KHR_materials_clearcoat": {"clearcoatFactor": "clearcoat", "clearcoatRoughnessFactor": "clearcoat_roughness"},
    "KHR_materials_diffuse_transmission": {
        "diffuseTransmissionFactor": "diffuse_transmission",
        "diffuseTransmissionColorFactor": "diffuse_transmission_color",
    },
    "KHR_materials_dispersion": {"dispersion": "dispersion"},
    "KHR_materials_ior": {"ior": "ior"},
    "KHR_materials_iridescence": {
        "iridescenceFactor": "iridescence",
        "iridescenceIor": "iridescence_ior",
        "iridescenceThicknessMinimum": "iridescence_thickness",
        "iridescenceThicknessMaximum": "iridescence_thickness",
    },
    "KHR_materials_sheen": {"sheenColorFactor": "sheen_color", "sheenRoughnessFactor": "sheen_roughness"},
    "KHR_materials_specular": {"specularFactor": "specular", "specularColorFactor": "reflectance"},
    "KHR_materials_transmission": {"transmissionFactor": "transmission"},
    "KHR_materials_volume": {
        "thicknessFactor": "solid",
        "attenuationColor": "attenuation_color",
        "attenuationDistance": "attenuation_distance",
    },
}
"""By extension: the keys of its factors, and the fields of Material that they hold."""
# KHR_materials_specular has F0 in units of 0.04, and `reflectance` has 0.16 reflectance^2.
_CONVERTED: dict[str, Callable[[Any], Any]] = {
    "specularColorFactor": lambda value: 4 * value.astype(np.float64) ** 2,
    "iridescenceThicknessMinimum": lambda value: value[0],
    "iridescenceThicknessMaximum": lambda value: value[1],
    "thicknessFactor": float,  # a thickness, which matters to rasterizers only
    "ior": lambda value: 0.0 if value >= FULL_REFLECTION else value,
}
_OF_UNLIT = ("base_color", "base_color_texture", "alpha", "alpha_mode", "alpha_cutoff", "double_sided", "unlit", "name")
_ROUNDING = 1e-5  # of a transform of uvs, relative to its scale


class Surfaces:
    """Writes each material, texture and image once."""

    def __init__(self, content: Content) -> None:
        self._content = content
        self._materials: dict[Material, int] = {}
        self._images: dict[TextureImage, int] = {}
        self._textures: dict[tuple[int, int], int] = {}
        self._samplers: dict[tuple[str | bool, ...], int] = {}
        self._default = Material()

    def material(self, material: Material) -> int:
        """The number of a material."""
        if material not in self._materials:
            number = self._materials[material] = self._add(material)
            self._content.written[material] = f"/materials/{number}", self._content.json["materials"][number]
        return self._materials[material]

    def _add(self, material: Material) -> int:
        pbr = {
            "baseColorFactor": [*plain(material.base_color), material.alpha],
            "metallicFactor": material.metallic,
            "roughnessFactor": material.perceptual_roughness,
        } | self._slots(material, {"base_color_texture": "baseColorTexture"})
        fields: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": pbr}
        # Empty fields are left out: these are the format's defaults.
        fields["alphaMode"] = material.alpha_mode.upper() if material.alpha_mode != "opaque" else None
        fields["alphaCutoff"] = material.alpha_cutoff if material.alpha_mode == "mask" else None
        fields["doubleSided"] = material.double_sided is not False or None
        fields["extras"] = {EXTRAS: {FRONT_EMITS: True}} if material.double_sided is None else None
        holder: dict[str, Any] = {}
        if material.unlit:
            self._content.use("KHR_materials_unlit", owner=holder)
            if any(self._differs(material, name) for name in material._names if name not in _OF_UNLIT):
                self._content.lose("what unlit materials don't show isn't written", material.describe())
            return self._content.add("materials", **fields, **holder)
        pbr |= self._slots(material, {"metallic_roughness_texture": "metallicRoughnessTexture"})
        fields |= self._slots(material, {"normal_texture": "normalTexture", "emissive_texture": "emissiveTexture"})
        if material.normal_texture is not None:
            fields["normalTexture"]["scale"] = material.normal_scale
        self._add_emission(material, fields, holder)
        self._add_extensions(material, holder)
        return self._content.add("materials", **fields, **holder)

    def _add_emission(self, material: Material, fields: dict[str, Any], holder: dict[str, Any]) -> None:
        """The emission as a factor of at most 1 and, beyond 1 cd/m^2, a strength."""
        strength = float(material.emissive.max())
        fields["emissiveFactor"] = material.emissive.astype(np.float64) / max(strength, 1) if strength else None
        if strength > 1:
            self._content.use("KHR_materials_emissive_strength", {"emissiveStrength": strength}, holder)

    def _add_extensions(self, material: Material, holder: dict[str, Any]) -> None:
        """The extensions with a texture or a factor that isn't as by default."""
        for extension, keys in FACTORS.items():
            slots = self._slots(material, OF_MATERIALS[extension].textures)
            if slots or any(self._differs(material, field) for field in keys.values()):
                self._content.use(extension, self._factors(material, keys) | slots, holder)
                if "clearcoatNormalTexture" in slots:
                    slots["clearcoatNormalTexture"]["scale"] = material.clearcoat_normal_scale

    def _differs(self, material: Material, field: str) -> bool:
        """Whether a field isn't as by default."""
        return not np.array_equal(getattr(material, field), getattr(self._default, field))

    @staticmethod
    def _factors(material: Material, keys: dict[str, str]) -> dict[str, Any]:
        values = {key: getattr(material, field) for key, field in keys.items()}
        if values.get("attenuationDistance") == math.inf:
            del values["attenuationDistance"]  # the format's default, for which JSON has no number
        return {key: plain(_CONVERTED.get(key, lambda value: value)(value)) for key, value in values.items()}

    # ---- textures -----------------------------------------------------------------------------------

    def _slots(self, material: Material, keys: Mapping[str, str]) -> dict[str, dict[str, Any]]:
        """The textures of a material under the keys of glTF. keys: by field, as `Extension.textures`."""
        found = ((key, getattr(material, field)) for field, key in keys.items())
        return {key: self._slot(texture, material) for key, texture in found if texture is not None}

    def _slot(self, texture: Texture, material: Material) -> dict[str, Any]:
        slot: dict[str, Any] = {"index": self._texture(texture)}
        if texture.uv_set:
            slot["texCoord"] = texture.uv_set
        (a, b, u), (c, d, v) = texture.uv_transform.astype(np.float64).tolist()
        if (a, b, u, c, d, v) != (1, 0, 0, 0, 1, 0):
            # The matrix is a turn times a scale; the longer axis has the turn more exactly.
            angle = math.atan2(-c, a) if math.hypot(a, c) > math.hypot(b, d) else math.atan2(b, d)
            cosine, sine = math.cos(angle), math.sin(angle)
            scale = cosine * a - sine * c, sine * b + cosine * d
            # The extension has no shear: it writes the turn of the longer axis.
            written = (cosine * scale[0], sine * scale[1], -sine * scale[0], cosine * scale[1])
            if not np.allclose(written, (a, b, c, d), rtol=0, atol=_ROUNDING * max(map(abs, scale))):
                self._content.lose("textures lose the shear of their uv_transform", material.describe())
            transform = {"offset": [u, v], "rotation": angle, "scale": list(scale)}
            self._content.use("KHR_texture_transform", {k: plain(value) for k, value in transform.items()}, slot)
        return slot

    def _texture(self, texture: Texture) -> int:
        sampling = texture.wrap_u, texture.wrap_v, texture.magnification, texture.minification, texture.mipmaps
        if sampling not in self._samplers:
            self._samplers[sampling] = self._content.add(
                "samplers",
                wrapS=_code(WRAP, sampling[0]),
                wrapT=_code(WRAP, sampling[1]),
                magFilter=_code(MAGNIFICATION, sampling[2]),
                minFilter=_code(MINIFICATION, sampling[3:]),
            )
        key = self._image(texture.image), self._samplers[sampling]
        if key not in self._textures:
            self._textures[key] = self._content.add("textures", source=key[0], sampler=key[1])
        return self._textures[key]

    def _image(self, image: TextureImage) -> int:
        """A PNG file of an image, without alpha if all of it is opaque."""
        if image not in self._images:
            from PIL import Image

            # Without alpha files are smaller.
            pixels = image.pixels if image.least_alpha < 1 else np.ascontiguousarray(image.pixels[..., :3])
            file = io.BytesIO()
            Image.fromarray(pixels).save(file, "PNG", compress_level=3)  # a third of the time, a twentieth larger
            view = self._content.view(file.getvalue())
            self._images[image] = self._content.add("images", name=image.name, bufferView=view, mimeType="image/png")
        return self._images[image]


def _code(codes: dict[int, Any], wanted: Any) -> int:
    return next(code for code, meaning in codes.items() if meaning == wanted)
