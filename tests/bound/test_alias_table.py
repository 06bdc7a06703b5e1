"""Alias tables against their weights, by the thresholds themselves, and the weights of lights."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from solari_vk.bound.lights.alias_table import alias_table, alias_tables
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.bound.lights.light_leaves import EQUAL_SHARE, PORTAL_SHARE, choice_weights, choice_weights_by_kind

CHOICE = np.dtype([("threshold", "<u4"), ("alias", "<u4"), ("probability", "<f4")])
WEIGHTS = st.just(0.0) | st.floats(1e-30, 1e30) | st.floats(0.5, 1)


@given(st.lists(WEIGHTS, min_size=1, max_size=60))
@example([1e300] * 5)
def test_probabilities_are_those_of_the_thresholds_and_of_the_weights(weights):
    weights = np.array(weights)
    count, table = len(weights), alias_table(weights, CHOICE)
    kept = table["threshold"] / 2.0**32
    chosen = kept / count + np.bincount(table["alias"], (1 - kept) / count, count)
    np.testing.assert_allclose(table["probability"], chosen, rtol=2e-7)
    if weights.max() == 0:
        weights = np.ones(count)
    assert ((table["probability"] > 0) == (weights > 0)).all()
    assert (table["threshold"][weights == 0] == 0).all()
    shares = weights / weights.max()
    np.testing.assert_allclose(table["probability"], shares / shares.sum(), rtol=3e-7, atol=2.0**-31)


@given(st.lists(st.lists(WEIGHTS, min_size=1, max_size=9), min_size=1, max_size=12))
def test_several_tables_at_once_are_those_of_each(tables):
    starts = np.cumsum([0, *map(len, tables[:-1])])
    found = alias_tables(np.concatenate(tables), starts, CHOICE)
    for start, weights in zip(starts, tables, strict=True):
        rows = found[start : start + len(weights)].copy()
        assert ((rows["alias"] >= start) & (rows["alias"] < start + len(weights))).all()
        expected = alias_table(np.array(weights), CHOICE)["probability"]
        np.testing.assert_allclose(rows["probability"], expected, rtol=3e-7, atol=2.0**-31)


def test_sizes():
    assert len(alias_table(np.zeros(0), CHOICE)) == 0
    assert len(alias_tables(np.zeros(0), np.zeros(0, np.int64), CHOICE)) == 0
    many = 10 ** np.random.default_rng(4).normal(0, 5, 300_000)
    assert (alias_table(many, CHOICE)["probability"] > 0).all()
    starts = np.arange(0, 300_000, 16)
    found = alias_tables(many, starts, CHOICE)
    assert (found["alias"] // 16 == np.arange(300_000) // 16).all()
    np.testing.assert_allclose(np.add.reduceat(found["probability"], starts), 1, rtol=1e-5)


def test_lights_are_weighted_by_power_with_a_share_for_all():
    powers = np.array([1.0, 0.0, 3.0])
    expected = (1 - EQUAL_SHARE) * powers / 4 + EQUAL_SHARE * np.array([0.5, 0.0, 0.5])
    np.testing.assert_allclose(choice_weights(powers), expected)
    assert (choice_weights(np.zeros(3)) == 0).all()
    assert len(choice_weights(np.zeros(0))) == 0
    huge = choice_weights(np.array([1e30, 1e-10, 1e308, 1e308]))
    assert np.isfinite(huge).all()
    assert huge.min() > 0.9 * EQUAL_SHARE / 4


def test_portals_take_half_of_what_environments_have():
    """All other lights are taken as often as without portals."""
    names = ("emissive_mesh", "portal", "portal", "directional", "environment")
    kinds = np.array([KIND_INDEX[name] for name in names], np.uint32)
    powers = np.array([1.0, 2.0, 6.0, 1e5, 1e4])
    found, plain = choice_weights_by_kind(powers, kinds), choice_weights(powers[[0, 3, 4]])
    np.testing.assert_allclose(found[[0, 3, 4]], plain * (1, 1, 1 - PORTAL_SHARE))
    np.testing.assert_allclose(found[1:3], PORTAL_SHARE * plain[2] * np.array([0.25, 0.75]))
    dark = choice_weights_by_kind(np.array([1.0, 0.0]), kinds[:2])
    np.testing.assert_allclose(dark, [1, 0])
