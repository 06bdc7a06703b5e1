"""Alias tables against their weights: by the thresholds themselves, and by drawing."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy import stats

from solari_vk.bound.lights.alias_table import alias_table
from solari_vk.bound.lights.light_list import EQUAL_SHARE, choice_weights

CHOICE = np.dtype([("threshold", "<u4"), ("alias", "<u4"), ("probability", "<f4")])
EXTREMES = {
    "one": [5.0],
    "dark": [0.0, 0.0, 0.0],
    "equal": [0.1] * 7,
    "all but one dark": [0.0, 0.0, 3.0, 0.0],
    "1e30 and 1e-10": [1e30, 1e-10, 1e-10],
    "overflowing sum": [1e300] * 5,
    "one strong": [1e-10] * 9 + [1e30],
}


def check(weights):
    """The table, whose probabilities must be exact for its thresholds and right for the weights."""
    weights = np.asarray(weights, np.float64)
    count = len(weights)
    table = alias_table(weights, CHOICE)
    kept = table["threshold"] / 2.0**32
    chosen = np.zeros(count)
    np.add.at(chosen, np.arange(count), kept / count)
    np.add.at(chosen, table["alias"], (1 - kept) / count)
    np.testing.assert_allclose(table["probability"], chosen, rtol=2e-7)
    if weights.max() == 0:
        weights = np.ones(count)
    assert ((table["probability"] > 0) == (weights > 0)).all()
    assert (table["threshold"][weights == 0] == 0).all()
    shares = weights / weights.max()
    np.testing.assert_allclose(table["probability"], shares / shares.sum(), rtol=3e-7, atol=2.0**-31)
    return table


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_weights(name):
    check(EXTREMES[name])


@pytest.mark.parametrize("seed", range(200))
def test_random_weights(seed):
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 60)
    check([rng.random(count), rng.integers(0, 3, count), 10 ** rng.normal(0, 9, count), 1.0 - rng.random(count) ** 8]
          [seed % 4])  # fmt: skip


def test_no_rows():
    assert len(alias_table(np.zeros(0), CHOICE)) == 0


def test_draws_have_the_weights():
    rng = np.random.default_rng(3)
    weights = rng.random(50) ** 4
    table = check(weights)
    rows = rng.integers(0, 50, 1_000_000)
    random = rng.integers(0, 2**32, len(rows))
    drawn = np.where(random < table["threshold"][rows], rows, table["alias"][rows])
    expected = len(rows) * weights / weights.sum()
    assert stats.chisquare(np.bincount(drawn, minlength=50), expected).pvalue > 1e-3


def test_a_million_rows_take_seconds():
    rng = np.random.default_rng(4)
    for weights in (rng.random(1_000_000), 10 ** rng.normal(0, 5, 1_000_000)):
        start = time.process_time()
        table = alias_table(weights, CHOICE)
        assert time.process_time() - start < 3
        assert (table["probability"] > 0).all()


def test_lights_are_weighted_by_power_with_a_share_for_all():
    powers = np.array([1.0, 0.0, 3.0])
    expected = (1 - EQUAL_SHARE) * powers / 4 + EQUAL_SHARE * np.array([0.5, 0.0, 0.5])
    np.testing.assert_allclose(choice_weights(powers), expected)
    assert (choice_weights(np.zeros(3)) == 0).all()
    assert len(choice_weights(np.zeros(0))) == 0
    huge = choice_weights(np.array([1e30, 1e-10, 1e308, 1e308]))
    assert np.isfinite(huge).all()
    assert huge.min() > 0.9 * EQUAL_SHARE / 4
