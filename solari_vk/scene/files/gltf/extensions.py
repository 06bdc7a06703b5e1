"""What the loader does with each extension of glTF. docs/gltf.md shows this table, and a test compares the two.

The row of an extension of materials has its reader, and the fields of Material that its textures are for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from solari_vk.scene.files.gltf import specular_glossiness
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.specular_glossiness import FULL_REFLECTION
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.material import LARGEST_DISPERSION, LARGEST_REFLECTANCE, LARGEST_THICKNESS

LARGEST_DISTANCE = 1e9  # meters; also stands for a volume that absorbs nothing


class Extension(NamedTuple):
    """An extension, and how much of it is shown."""

    name: str
    status: Literal["works", "part", "no"]
    """Files that require an extension with "no" are refused; in other files it is reported and ignored."""
    remark: str
    read: Callable[[Entry, Entry, Report], dict[str, Any]] = lambda extension, material, report: {}
    """Of materials: the fields of Material that the extension sets, from itself and the material's entry."""
    textures: Mapping[str, str] = {}
    """The fields of Material that are textures, and the extension's keys for them."""


# ---- readers of the extensions of materials ---------------------------------------------------------


def _anisotropy(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    return {
        "anisotropy": extension.number("anisotropyStrength", 0.0, low=0, high=1),
        "anisotropy_rotation": extension.limited("anisotropyRotation", 0.0, limit=1e6),
    }


def _clearcoat(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    normal = extension.entry("clearcoatNormalTexture")
    return {
        "clearcoat": extension.number("clearcoatFactor", 0.0, low=0, high=1),
        "clearcoat_roughness": extension.number("clearcoatRoughnessFactor", 0.0, low=0, high=1),
        "clearcoat_normal_scale": normal.limited("scale", 1.0, limit=1e6) if normal else 1.0,
    }


def _diffuse_transmission(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    color = extension.numbers("diffuseTransmissionColorFactor", (1.0, 1.0, 1.0), low=0, high=1)
    return {
        "diffuse_transmission": extension.number("diffuseTransmissionFactor", 0.0, low=0, high=1),
        "diffuse_transmission_color": color,
    }


def _dispersion(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    return {"dispersion": min(extension.number("dispersion", 0.0, low=0), LARGEST_DISPERSION)}


def _iridescence(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    keys = {"iridescenceThicknessMinimum": 100.0, "iridescenceThicknessMaximum": 400.0}
    thickness = [extension.number(key, default, low=0) for key, default in keys.items()]
    return {
        "iridescence": extension.number("iridescenceFactor", 0.0, low=0, high=1),
        "iridescence_ior": min(extension.number("iridescenceIor", 1.3, low=1), FULL_REFLECTION),
        "iridescence_thickness": np.minimum(thickness, LARGEST_THICKNESS).astype(np.float32),
    }


def _reflections(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    """The index of refraction, the weight of reflections, and the reflectance for their color at normal incidence, of
    two extensions together."""
    nothing = Entry(material.file, material.place, {})
    ior = (material.extension("KHR_materials_ior") or nothing).number("ior", 1.5, low=0)
    # KHR_materials_ior: 0 stands for an infinite index, with which the Fresnel term is 1 everywhere.
    if 0 < ior < 1:
        raise material.wrong("extensions", "without an 'ior' between 0 and 1")
    ior = min(ior, FULL_REFLECTION) if ior > 0 else FULL_REFLECTION
    specular = material.extension("KHR_materials_specular") or nothing
    color = np.array(specular.numbers("specularColorFactor", (1.0, 1.0, 1.0), low=0))
    return {
        "ior": ior,
        "specular": specular.number("specularFactor", 1.0, low=0, high=1),
        # KHR_materials_specular: F0 is 0.04 times the color for an ior of 1.5, and Material's is 0.16 reflectance^2.
        "reflectance": np.minimum(0.5 * np.sqrt(color), LARGEST_REFLECTANCE).astype(np.float32),
    }


def _sheen(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    return {
        "sheen_color": extension.numbers("sheenColorFactor", (0.0, 0.0, 0.0), low=0, high=1),
        "sheen_roughness": extension.number("sheenRoughnessFactor", 0.0, low=0, high=1),
    }


def _transmission(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    return {"transmission": extension.number("transmissionFactor", 0.0, low=0, high=1)}


def _volume(extension: Entry, material: Entry, report: Report) -> dict[str, Any]:
    distance = extension.number("attenuationDistance", LARGEST_DISTANCE, low=0)
    # KHR_materials_volume: the default is infinity, for which JSON has no number.
    distance = max(distance, 1 / LARGEST_DISTANCE) if distance < LARGEST_DISTANCE else math.inf
    return {
        # KHR_materials_volume: a thickness of 0 means a thin wall; for rays its size doesn't matter.
        "solid": extension.number("thicknessFactor", 0.0, low=0) > 0,
        "attenuation_color": extension.numbers("attenuationColor", (1.0, 1.0, 1.0), low=0, high=1),
        "attenuation_distance": distance,
    }


# ---- the table --------------------------------------------------------------------------------------

EXTENSIONS = (
    # Ratified by Khronos.
    Extension(
        "KHR_animation_pointer",
        "part",
        "properties of nodes; numbers of materials and of their texture "
        "transforms, of cameras and of lights; others stay and are named",
    ),
    Extension("KHR_draco_mesh_compression", "works", "with the extra `formats`"),
    Extension("KHR_gaussian_splatting", "no", "splats have no surface"),
    Extension("KHR_interactivity", "no", "behavior graphs are ignored"),
    Extension(
        "KHR_lights_punctual",
        "works",
        "a `range` of 0, which glTF forbids, is no limit; light above 1e15 cd or "
        "lux is dimmed to that; both are reported",
    ),
    Extension(
        "KHR_materials_anisotropy",
        "works",
        "needs tangents or uvs; glass and coats have none",
        _anisotropy,
        {"anisotropy_texture": "anisotropyTexture"},
    ),
    Extension(
        "KHR_materials_clearcoat",
        "works",
        "a coat doesn't darken what is emitted below it, of which the extension takes 4 % straight on and all at "
        "grazing angles: lamps emit alike in all directions",
        _clearcoat,
        {
            "clearcoat_texture": "clearcoatTexture",
            "clearcoat_roughness_texture": "clearcoatRoughnessTexture",
            "clearcoat_normal_texture": "clearcoatNormalTexture",
        },
    ),
    Extension("KHR_materials_dispersion", "works", "up to 100; `lighting=split` bends all colors alike", _dispersion),
    Extension("KHR_materials_emissive_strength", "works", ""),
    Extension("KHR_materials_ior", "works", "", _reflections),
    Extension(
        "KHR_materials_iridescence",
        "works",
        "also on glass; coats have none",
        _iridescence,
        {"iridescence_texture": "iridescenceTexture", "iridescence_thickness_texture": "iridescenceThicknessTexture"},
    ),
    Extension(
        "KHR_materials_sheen",
        "works",
        "",
        _sheen,
        {"sheen_color_texture": "sheenColorTexture", "sheen_roughness_texture": "sheenRoughnessTexture"},
    ),
    Extension(
        "KHR_materials_specular",
        "works",
        "",
        _reflections,
        {"specular_texture": "specularTexture", "specular_color_texture": "specularColorTexture"},
    ),
    Extension(
        "KHR_materials_transmission",
        "works",
        "shadow rays pass thin smooth glass only",
        _transmission,
        {"transmission_texture": "transmissionTexture"},
    ),
    Extension(
        "KHR_materials_unlit",
        "works",
        "seen in mirrors and through clear glass, not in rough reflections; a color of 1 is 1.2 cd/m²",
    ),
    Extension("KHR_materials_variants", "works", "`load_gltf(variant=)`, `scene.use_variant`, `--variant`"),
    Extension(
        "KHR_materials_volume", "works", "meshes must be closed; thickness only says whether there is a volume", _volume
    ),
    Extension("KHR_mesh_quantization", "works", ""),
    Extension("KHR_node_hoverability", "no", "for interaction only"),
    Extension("KHR_node_selectability", "no", "for interaction only"),
    Extension("KHR_node_visibility", "works", ""),
    Extension("KHR_texture_basisu", "works", "with the extra `formats`"),
    Extension("KHR_texture_ktx", "part", "KTX2 of one layer with 8 bits a channel; `ktx2ktx2` converts KTX 1"),
    Extension("KHR_texture_transform", "works", ""),
    Extension("KHR_xmp_json_ld", "works", "metadata, which pictures don't show"),
    # Drafts of Khronos.
    Extension("KHR_audio_emitter", "no", "sounds are ignored"),
    Extension("KHR_implicit_shapes", "no", "shapes are for physics"),
    Extension(
        "KHR_materials_diffuse_transmission",
        "works",
        "`lighting=split` leaves out what passes",
        _diffuse_transmission,
        {
            "diffuse_transmission_texture": "diffuseTransmissionTexture",
            "diffuse_transmission_color_texture": "diffuseTransmissionColorTexture",
        },
    ),
    Extension("KHR_materials_volume_scatter", "no", "volumes scatter no light"),
    Extension("KHR_meshopt_compression", "works", "with the extra `formats`"),
    Extension("KHR_physics_rigid_bodies", "no", "physics is ignored"),
    # Of several vendors.
    Extension("EXT_instance_features", "no", "identifiers of instances are ignored"),
    Extension("EXT_lights_ies", "works", "factors for tilted lamps aren't applied"),
    Extension("EXT_lights_image_based", "works", "the sharpest images of the cube light the scene"),
    Extension("EXT_mesh_features", "no", "identifiers of features are ignored"),
    Extension("EXT_mesh_gpu_instancing", "works", "attributes other than translation, rotation and scale are ignored"),
    Extension("EXT_mesh_manifold", "no", "information for solid modelling is ignored"),
    Extension("EXT_meshopt_compression", "works", "with the extra `formats`"),
    Extension("EXT_structural_metadata", "no", "metadata, which pictures don't show"),
    Extension("EXT_texture_avif", "no", "the texture's other image is used, if it has one"),
    Extension("EXT_texture_exr", "works", "values above 1 are 1, in 8 bits; those of skies stay as they are"),
    Extension("EXT_texture_webp", "works", ""),
    # Of one vendor, and withdrawn ones.
    Extension("CESIUM_RTC", "works", "positions are left relative to the center, which a warning names"),
    Extension("CESIUM_primitive_outline", "no", "outlines are not drawn"),
    Extension("GODOT_single_root", "no", "a hint for game engines"),
    Extension(
        "KHR_materials_pbrSpecularGlossiness",
        "works",
        "diffuse light is diffuse * (1 - max(specular)), as in "
        "three.js; the file's metallic-roughness values are ignored",
        specular_glossiness.read,
        specular_glossiness.TEXTURES,
    ),
    Extension("MSFT_lod", "works", "the most detailed level is shown at all distances"),
    Extension("MSFT_texture_dds", "works", "not BC6H"),
    Extension(
        "OMI_environment_sky",
        "part",
        "gradient, plain and panorama skies; a color of 1 is 1 cd/m²; physical "
        "skies, the glow around suns and ambient light apart from the sky are left out",
    ),
    Extension("VRMC_vrm", "no", "avatars are shown as any other model"),
)

SUPPORTED_EXTENSIONS = tuple(extension.name for extension in EXTENSIONS if extension.status != "no")
"""The extensions that a file may require."""
OF_MATERIALS = {
    extension.name: extension
    for extension in EXTENSIONS
    if extension.status != "no" and extension.name.startswith("KHR_materials_")
}
"""Those of materials that are read, here or where materials and their variants are."""
