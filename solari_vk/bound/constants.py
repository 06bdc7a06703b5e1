"""Numbers in the scene's records that mean something to shaders, and the record of a material."""

from __future__ import annotations

from dataclasses import fields

from solari_vk.gpu.shaders.headers import constants
from solari_vk.scene.material import TEXTURES, Material

# An index that points to nothing.
NO_INDEX = 0xFFFFFFFF

# Flags of a mesh record: which attributes its vertices have.
MESH_HAS_NORMALS = 1
MESH_HAS_UVS = 2
MESH_HAS_TANGENTS = 4
MESH_HAS_COLORS = 8
MESH_SMOOTH_NORMALS = 16  # triangles may have corners whose normals differ

# Flags of a material record.
MATERIAL_DOUBLE_SIDED = 1  # its back side emits too
MATERIAL_MASK = 2  # the alpha mode
MATERIAL_BLEND = 4  # the alpha mode
MATERIAL_SOLID = 8  # transmits light into a solid
MATERIAL_WALL = 16  # thin glass that rays may pass straight
MATERIAL_UNLIT = 32  # only cameras see its emissive times its base color
MATERIAL_HIDES_BACK = 64  # cameras look through its back side

# Flags of SceneInfo.absent_features: what no instance of a world's scene has had, though the shaders may have the code
# for it, because another world's scene has it. Such a world takes no random numbers for it, so that its pictures are
# those of its scene alone.
WITHOUT_BLEND = 1
WITHOUT_DISPERSION = 2

# Up to so many leaves of the tree of lights are sampled each by the path tracer.
FEW_LEAVES = 4

# The masks of rays through a scene, and through its blended instances alone, among which smooth thin-walled glass
# counts: `Instance.alpha_mode` of it is "blend". The bit above is that of hidden instances.
SCENE_MASK = 0x7F
BLENDED_MASK = 0x40

# `struct Material` of the shaders: the fields of `Material` that have a type in GLSL, by their own names. Textures are
# indices into `textures`, or NO_INDEX.
MATERIAL_FIELDS = {
    **{field.name: field.metadata["glsl"] for field in fields(Material) if field.metadata.get("glsl")},
    "absorption": "vec3",
    "flags": "uint",
}
# Those that are numbers: fields or properties of a Material.
MATERIAL_NUMBERS = tuple(name for name in MATERIAL_FIELDS if name not in TEXTURES and name != "flags")


def glsl_header() -> str:
    """All constants by the same names, and the struct."""
    numbers = {name: value for name, value in globals().items() if name.isupper() and isinstance(value, int)}
    struct = ["struct Material {", *(f"    {kind} {name};" for name, kind in MATERIAL_FIELDS.items()), "};"]
    return "\n".join([constants(**numbers), *struct])
