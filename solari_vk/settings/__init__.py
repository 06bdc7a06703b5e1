"""Every constant of the realtime lighting, with its meaning, and the presets."""

from solari_vk.settings.presets import QUALITIES, RAW
from solari_vk.settings.settings import DEFAULTS, FIELDS, Settings, allowed
from solari_vk.settings.shaders import glsl_header, uniform_values

__all__ = ["DEFAULTS", "FIELDS", "QUALITIES", "RAW", "Settings", "allowed", "glsl_header", "uniform_values"]
