"""The live settings in shaders: a uniform block for each section, declared from the fields of `Settings`.

The field `di_candidates` of the section `restir_di` is `restir_di_settings.candidates` in shaders: the name of a field
without the prefix that its section's fields have in common. Choices are numbered in their order.
"""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import enumeration
from solari_vk.settings.settings import DEFAULTS, FIELDS, Settings

PREFIXES = {
    "paths": "paths_",
    "denoise": "denoise_",
    "restir": "restir_",
    "light_tiles": "light_tile_",
    "world_cache": "world_cache_",
    "restir_di": "di_",
    "restir_gi": "gi_",
    "specular_gi": "specular_",
}
# The host alone acts on these: what is built into pipelines, and the jitter, which moves the camera.
_OF_THE_HOST = {"jitter"} | {name for name, field in FIELDS.items() if field.rebuilds}


def _member(name: str) -> str:
    return name.removeprefix(PREFIXES.get(FIELDS[name].section, ""))


UNIFORMS = {name: f"{FIELDS[name].section}_settings.{_member(name)}" for name in FIELDS if name not in _OF_THE_HOST}
"""What shaders call each live setting: "block.field"."""


def glsl_header() -> str:
    """The uniform blocks, and constants for choices, such as `const uint DI_TARGET_MATTE = 1u;`."""
    # Numbers take 4 bytes each in the layout "scalar", switches and choices too: GLSL blocks have no bool.
    sections: dict[str, list[str]] = {}
    for name in UNIFORMS:
        kind = "float" if isinstance(DEFAULTS[name], float) else "uint"
        sections.setdefault(FIELDS[name].section, []).append(f"    {kind} {_member(name)};")
    blocks = [
        f"layout(set = 1, scalar) uniform {section.title().replace('_', '')}SettingsBlock {{\n"
        + "\n".join(members)
        + f"\n}} {section}_settings;"
        for section, members in sections.items()
    ]
    choices = [enumeration(name, FIELDS[name].choices) for name in UNIFORMS if FIELDS[name].choices]
    return "\n".join((*choices, *blocks))


def uniform_values(settings: Settings) -> dict[str, int | float]:
    """The values of all live settings by the names of UNIFORMS."""
    values = {}
    for name, uniform in UNIFORMS.items():
        value = getattr(settings, name)
        choices = FIELDS[name].choices
        values[uniform] = choices.index(value) if choices else value
    return values
