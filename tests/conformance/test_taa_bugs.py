"""The rules about antialiasing can fail: seeded bugs in each part of it."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, marked, rules_broken_by, rules_of

from solari_vk.conformance import taa_checks as checks

FOLDER = "passes/taa/"
RESOLVE, SAMPLES, HISTORY = f"{FOLDER}resolve.comp", f"{FOLDER}samples.glsl", f"{FOLDER}history.glsl"
EVEN, AREA, UPSCALED, SHARP, FOLLOWED, NOISE, NOT_FINITE = (
    rule.name for rule in (checks.EVEN, checks.AREA, checks.UPSCALED, checks.SHARP, checks.FOLLOWED, checks.NOISE,
                           checks.NOT_FINITE))  # fmt: skip
BUGS = {
    "weights that don't sum to 1": (checks.measure_even_light, [EVEN], SAMPLES,
                                    "Found(clamp(sum / total, low, high), true)", "Found(0.9 * sum / total, true)"),
    "jitter the wrong way": (checks.measure_areas, [UPSCALED], SAMPLES, "- 0.5 - this_frame.sample_offset",
                             "- 0.5 + this_frame.sample_offset"),
    "the latest sample alone": (checks.measure_areas, [AREA, UPSCALED], RESOLVE,
                                "share = 1.0 - square(past.weight / total);", "share = 1.0;"),
    "interpolated samples beside enough others": (checks.measure_areas, [UPSCALED], RESOLVE,
                                                  "settled ? NOTHING_FOUND :", "false ? NOTHING_FOUND :"),
    "still pictures limited as moving ones": (checks.measure_areas, [AREA], RESOLVE,
                                              "if (!gone && is_still(around.center)) {",
                                              "if (false) {"),
    "no motion": (checks.measure_motion, [SHARP], HISTORY, "position = vec2(at) + 0.5 + motion;",
                  "position = vec2(at) + 0.5;"),
    "nearest pixels": (checks.measure_motion, [SHARP], HISTORY, "vec2 share = position - 0.5 - vec2(corner);",
                       "vec2 share = round(position - 0.5 - vec2(corner));"),
    "nothing is limited": (checks.measure_changes, [FOLLOWED], RESOLVE, "!(outside > SUSPECT)", "true"),
    "short means": (checks.measure_noise, [NOISE], HISTORY, "const float LONGEST = 63.0;",
                    "const float LONGEST = 31.0;"),
    "what isn't finite counts": (checks.measure_not_finite, [NOT_FINITE], "common/math.glsl",
                                 "return !any(isnan(color)) && !any(isinf(color));", "return true;"),
}  # fmt: skip


def test_every_rule_has_a_bug():
    assert rules_of(checks) == rules_broken_by(BUGS)


@pytest.mark.parametrize("name", marked(BUGS, tuple(BUGS)))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])
