"""Solari of Bevy 0.19: separate passes for direct, indirect and specular light (the setting lighting=split).

solari_vk/settings/solari019.py has their settings and the preset, glsl/passes/solari019/ the shaders. Sources: the
posts on Solari in Bevy 0.17, 0.18 and 0.19.
"""

from solari_vk.passes.solari019.stages import OUTPUTS, stages

__all__ = ["OUTPUTS", "stages"]
