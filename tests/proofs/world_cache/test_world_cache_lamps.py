"""Cells of a floor under lamps hold the irradiance of closed forms, without fireflies beside lamps."""

from __future__ import annotations

import numpy as np
import pytest
from support.lamp_over_floor import LAMP_CORNERS, LAMP_RADIANCE, floor_scene, lamp_above
from support.oracles import closed_forms
from support.seeded_bugs import Bug, bug_tests
from world_cache_frame import CacheFrame

import solari_vk as sv
from solari_vk.scene.builtin import rgb

UP = (0.0, 1.0, 0.0)
SQUARE = np.array([(-1.0, 1.0, -1.0), (1.0, 1.0, -1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)])
# A tilted lamp of 1 m; and lamps that nearly touch the floor, of 2 m, and one of 20 cm.
LAMPS = {"tilted": LAMP_CORNERS, "near": SQUARE * (1, 0.1, 1), "small": SQUARE * (0.1, 0.3, 0.1)}


def measure_cells(device, corners):
    """The irradiance (N, 3) of settled cells over the closed form at the centers of their floors, and the latter."""
    scene = floor_scene(sv.Material(base_color=rgb(0.5)), lamp_above(corners))
    settings = sv.Settings(
        lighting="paths", lambert=True, world_cache_cells=1 << 15, world_cache_updates="all",
        world_cache_updates_per_pixel=1e9, world_cache_cell_size=0.05, world_cache_lifetime=100,
    )  # fmt: skip
    # Cameras see no back sides, but the rays of this frame meet them, so they start below the lamp.
    height = corners[:, 1].min()
    camera = sv.Camera.look_at((0, 0.6 * height, 0), (0, 0, 0), up=(0, 0, 1))
    with CacheFrame(device, scene, settings, first_ray=1) as frame:
        cells = frame.run(60, camera).cells()
    low, size = cells["bounds"][:, 1], cells["bounds"][:, 3]
    settled = (cells["irradiance"][:, 3] >= 8) & (low < 0.01) & (low + size > -0.01)
    bounds = cells["bounds"][settled].astype(np.float64)
    floors = np.column_stack([bounds[:, 0], np.zeros(len(bounds)), bounds[:, 2]]) + bounds[:, 3:] * (0.5, 0, 0.5)
    received = closed_forms.polygon_irradiance(floors, np.tile(UP, (len(floors), 1)), corners, 1.0)
    expected = received[:, None] * LAMP_RADIANCE
    return cells["irradiance"][settled, :3] / expected, expected


def check(device, lamp):
    """Require the right mean and median, and no cell far from its closed form. A cell's samples lie all over the cell,
    so that single cells differ from the irradiance at its center."""
    ratio, expected = measure_cells(device, LAMPS[lamp])
    assert len(ratio) > 500
    found = [(ratio * expected).mean() / expected.mean(), np.median(ratio), np.percentile(ratio, 99.9), ratio.max()]
    print(lamp, len(ratio), np.round(found, 4))
    assert abs(found[0] - 1) < 0.02
    assert abs(found[1] - 1) < 0.015
    assert found[2] < 2.15
    assert found[3] < 4


@pytest.mark.parametrize("lamp", [
    "tilted", *(pytest.param(name, marks=pytest.mark.slow) for name in LAMPS if name != "tilted"),
])  # fmt: skip
def test_cells_under_a_lamp(device, lamp):
    check(device, lamp)


test_a_seeded_bug_is_noticed = bug_tests({
    "cells under a lamp: light samples weighted as one": (lambda device: check(device, "near"), Bug(
        "passes/paths/vertex.glsl", "reflect_light", "return correct(vertex, light_sample, min(density, 1.0));")),
})  # fmt: skip
