"""Sampled distributions, each mapped back to the unit square, where it must be uniform."""

from __future__ import annotations

import numpy as np
import pytest
from support.statistics import sidak, uniform_p

COUNT = 1_000_000
CONES = [2.0, 1.0, 0.01, 1.1e-5, 1.25e-11]  # 1 - cos: a sphere, a hemisphere, ..., the sun, the smallest light
AXES = [(0, 0, 1), (0, 0, -1), (0.6, -0.48, 0.64), (1e-5, 0, -1)]


def draw(shaders, kind, axis=(0.0, 0.0, 1.0), cone=1.0, count=COUNT):
    axis = np.array(axis, np.float32) / np.float32(np.linalg.norm(axis))
    words = np.concatenate([np.array([kind, 7], np.uint32), np.array([*axis, cone], np.float32).view(np.uint32)])
    draws = shaders.run("test/distributions", count, {"parameters": words}, {"draws": count})["draws"]
    assert np.isfinite(draws).all()
    return draws.astype(np.float64), axis.astype(np.float64)


def turns(x, y):
    return np.arctan2(y, x) / (2 * np.pi) % 1


def test_disk(shaders):
    d, _ = draw(shaders, 0)
    assert uniform_p(d[:, 0] ** 2 + d[:, 1] ** 2, turns(d[:, 0], d[:, 1])) > sidak(0.01, 8)


def test_hemispheres(shaders):
    for kind, power in ((1, 2), (2, 1)):
        d, _ = draw(shaders, kind)
        assert np.abs(np.linalg.norm(d, axis=1) - 1).max() < 1e-6
        assert (d[:, 2] > 0).all() or kind == 2
        assert uniform_p(d[:, 2] ** power, turns(d[:, 0], d[:, 1])) > sidak(0.01, 8)


def test_barycentrics(shaders):
    d, _ = draw(shaders, 4)
    rest = 1 - d[:, 0] - d[:, 1]
    assert rest.min() > -1e-6
    assert uniform_p((1 - rest) ** 2, d[:, 0] / np.maximum(1 - rest, 1e-12)) > sidak(0.01, 8)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("cone", CONES)
def test_cone(shaders, cone, axis):
    count = COUNT // 4
    d, axis = draw(shaders, 3, axis, cone, count)
    assert np.abs(np.linalg.norm(d, axis=1) - 1).max() < 1e-6
    apart = d - axis
    share = (apart**2).sum(axis=1) / 2 / cone  # (1 - cos) / (1 - cos of the half angle)
    assert share.max() < 1 + 1e-6 + 6e-7 / np.sqrt(2 * cone)  # a component's rounding against the cone's radius
    first = np.cross(axis, (1, 0, 0) if abs(axis[0]) < 0.9 else (0, 1, 0))
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    if cone > 1e-8:
        assert uniform_p(np.minimum(share, 1), turns(apart @ first, apart @ second)) > sidak(0.01, 20)
    else:
        assert abs(share.mean() - 0.5) < 0.02
