"""What the loader does with each extension of glTF. docs/gltf.md shows this table, and a test compares the two."""

from __future__ import annotations

from typing import Literal, NamedTuple


class Extension(NamedTuple):
    """An extension, and how much of it is shown."""

    name: str
    status: Literal["works", "part", "no"]
    """Files that require an extension with "no" are refused; in other files it is reported and ignored."""
    remark: str


EXTENSIONS = (
    # Ratified by Khronos.
    Extension("KHR_animation_pointer", "part", "properties of nodes; those of materials, cameras and lights stay"),
    Extension("KHR_draco_mesh_compression", "works", "with the extra `formats`"),
    Extension("KHR_gaussian_splatting", "no", "splats have no surface"),
    Extension("KHR_interactivity", "no", "behavior graphs are ignored"),
    Extension("KHR_lights_punctual", "works", "a `range` of 0, which glTF forbids, is no limit; light above 1e15 cd or "
              "lux is dimmed to that; both are reported"),
    Extension("KHR_materials_anisotropy", "works", "needs tangents or uvs; glass and coats have none"),
    Extension("KHR_materials_clearcoat", "works", ""),
    Extension("KHR_materials_dispersion", "no", "all colors refract alike"),
    Extension("KHR_materials_emissive_strength", "works", ""),
    Extension("KHR_materials_ior", "works", "realtime: reflections seen straight on are at most 16 %"),
    Extension("KHR_materials_iridescence", "no", "the material has no thin film"),
    Extension("KHR_materials_sheen", "works", ""),
    Extension("KHR_materials_specular", "works", "factors of the color above 4 count as 4"),
    Extension("KHR_materials_transmission", "works", "shadow rays pass thin smooth glass only"),
    Extension("KHR_materials_unlit", "works", "black in mirrors; a color of 1 is 1.2 cd/m²"),
    Extension("KHR_materials_variants", "works", "`load_gltf(variant=)`, `scene.use_variant`, `--variant`"),
    Extension("KHR_materials_volume", "works", "meshes must be closed; thickness only says whether there is a volume"),
    Extension("KHR_mesh_quantization", "works", ""),
    Extension("KHR_node_hoverability", "no", "for interaction only"),
    Extension("KHR_node_selectability", "no", "for interaction only"),
    Extension("KHR_node_visibility", "works", ""),
    Extension("KHR_texture_basisu", "works", "with the extra `formats`"),
    Extension("KHR_texture_transform", "works", ""),
    Extension("KHR_xmp_json_ld", "works", "metadata, which pictures don't show"),
    # Drafts of Khronos.
    Extension("KHR_audio_emitter", "no", "sounds are ignored"),
    Extension("KHR_implicit_shapes", "no", "shapes are for physics"),
    Extension("KHR_materials_diffuse_transmission", "no", "the material is opaque"),
    Extension("KHR_materials_volume_scatter", "no", "volumes scatter no light"),
    Extension("KHR_meshopt_compression", "works", "with the extra `formats`"),
    Extension("KHR_physics_rigid_bodies", "no", "physics is ignored"),
    # Of several vendors.
    Extension("EXT_instance_features", "no", "identifiers of instances are ignored"),
    Extension("EXT_lights_ies", "no", "the lights are left out"),
    Extension("EXT_lights_image_based", "works", "the sharpest images of the cube light the scene"),
    Extension("EXT_mesh_features", "no", "identifiers of features are ignored"),
    Extension("EXT_mesh_gpu_instancing", "works", "attributes other than translation, rotation and scale are ignored"),
    Extension("EXT_mesh_manifold", "no", "information for solid modelling is ignored"),
    Extension("EXT_meshopt_compression", "works", "with the extra `formats`"),
    Extension("EXT_structural_metadata", "no", "metadata, which pictures don't show"),
    Extension("EXT_texture_avif", "no", "the texture's other image is used, if it has one"),
    Extension("EXT_texture_webp", "works", ""),
    # Of one vendor, and withdrawn ones.
    Extension("CESIUM_primitive_outline", "no", "outlines are not drawn"),
    Extension("GODOT_single_root", "no", "a hint for game engines"),
    Extension("KHR_materials_pbrSpecularGlossiness", "no", "withdrawn; its metallic-roughness values are used"),
    Extension("MSFT_lod", "no", "the most detailed level is shown"),
    Extension("MSFT_texture_dds", "no", "the texture's other image is used, if it has one"),
    Extension("VRMC_vrm", "no", "avatars are shown as any other model"),
)

SUPPORTED_EXTENSIONS = tuple(extension.name for extension in EXTENSIONS if extension.status != "no")
"""The extensions that a file may require."""
