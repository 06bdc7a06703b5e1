"""Debug views: their names, what they show, and the GLSL that computes each one's color.

To add a view, add a row here. A color that takes more than an expression is a function in
glsl/passes/display/debug_views.glsl.
"""

from __future__ import annotations

from dataclasses import dataclass

from solari_vk.base.errors import SolariError, is_name, unknown_name

PICTURE = "picture"


@dataclass(frozen=True)
class ViewGroup:
    """Views of one part of the frame.

    views: for each name what the view shows, and a GLSL expression of type vec3 for the sRGB color of a pixel. The
    expression knows `uvec2 pixel`, `ivec2 at` (the same), `uint index` (of the pixel in buffers) and
    `GBufferSurface surface`, and what `setup`, statements that run first, declares. lighting: the one that has these
    views, by its name in `Settings`; empty for views that every lighting has.
    """

    title: str
    setup: str
    views: dict[str, tuple[str, str]]
    lighting: str = ""


IF_SURFACE = "if (!surface.exists) { return NOTHING; }"
"""A setup for views of surfaces alone."""

# The separate passes of Solari; glsl/passes/solari019/debug_views.glsl has the functions.
_SOLARI019 = (
    ViewGroup(
        "",
        "",
        {
            "di": ("Direct light.", "show_radiance(di_diffuse.at[index] + di_specular.at[index])"),
            "gi": ("Indirect light of the diffuse lobe.", "show_radiance(gi_diffuse.at[index])"),
            "specular": (
                "Indirect light of the specular lobe; on smooth surfaces with the direct light.",
                "show_radiance(specular_gi.at[index])",
            ),
        },
        "split",
    ),
    ViewGroup(
        "Light tiles",
        "",
        {
            "light_tiles": (
                "one tile below the other, with the colors of its samples from left to right.",
                "show_light_tiles(pixel)",
            )
        },
        "split",
    ),
    ViewGroup(
        "ReSTIR DI",
        f"{IF_SURFACE} DiReservoir reservoir = di_reservoirs.at[index]; "
        "bool found = reservoir.light_sample.light_index != NO_INDEX;",
        {
            "di_light": (
                "the chosen light, in its instance's color; black for none.",
                "found ? show_light(reservoir.light_sample.light_index) : NOTHING",
            ),
            "di_confidence": (
                "number of frames that the sample stands for, yellow for twice the cap.",
                "show_share(reservoir.confidence / (2.0 * restir_di_settings.confidence_cap))",
            ),
            "di_weight": (
                "unbiased contribution weight on a logarithmic scale, yellow for 4096.",
                "found ? show_share(log2(1.0 + reservoir.unbiased_contribution_weight) / 12.0) : NOTHING",
            ),
            "di_visibility": (
                "white where the chosen light is visible, dark where it is occluded, black for none.",
                "found ? vec3(di_outcomes.at[index].y != 0u ? 1.0 : 0.25) : NOTHING",
            ),
            "di_neighbor": (
                "red where no similar neighbor was found.",
                "di_outcomes.at[index].x == NO_INDEX ? ALARM : vec3(0.5)",
            ),
        },
        "split",
    ),
    ViewGroup(
        "ReSTIR GI",
        f"{IF_SURFACE} GiReservoir reservoir = gi_reservoirs.at[index];",
        {
            "gi_radiance": ("radiance of the chosen sample.", "show_radiance(reservoir.radiance)"),
            "gi_confidence": (
                "number of frames that the sample stands for, yellow for twice the cap.",
                "show_share(reservoir.confidence_weight / (2.0 * restir_gi_settings.confidence_cap))",
            ),
            "gi_weight": (
                "unbiased contribution weight; green for that of uniform sampling, yellow for twice as much.",
                "show_share(reservoir.unbiased_contribution_weight / (4.0 * PI))",
            ),
        },
        "split",
    ),
)

_GROUPS = (
    ViewGroup(
        "Demodulated",
        "",
        {
            "paths_diffuse": (
                "light of the diffuse lobe on a white surface.",
                "show_radiance(paths_diffuse.at[index].rgb)",
            ),
            "paths_specular": (
                "light of the specular lobe on a white surface.",
                "show_radiance(paths_specular.at[index].rgb)",
            ),
            "paths_distance": (
                "length of the first ray; the colors repeat each time it doubles, black for rays that met nothing.",
                "show_distance(max(paths_diffuse.at[index].w, paths_specular.at[index].w))",
            ),
        },
    ),
    ViewGroup(
        "Denoiser",
        "",
        {
            "denoise_frames": (
                "number of frames that the diffuse light averages, yellow for the maximum.",
                "show_share(history_length(index) / float(denoise_settings.max_history))",
            ),
            "denoise_frames_specular": (
                "the same of the specular light.",
                "show_share(specular_history_length(index) / float(denoise_settings.max_history))",
            ),
            "denoise_noise": (
                "standard error of the diffuse light before the blur over its mean, yellow for 1.",
                "show_share(history_relative_error(index))",
            ),
            "denoise_error": (
                "estimated standard error of the denoised luminance over it, yellow for 25 %.",
                "show_share(4.0 * error.at[index] / max(luminance(sample_radiance.at[index]), 1e-30))",
            ),
        },
    ),
    ViewGroup(
        "",
        "",
        {
            "emission": ("The light that lights themselves send to the camera.", "show_radiance(emission.at[index])"),
            "diffuse_radiance": ("All light of the diffuse lobe.", "show_radiance(diffuse_radiance.at[index])"),
            "specular_radiance": ("All light of the specular lobe.", "show_radiance(specular_radiance.at[index])"),
        },
    ),
    ViewGroup(
        "G-buffer",
        "",
        {
            "base_color": ("base color.", "encode_srgb(surface.material.base.color)"),
            "roughness": ("perceptual roughness, black is smooth.", "vec3(surface.material.base.perceptual_roughness)"),
            "metallic": ("metallic, white is metal.", "vec3(surface.material.base.metallic)"),
            "reflectance": ("reflectance of dielectrics.", "surface.material.base.reflectance"),
            "emissive": ("the radiance that the surface emits.", "show_radiance(surface.material.emissive)"),
        },
    ),
    ViewGroup(
        "G-buffer",
        IF_SURFACE,
        {
            "shading_normal": (
                "shading normal, x, y, z as red, green, blue; gray is 0.",
                "show_direction(surface.world_normal)",
            ),
            "geometric_normal": (
                "the triangle's own normal, in the same colors.",
                "show_direction(surface.geometric_world_normal)",
            ),
            "depth": ("distance; the colors repeat each time it doubles.", "show_depth(imageLoad(depth, at).x)"),
            "instance": ("a color for each instance.", "show_number(instances.at[surface.instance].id)"),
            "motion": (
                "motion; gray is at rest, red moves to the right, green down, by up to 8 pixels.",
                "show_motion(imageLoad(motion_vectors, at).xy)",
            ),
        },
    ),
    ViewGroup(
        "World cache",
        f"{IF_SURFACE} ShownCell shown = find_shown_cell(pixel, surface);",
        {
            "cache_cells": (
                "a color for each cell; dark where the cache has no cell.",
                "show_number(shown.checksum) * (shown.exists ? 1.0 : 0.2)",
            ),
            "cache_lod": (
                "cell size; yellow for the smallest size doubled 8 times.",
                "show_share(log2(shown.size / world_cache_settings.cell_size) / 8.0)",
            ),
            "cache_irradiance": (
                "the radiance that a white surface would reflect of the cell's irradiance.",
                "show_radiance(INVERSE_PI * shown.irradiance)",
            ),
            "cache_samples": (
                "number of frames that the cell has averaged, yellow for the maximum.",
                "shown.exists ? show_share(shown.sample_count / float(world_cache_settings.max_samples)) : NOTHING",
            ),
            "cache_life": (
                "number of frames until the cell is deleted unless a ray asks for it, yellow for the maximum.",
                "shown.exists ? show_share(float(shown.life) / float(world_cache_settings.lifetime)) : NOTHING",
            ),
        },
    ),
    ViewGroup(
        "Guides",
        "",
        {
            "guide_diffuse_albedo": ("diffuse albedo.", "encode_srgb(imageLoad(guides_diffuse_albedo, at).rgb)"),
            "guide_specular_albedo": ("specular albedo.", "encode_srgb(imageLoad(guides_specular_albedo, at).rgb)"),
            "guide_normal": (
                "normal.",
                "surface.exists ? show_direction(imageLoad(guides_normal_roughness, at).xyz) : NOTHING",
            ),
            "guide_roughness": ("roughness.", "vec3(imageLoad(guides_normal_roughness, at).w)"),
            "guide_depth": ("distance, in the colors of depth.", "show_depth(imageLoad(guides_depth, at).x)"),
            "guide_specular_motion": (
                "motion, in the colors of motion.",
                "show_motion(imageLoad(guides_specular_motion, at).xy)",
            ),
        },
    ),
    *_SOLARI019,
)


def _meanings() -> dict[str, str]:
    meanings = {PICTURE: "The picture itself: radiance, exposed and tone mapped."}
    for group in _GROUPS:
        title = f"{group.title}: " if group.title else ""
        need = f" Needs lighting={group.lighting}." if group.lighting else ""
        for name, (meaning, _) in group.views.items():
            meanings[name] = f"{title}{meaning}{need}"
    return meanings


DEBUG_VIEWS = _meanings()
"""The meaning of each view by its name. The uniform `debug_view` is an index into it."""
_LIGHTINGS = {name: group.lighting for group in _GROUPS for name in group.views}


def views_of(lighting: str) -> tuple[str, ...]:
    """The names of the views that a lighting has."""
    return tuple(name for name in DEBUG_VIEWS if _LIGHTINGS.get(name, "") in ("", lighting))


def check_view(name: str, lighting: str) -> None:
    """Raise SolariError unless the lighting has this view."""
    if not is_name(name, DEBUG_VIEWS):
        raise unknown_name("there is no view", name, views_of(lighting))
    if name not in views_of(lighting):
        raise SolariError(f"the view '{name}' needs the setting lighting={_LIGHTINGS[name]}, not {lighting}")


def glsl_header() -> str:
    """`generated/passes/debug_views.glsl`: the function show_debug_view(view, pixel)."""
    numbers = {name: index for index, name in enumerate(DEBUG_VIEWS)}
    # A switch over groups, in each of which its setup runs once, and a switch over the views of the group.
    groups = []
    for group in _GROUPS:
        labels = " ".join(f"case {numbers[name]}u:" for name in group.views)
        views = "\n".join(f"case {numbers[name]}u: return {color};" for name, (_, color) in group.views.items())
        text = f"{labels} {{\n{group.setup}\nswitch (view) {{\n{views}\n}}\n}}"
        if group.lighting:  # the other lightings' shaders don't declare what these views read
            text = f"#ifdef LIGHTING_{group.lighting.upper()}\n{text}\n#endif"
        groups.append(text)
    return (
        "vec3 show_debug_view(uint view, uvec2 pixel) {\n"
        "ivec2 at = ivec2(pixel);\n"
        "uint index = pixel_index(pixel, camera.size);\n"
        "GBufferSurface surface = load_gbuffer(pixel);\n"
        "switch (view) {\n" + "\n".join(groups) + "\n}\nreturn NOTHING;\n}"
    )
