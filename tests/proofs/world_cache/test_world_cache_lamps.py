"""Cells of a floor under lamps hold the irradiance of closed forms, without fireflies beside lamps."""

from __future__ import annotations

import numpy as np
import pytest
from world_cache_frame import CacheFrame

import solari_vk as sv
from solari_vk.conformance.light_checks import LAMP_CORNERS, LAMP_RADIANCE, floor_scene, lamp_above
from solari_vk.conformance.oracles import closed_forms
from solari_vk.gpu.shaders.patches import patched_shaders
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


@pytest.mark.parametrize("lamp", LAMPS)
def test_cells_under_a_lamp(device, lamp):
    check(device, lamp)


SAMPLE, PATH, VERTEX = "passes/world_cache/sample.comp", "passes/paths/path.glsl", "passes/paths/vertex.glsl"
HITS = (PATH, "surface.material.emissive * power_heuristic(mis_pdf, light_pdf)", "vec3(0.0)")
MUTANTS = {
    "no pi": ("tilted", (SAMPLE, "PI * path_light(path)", "path_light(path)")),
    "a pixel's number of candidates": ("near", (SAMPLE, "    path.candidates = world_cache_settings.candidates;\n", ""),
                                       (PATH, "float(candidates);", "float(world_cache_settings.candidates);")),
    "light samples weighted as one": ("near", (VERTEX, "power_heuristic(density * light", "power_heuristic(light")),
    "no hits": ("near", HITS),
    "no light samples": ("tilted", (PATH, "if (max_component(sum(drawn.light)) > 0.0) {", "if (false) {")),
    "light samples alone": ("near", HITS, (VERTEX, "light.received_radiance * mis_weight", "light.received_radiance")),
    "a gray surface": ("tilted", (SAMPLE, "path.vertex.brdf = white_diffuse_brdf();",
                                  "path.vertex.brdf = white_diffuse_brdf(); path.vertex.brdf.diffuse_color *= 0.97;")),
}  # fmt: skip


@pytest.mark.parametrize("name", [n if n == "no pi" else pytest.param(n, marks=pytest.mark.slow) for n in MUTANTS])
def test_seeded_bug_is_noticed(device, name):
    lamp, *patches = MUTANTS[name]
    with patched_shaders(*patches), pytest.raises(AssertionError):
        check(device, lamp)
