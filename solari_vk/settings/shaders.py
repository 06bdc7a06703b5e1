"""The settings as the shaders know them."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import enumeration
from solari_vk.settings.settings import FIELDS


def glsl_header() -> str:
    """The choices of every setting that has some, such as `const uint DI_TARGET_MATTE = 1u;`."""
    return "\n".join(enumeration(name, field.choices) for name, field in FIELDS.items() if field.choices)
