"""Every constant of the realtime lighting, with its meaning, and the presets."""

from solari_vk.settings.presets import QUALITIES
from solari_vk.settings.settings import DEFAULTS, FIELDS, Settings, allowed

__all__ = ["DEFAULTS", "FIELDS", "QUALITIES", "Settings", "allowed"]
