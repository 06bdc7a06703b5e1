"""The spatial order is a permutation that keeps neighbors together, for any points."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.bound.spatial_order import spatial_order


def spread(points, run=16):
    """The mean extent of runs of `run` consecutive points."""
    whole = points[: len(points) // run * run].reshape(-1, run, 3)
    return np.ptp(whole, axis=1).max(axis=1).mean()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 16, 17, 1000, 4097])
def test_it_is_a_permutation(count):
    points = np.random.default_rng(count).normal(size=(count, 3))
    np.testing.assert_array_equal(np.sort(spatial_order(points)), np.arange(count))


@pytest.mark.parametrize("points", [np.zeros((50, 3)), np.tile([[0, 0, 1], [1e30, 0, 0]], (25, 1))])
def test_points_may_coincide(points):
    np.testing.assert_array_equal(np.sort(spatial_order(points)), np.arange(50))


def test_neighbors_stay_together():
    points = np.random.default_rng(0).random((20_000, 3))
    ideal = (16 / len(points)) ** (1 / 3)  # the side of a cube that holds sixteen points on average
    assert spread(points) > 0.9
    assert spread(points[spatial_order(points)]) < 2 * ideal


def test_halves_are_apart():
    points = np.random.default_rng(0).random((1000, 3)) * (3, 1, 1)
    ordered = points[spatial_order(points)]
    assert ordered[:500, 0].max() <= ordered[500:, 0].min()
