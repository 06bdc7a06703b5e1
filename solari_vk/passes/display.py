"""The picture: what all passes found added up, and shown as it is or by a debug view; glsl/passes/display/."""

from __future__ import annotations

from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.settings import Settings

RAY_COUNTERS = 16  # rows for passes that count their rays: passes/ray_count.glsl
PARTS = ("emission", "diffuse_radiance", "specular_radiance", "radiance")

# The order is that of VIEW_* in glsl/passes/display/views.glsl.
VIEWS = {
    "picture": "The picture itself: radiance, exposed and tone mapped.",
    "di": "Direct light alone.",
    "gi": "Indirect light of the diffuse lobe alone.",
    "specular": "Specular GI alone; in smooth surfaces direct light is part of it.",
    "emission": "What is seen of lights themselves.",
    "diffuse_radiance": "All light of the diffuse lobe.",
    "specular_radiance": "All light of the specular lobe.",
    "base_color": "G-buffer: base colour.",
    "roughness": "G-buffer: perceptual roughness, black is smooth.",
    "metallic": "G-buffer: metallic, white is metal.",
    "reflectance": "G-buffer: reflectance of what is no metal.",
    "emissive": "G-buffer: what the surface emits.",
    "shading_normal": "G-buffer: shading normal, x, y, z as red, green, blue; grey is 0.",
    "geometric_normal": "G-buffer: the triangle's own normal, in the same colours.",
    "depth": "G-buffer: distance; the colours begin anew wherever it doubles.",
    "instance": "G-buffer: a colour for each instance.",
    "motion": "G-buffer: grey stands still, red moves to the right, green down, by up to 8 pixels.",
    "light_tiles": "The light tiles, one below the other, with the colours of their samples from left to right.",
    "cache_cells": "World cache: a colour for each surface's cell, or the first part of it; dark where is none.",
    "cache_irradiance": "World cache: what white paint would reflect by the cell's irradiance.",
    "cache_samples": "World cache: how many frames the cell has averaged, of those that it may.",
    "cache_life": "World cache: how many frames the cell has left to live, yellow for all.",
    "cache_lod": "World cache: how often the cells have doubled in size, yellow for 8 times.",
    "di_light": "ReSTIR DI: the chosen light, in its instance's colour; black for none.",
    "di_confidence": "ReSTIR DI: frames of history that the sample stands for, yellow for twice the cap.",
    "di_weight": "ReSTIR DI: unbiased contribution weight, by its logarithm, yellow for 4096.",
    "di_visibility": "ReSTIR DI: white where the chosen light is seen, dark where it is hidden, black for none.",
    "di_neighbor": "ReSTIR DI: red where no similar neighbour was found.",
    "gi_radiance": "ReSTIR GI: radiance of the chosen sample.",
    "gi_confidence": "ReSTIR GI: frames of history that the sample stands for, yellow for twice the cap.",
    "gi_weight": "ReSTIR GI: unbiased contribution weight, green for that of an even choice, twice as much is yellow.",
    "guide_diffuse_albedo": "Guides: diffuse albedo, of what a mirror shows.",
    "guide_specular_albedo": "Guides: specular albedo, of what a mirror shows.",
    "guide_normal": "Guides: normal, of what a mirror shows.",
    "guide_roughness": "Guides: roughness, of what a mirror shows.",
    "guide_depth": "Guides: distance of where things in a mirror seem to be, in the colours of depth.",
    "guide_specular_motion": "Guides: motion of what a mirror shows, in the colours of motion.",
}


def stage(size: tuple[int, int], settings: Settings) -> Stage:
    """Radiance before exposure, in parts and as a whole, and `display`, 8 bits in sRGB."""
    pixels = size[0] * size[1]
    return Stage(
        "display",
        buffers=dict.fromkeys(PARTS, pixels) | {"ray_counts": RAY_COUNTERS},
        images={"display": size},
        passes=[Pass("display/compose", threads=size), Pass("display/show", threads=size)],
    )
