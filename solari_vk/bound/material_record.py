"""`struct Material` of the shaders: the fields of `Material` that have a type on the device, by their own names."""

from __future__ import annotations

from dataclasses import fields

from solari_vk.scene.material import TEXTURES, Material

TYPES = {
    **{field.name: kind for field in fields(Material) if (kind := field.metadata.get("glsl"))},
    "absorption": "vec3",
    "flags": "uint",
}
"""The members and their types in GLSL. Textures are indices into `textures`, or NO_INDEX."""
NUMBERS = tuple(name for name in TYPES if name not in TEXTURES and name != "flags")
"""The members that are fields or properties of a Material."""


def glsl_header() -> str:
    """The struct."""
    return "\n".join(("struct Material {", *(f"    {kind} {name};" for name, kind in TYPES.items()), "};"))
