"""Debug views of the separate passes; glsl/passes/solari019/debug_views.glsl has their functions."""

from __future__ import annotations

from solari_vk.passes.view_group import IF_SURFACE, ViewGroup

GROUPS = (
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
