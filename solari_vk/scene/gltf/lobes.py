"""The extensions of glTF materials for reflections of dielectrics, glass, clearcoat, sheen and anisotropy."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.scene.gltf.report import Report
from solari_vk.scene.gltf.textures import Slot, Textures
from solari_vk.scene.gltf.values import Entry

EXTENSIONS = (
    "KHR_materials_anisotropy", "KHR_materials_clearcoat", "KHR_materials_ior", "KHR_materials_sheen",
    "KHR_materials_specular", "KHR_materials_transmission", "KHR_materials_volume",
)  # fmt: skip
HIGHEST_F0 = 0.16  # of what the realtime renderer's G-buffer holds
LARGEST_DISTANCE = 1e9  # meters; also stands for a volume that absorbs nothing
_FULL_REFLECTION = 1e6  # the index of refraction for which glTF writes 0
# Fields of Material: the extension, and the key of the texture.
_TEXTURES = {
    "specular_texture": ("KHR_materials_specular", "specularTexture"),
    "specular_color_texture": ("KHR_materials_specular", "specularColorTexture"),
    "transmission_texture": ("KHR_materials_transmission", "transmissionTexture"),
    "clearcoat_texture": ("KHR_materials_clearcoat", "clearcoatTexture"),
    "clearcoat_roughness_texture": ("KHR_materials_clearcoat", "clearcoatRoughnessTexture"),
    "clearcoat_normal_texture": ("KHR_materials_clearcoat", "clearcoatNormalTexture"),
    "sheen_color_texture": ("KHR_materials_sheen", "sheenColorTexture"),
    "sheen_roughness_texture": ("KHR_materials_sheen", "sheenRoughnessTexture"),
    "anisotropy_texture": ("KHR_materials_anisotropy", "anisotropyTexture"),
}


def slots(entry: Entry, textures: Textures) -> dict[str, Slot | None]:
    """The slots of the extensions' textures, by the fields of Material."""
    return {field: textures.slot(_extension(entry, name), key) for field, (name, key) in _TEXTURES.items()}


def fields(entry: Entry, slots: dict[str, Slot], report: Report) -> dict[str, Any]:
    """The fields of Material that the extensions set, but for textures."""
    transmission, volume = (_extension(entry, f"KHR_materials_{name}") for name in ("transmission", "volume"))
    coat, sheen = (_extension(entry, f"KHR_materials_{name}") for name in ("clearcoat", "sheen"))
    anisotropy = _extension(entry, "KHR_materials_anisotropy")
    coat_normal = slots.get("clearcoat_normal_texture")
    distance = volume.number("attenuationDistance", LARGEST_DISTANCE, low=0)
    return {
        **_reflections(entry, report),
        "transmission": transmission.number("transmissionFactor", 0.0, low=0, high=1),
        "solid": volume.number("thicknessFactor", 0.0, low=0) > 0,
        "attenuation_color": np.array(volume.numbers("attenuationColor", (1.0, 1.0, 1.0), low=0, high=1), np.float32),
        "attenuation_distance": min(max(distance, 1 / LARGEST_DISTANCE), LARGEST_DISTANCE),
        "clearcoat": coat.number("clearcoatFactor", 0.0, low=0, high=1),
        "clearcoat_roughness": coat.number("clearcoatRoughnessFactor", 0.0, low=0, high=1),
        "clearcoat_normal_scale": coat_normal.entry.number("scale", 1.0, low=-1e6, high=1e6) if coat_normal else 1.0,
        "sheen_color": np.array(sheen.numbers("sheenColorFactor", (0.0, 0.0, 0.0), low=0, high=1), np.float32),
        "sheen_roughness": sheen.number("sheenRoughnessFactor", 0.0, low=0, high=1),
        "anisotropy": anisotropy.number("anisotropyStrength", 0.0, low=0, high=1),
        "anisotropy_rotation": anisotropy.number("anisotropyRotation", 0.0, low=-1e6, high=1e6),
    }


def _reflections(entry: Entry, report: Report) -> dict[str, Any]:
    """The index of refraction, the weight of reflections, and the reflectance for their color at normal incidence."""
    ior = _extension(entry, "KHR_materials_ior").number("ior", 1.5, low=0)
    if 0 < ior < 1:
        raise entry.wrong("extensions", "without an 'ior' between 0 and 1")
    ior = min(ior, _FULL_REFLECTION) if ior > 0 else _FULL_REFLECTION
    specular = _extension(entry, "KHR_materials_specular")
    f0 = ((ior - 1) / (ior + 1)) ** 2
    color = np.array(specular.numbers("specularColorFactor", (1.0, 1.0, 1.0), low=0))
    color = np.minimum(color, min(1 / f0, 4.0) if f0 > 0 else 4.0)  # a reflectance is at most 1
    if f0 * color.max() > HIGHEST_F0 * (1 + 1e-6):
        report.add(
            f"the realtime renderer shows reflections of dielectrics of {HIGHEST_F0:.0%} at most when seen straight on",
            entry.place,
        )
    return {
        "ior": ior,
        "specular": specular.number("specularFactor", 1.0, low=0, high=1),
        "reflectance": (0.5 * np.sqrt(color)).astype(np.float32),
    }


def _extension(entry: Entry, name: str) -> Entry:
    """A material's extension, empty when it has none."""
    return entry.extension(name) or Entry(entry.file, entry.place, {})
