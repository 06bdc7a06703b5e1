"""The rules about point lights, spotlights and sphere lights fail with seeded bugs."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, marked

from solari_vk.conformance import punctual_checks

PUNCTUAL, POINT, SPHERE = (f"scene/lights/{name}.glsl" for name in ("punctual", "point", "sphere"))
SAMPLING = "scene/sampling.glsl"


def over_floor(name, strategy="mis"):
    return lambda device: punctual_checks.measure_floor(device, name, strategy)


point, spot, sphere = (over_floor(f"a {name}") for name in ("point light", "spotlight", "sphere light"))
MEAN, TILES = "floor, mis: mean", "floor, mis: tiles"
SEEN, CIRCLE = punctual_checks.SEEN.name, punctual_checks.CIRCLE.name
BUGS = {
    "a point weighted against rays": (point, [MEAN, TILES], SAMPLING, "is_met_by_rays(light_sample.kind) ? solid",
                                      "true ? solid"),
    "a range without effect": (over_floor("a point light with a range"), [MEAN, TILES], PUNCTUAL,
                               "square(cone) * window", "square(cone)"),
    "a cone that isn't squared": (spot, [MEAN, TILES], PUNCTUAL, "square(cone) * window", "cone * window"),
    "a hard edge that is soft": (over_floor("a spotlight with a hard edge"), [TILES], PUNCTUAL,
                                 "direction) * light.cone_scale + light.cone_offset",
                                 "direction) * 0.1 * light.cone_scale + 0.1 * light.cone_offset"),
    "a cone twice as dense": (over_floor("a sphere light", "nee"), ["nee: mean"], SPHERE,
                              "2.0 * PI * cone.one_minus_cos * square", "PI * cone.one_minus_cos * square"),
    "a density that hits don't know": (sphere, [MEAN], SPHERE, "cone.falloff, 2.0 * PI", "cone.falloff, 40.0 * PI"),
    "a cone as wide as the sine squared": (
        over_floor("a sphere light", "nee"), ["nee: mean"], SPHERE,
        "squared_sine / (1.0 + sqrt(1.0 - squared_sine))", "squared_sine"),
    "rays don't see spheres": (over_floor("a sphere light", "brdf"), ["brdf: mean"], "passes/pathtracer/trace.comp",
                               "radiance += throughput * trace_radiance", "vec3 unused = trace_radiance"),
    "a spot with a radius is no spot to rays": (
        over_floor("a spotlight with a radius", "brdf"), ["radius over a floor, brdf: mean"], SPHERE,
        "MetLight(light.strength * cone.falloff", "MetLight(light.strength"),
    "points are dim": (punctual_checks.measure_several, ["six lamps over a floor: mean"], POINT,
                       "float cosine) { return 1.0; }", "float cosine) { return 0.9; }"),
    "a sphere's radiance by its whole area": (punctual_checks.measure_seen, [SEEN], SPHERE,
                                              "MetLight(light.strength", "MetLight(0.25 * light.strength"),
    "a sphere seen too large": (punctual_checks.measure_seen, [CIRCLE], SPHERE, "if (!(one_minus_cos < cone",
                                "if (!(0.9 * one_minus_cos < cone"),
}  # fmt: skip
QUICK = ("a cone that isn't squared", "a density that hits don't know", "a sphere seen too large")


@pytest.mark.parametrize("name", marked(BUGS, QUICK))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])
