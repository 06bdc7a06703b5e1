"""The rules about light that pixels reuse can fail: a seeded bug for each."""

from __future__ import annotations

import pytest
from seeded_bugs import expect_noticed, failing, marked, rules_broken_by, rules_of

from solari_vk.conformance import reuse_checks
from solari_vk.conformance.realtime import Effort
from solari_vk.scene.builtin import cornell_box

RESERVOIR, REUSE = "passes/paths/reservoir.glsl", "passes/reuse.glsl"
# Reservoirs keep samples for long and take them from afar, so that bugs add up.
STRESS = {"restir_confidence_cap": 30.0, "spatial_radius_halving": False, "restir_radius": 12.0}


def means(device):
    return reuse_checks.measure_means(device, Effort(16, 16, 12, 4096), cornell_box(), 0.06, **STRESS)


noise, lag = reuse_checks.measure_noise, reuse_checks.measure_lag
MEAN, TILES, NOISE, LAG = (rule.name for rule in (reuse_checks.REUSED, reuse_checks.REUSED_TILES,
                                                  reuse_checks.LESS_NOISE, reuse_checks.NO_LAG))  # fmt: skip
BUGS = {
    "no Jacobian": (means, [TILES], RESERVOIR, "<= MAX_JACOBIAN ? jacobian : 0.0", "<= MAX_JACOBIAN ? 1.0 : 0.0"),
    "MIS weights without visibility": (means, [MEAN, TILES], RESERVOIR, "if (own_share < 1.0 && !is_visible(",
                                       "if (false && !is_visible("),
    "hidden samples": (means, [MEAN, TILES], RESERVOIR, "= transmittance(here, other, false);", "= vec3(1.0);"),
    "normals of hits on the wrong side": (noise, [NOISE], RESERVOIR, "return unpack_octahedral_2x16(reservoir",
                                          "return -unpack_octahedral_2x16(reservoir"),
    "visibility of the previous frame in this one": (lag, [LAG], RESERVOIR, "if (in_previous_frame) {",
                                                     "if (false) {"),
}  # fmt: skip
QUICK = ("no Jacobian",)


def test_every_rule_has_a_bug():
    assert rules_of(reuse_checks) == rules_broken_by(BUGS)


@pytest.mark.parametrize("name", marked(BUGS, QUICK))
def test_bug_is_noticed(device, name):
    expect_noticed(device, BUGS[name])


@pytest.mark.slow
def test_stressed_reservoirs_hold_without_a_bug(device):
    """The control of the bugs."""
    assert not failing(means(device))
