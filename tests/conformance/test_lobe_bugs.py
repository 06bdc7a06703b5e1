"""The rules about glass, clearcoat, sheen and anisotropy fail with seeded bugs."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, marked

from solari_vk.conformance import material_lobe_checks as checks
from solari_vk.conformance.shader_runner import ShaderRunner


def by(measure, *arguments):
    """The measurement with shaders of its own, for a device."""

    def measured(device):
        with ShaderRunner(device) as shaders:
            yield from measure(shaders, *arguments)

    return measured


glass, layers = by(checks.measure_glass_furnace), by(checks.measure_layer_furnace)
draws, ways_back = by(checks.measure_lobe_draws, 200_000), by(checks.measure_lobe_reciprocity, 20_000)
GLASS, LAYERS, BRDF = (f"scene/{name}.glsl" for name in ("glass", "layers", "brdf"))
PREPARED = "scene/prepared_brdf.glsl"
REFRACTION, DRAWN = "refraction is reciprocal", "samples follow brdf_pdf: "
BUGS = {
    "refraction without eta^2": (ways_back, [REFRACTION], GLASS, "return square(glass.eta) * -dot", "return -dot"),
    "glass by the wrong albedo": (glass, ["inside of a solid"], PREPARED, "lookup_glass_table(glass.eta,",
                                  "lookup_glass_table(ior,"),
    "glass by the albedo of clear glass": (glass, ["outside of a solid"], PREPARED,
                                           "mix(vec3(ends.x), vec3(ends.y), glass.tint)", "vec3(ends.y)"),
    "anisotropic metal by the albedo of its mean roughness": (
        layers, ["keep most light: strongly anisotropic metal"], PREPARED, "if (lobes.anisotropy > 0.0) {",
        "if (false) {"),
    "a coat that takes nothing from its base": (layers, ["gain no light: a smooth coat"], BRDF,
                                                "* (1.0 - coat_cover(brdf.layers, wo, wi)));", ");"),
    "a coat that covers by one direction": (ways_back, ["a coat over a diffuse surface"], LAYERS,
                                            "float roughness = layers.coat_perceptual_roughness;",
                                            "float roughness = layers.coat_perceptual_roughness; wi_inside = true;"),
    "sheen that takes nothing from its base": (layers, ["gain no light: sheen"], BRDF,
                                               "value * ((1.0 - sheen_cover(brdf.layers, wo, wi)) *", "value * ("),
    "anisotropy turned the other way": (draws, [DRAWN + "anisotropic metal"], PREPARED,
                                        "return vec3(along * v.x + vec2(-along.y, along.x) * v.y, v.z);",
                                        "return vec3(along * v.x + vec2(along.y, -along.x) * v.y, v.z);"),
    "an anisotropic albedo without its bound": (layers, ["gain no light: a smooth anisotropic"], PREPARED,
                                                "ANISOTROPY_BOUND = vec2(0.38, 0.67)", "ANISOTROPY_BOUND = vec2(0.0)"),
}  # fmt: skip
QUICK = ("refraction without eta^2",)


@pytest.mark.parametrize("name", marked(BUGS, QUICK))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])
