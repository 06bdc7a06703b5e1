"""The rules about the denoiser can fail: seeded bugs in each of its passes."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, marked, rules_broken_by, rules_of

from solari_vk.conformance import denoise_checks as checks

FOLDER = "passes/denoise/"
PAST, LIKENESS = f"{FOLDER}past.glsl", f"{FOLDER}likeness.glsl"
MATH = "common/math.glsl"
ACCUMULATE, VARIANCE, BLUR, TEMPORAL = (
    f"{FOLDER}{name}.comp" for name in ("accumulate", "variance", "blur", "temporal")
)
SUMS, CHANGES, COMPOSE = f"{FOLDER}sum_cells.comp", f"{FOLDER}find_changes.comp", "passes/paths/compose.comp"
EVEN, ERROR, RETURNED, FOUND, NEW, SHARP, FORGOTTEN, NOT_FINITE, EDGES, TURNS, KEPT = (rule.name for rule in (
    checks.EVEN, checks.ERROR, checks.RETURNED, checks.FOUND, checks.NEW, checks.SHARP, checks.FORGOTTEN,
    checks.NOT_FINITE, checks.EDGES, checks.TURNS, checks.KEPT))  # fmt: skip
BUGS = {
    "motion the wrong way": (checks.measure_motion, [FOUND, SHARP], PAST, "in_pixels(motion_vector(",
                             "in_pixels(-motion_vector("),
    "history of what was at the border": (checks.measure_motion, [NEW], PAST,
                                          "|| !is_inside(pixel)) { return; }", "|| any(lessThan(pixel, ivec2(0)))) "
                                          "{ return; }\n    pixel = min(pixel, ivec2(camera.size) - 1);"),
    "nearest pixels": (checks.measure_motion, [SHARP], PAST, "vec2 share = where - 0.5 - vec2(corner);",
                       "vec2 share = round(where - 0.5 - vec2(corner));"),
    "sums without this frame": (checks.measure_light_off, [FORGOTTEN], SUMS, "sum.total += value - mean;", ""),
    "all histories trusted": (checks.measure_light_off, [FORGOTTEN], CHANGES,
                              "return pow(1.0 - certain * min(abs(sum.total)", "return 1.0; //"),
    "histories trusted when light changed": (checks.measure_light_off, [FORGOTTEN], ACCUMULATE,
                                             "past.frames * confidence", "past.frames"),
    "short means": (checks.measure_even_light, [EVEN], ACCUMULATE, "float weight = 1.0 / (past.frames + 1.0);",
                    "float weight = max(1.0 / (past.frames + 1.0), 0.5);"),
    "what isn't finite counts": (checks.measure_not_finite, [NOT_FINITE], MATH,
                                 "return !any(isnan(color)) && !any(isinf(color));", "return true;"),
    "outliers limited for good": (checks.measure_outliers, [RETURNED], VARIANCE,
                                  "if (value > limit && limit > 0.0 && alike > ALIKE && lobe.frames < settled) {",
                                  "limit = 2.0 * others;\n    if (value > limit) {"),
    "variance of a frame": (checks.measure_even_light, [ERROR], VARIANCE, "of_sample / lobe.frames", "of_sample"),
    "outliers pass on nothing": (checks.measure_even_light, [EVEN], BLUR,
                                 "+ other.deviation * other.deviation;", "+ center.deviation * center.deviation;"),
    "no blur": (checks.measure_even_light, [EVEN], BLUR, "weight *= share * share;", "weight = 0.0;"),
    "light of filtered pixels taken": (checks.measure_outliers, [RETURNED], BLUR, "is_filtered ? 0.0 :", ""),
    "noise of all pixels alike": (checks.measure_even_light, [ERROR], BLUR, "CORRELATION[min(level, 2u)]);", "1.0);"),
    "blur across depths": (checks.measure_edges, [EDGES], LIKENESS, "exp(-(off + dot(", "exp(-(dot("),
    "blur around corners": (checks.measure_edges, [EDGES], LIKENESS,
                            "exp(-(off + dot(turned, turned) * pattern.normal_sharpness",
                            "exp(-(min(off, 0.1) + 0.0 * pattern.normal_sharpness"),
    "second surfaces forgotten": (checks.measure_turns, [TURNS], TEMPORAL,
                                  "if (returns) { unpack_aside(aside, diffuse, specular); }", ""),
    "second surfaces never forget": (checks.measure_turns, [FORGOTTEN], ACCUMULATE,
                                     "{ shorten_aside(index, min(confidence.x, confidence.y)); }", "{}"),
    "variance for error": (checks.measure_even_light, [ERROR], COMPOSE, "length(deviations * ",
                           "length(deviations * deviations * "),
    "histories of reflections lose light": (checks.measure_smooth_surfaces, [KEPT], TEMPORAL,
                                            "Lobe by_reflection = read_specular(at_reflection);",
                                            "Lobe by_reflection = read_specular(at_reflection);\n"
                                            "    by_reflection.radiance *= 0.9;"),
}  # fmt: skip


def test_every_rule_has_a_bug():
    assert rules_of(checks) == rules_broken_by(BUGS)


@pytest.mark.parametrize("name", marked(BUGS, tuple(BUGS)))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])
