"""The spatial order is a permutation that keeps neighbors together, for any points."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.bound.spatial_order import spatial_order

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "points",
    [
        *(RNG.normal(size=(count, 3)) for count in (0, 1, 2, 3, 5, 16, 17, 4097)),
        np.zeros((50, 3)),
        np.tile([[0, 0, 1], [1e30, 0, 0]], (25, 1)),
    ],
)
def test_it_is_a_permutation_also_of_points_that_coincide(points):
    np.testing.assert_array_equal(np.sort(spatial_order(points)), np.arange(len(points)))


def test_neighbors_stay_together():
    points = RNG.random((20_000, 3))
    ideal = (16 / len(points)) ** (1 / 3)  # the side of a cube that holds sixteen points on average
    runs = points[spatial_order(points)].reshape(-1, 16, 3)
    assert np.ptp(runs, axis=1).max(axis=1).mean() < 2 * ideal


def test_boxes_are_halved_where_the_halves_are_small():
    """Bars along x, 100 times as long as wide, whose centers spread most along x: halves along x would overlap."""
    centers, half_sizes = RNG.random((1000, 3)) * (3, 2, 1), np.array([50, 0.5, 0.5])
    ordered = centers[spatial_order(centers - half_sizes, centers + half_sizes)]
    assert ordered[:500, 1].max() <= ordered[500:, 1].min()


def test_the_larger_half_comes_first():
    """As in Mesa's builder."""
    points = np.array([[0, 0, 0], [9, 0, 0], [1, 0, 0]])
    assert sorted(spatial_order(points)[:2]) == [0, 2]


def test_halves_are_apart():
    points = RNG.random((1000, 3)) * (3, 1, 1)
    ordered = points[spatial_order(points)]
    assert ordered[:500, 0].max() <= ordered[500:, 0].min()
