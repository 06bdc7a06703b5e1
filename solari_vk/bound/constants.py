"""Numbers in the scene's records that mean something to shaders."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import constants

NO_INDEX = 0xFFFFFFFF
"""An index that points to nothing."""
MESH_HAS_NORMALS, MESH_HAS_UVS, MESH_HAS_TANGENTS, MESH_HAS_SECOND_UVS, MESH_HAS_COLORS = 1, 2, 4, 8, 16
"""Flags of a mesh record: which attributes its vertices have."""
MATERIAL_DOUBLE_SIDED = 1
"""The flag of a material record whose back side emits and is seen by the camera too."""
MATERIAL_MASK, MATERIAL_BLEND = 2, 4
"""Flags of a material record with such an alpha mode."""
MATERIAL_SOLID, MATERIAL_WALL = 8, 16
"""Flags of a material record that transmits light into a solid, and of thin glass that rays may pass straight."""
MATERIAL_UNLIT = 32
"""The flag of a material record whose emissive times its base color only cameras see."""
WITHOUT_BLEND, WITHOUT_DISPERSION = 1, 2
"""Flags of a world's lights: features of shaders that only other worlds have."""
SCENE_MASK, BLENDED_MASK = 0x7F, 0x40
"""The masks of rays through a scene, and through its blended instances alone: hidden ones have only the bit above."""


def glsl_header() -> str:
    """All of them, by the same names."""
    return constants(**{name: value for name, value in globals().items() if name.isupper()})
