"""ReSTIR GI without the world cache: one indirect bounce, which the path tracer can render alone."""

from __future__ import annotations

import numpy as np
import pytest
from support.measured import hold

from solari_vk.conformance.indirect_checks import (
    FULL,
    INDIRECT,
    SIXTEENTHS,
    measure_indirect,
    observe_indirect,
    trace_second_bounce,
)
from solari_vk.conformance.realtime import SPECULAR, SPLIT, Effort, make_renderer, measure_mean, measure_significance
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.statistics import relative_interval
from solari_vk.scene.builtin import closed_box, cornell_box, place
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.model import Camera, Instance, Material
from solari_vk.scene.shapes import sphere

BRIEF = Effort(16, 24, 16)


def renderer_of(device, scene, **settings):
    """A renderer that computes only one bounce of indirect light."""
    return make_renderer(
        device, scene, passes=SPECULAR, **SPLIT, world_cache=False, di=False, specular=False, gbuffer="traced",
        **settings,
    )  # fmt: skip


@pytest.fixture(scope="module")
def cornell(device):
    scene = cornell_box()
    return scene, trace_second_bounce(device, scene, 2048)


@pytest.mark.slow
def test_full_profile(device):
    hold(measure_indirect(device, FULL))


def test_visibility_as_in_solari_loses_light(device, cornell):
    scene, expected = cornell
    error, half_width = relative_interval(observe_indirect(device, scene, BRIEF, gi_visibility="neighbor"), expected)
    assert error + half_width < -0.03


@pytest.mark.parametrize(("temporal", "spatial"), [(False, False), (True, False), (False, True)])
def test_each_reuse_alone_is_unbiased(device, cornell, temporal, spatial):
    scene, expected = cornell
    found = observe_indirect(device, scene, BRIEF, gi_temporal=temporal, gi_spatial=spatial)
    hold([measure_mean(INDIRECT, found, expected, 0.04, BRIEF), measure_significance(SIXTEENTHS, found, expected)])


def test_skipping_smooth_metals_changes_no_light(device):
    # The sphere touches no wall's plane. So its pixels and the walls' are never similar, and share no samples.
    scene = closed_box()
    metal = Material(base_color=(0.9, 0.6, 0.3), metallic=1.0, perceptual_roughness=0.2)
    scene.add(Instance(mesh=sphere(), material=metal, transform=place(0.3, at=(-0.2, -0.1, -0.3))))
    found, confidence = [], []
    for skip in (True, False):
        with renderer_of(device, scene, gi_skip_smooth_metals=skip) as renderer:
            for _ in range(6):
                frame = renderer.render(scene.camera)
            found.append(frame["gi_diffuse"])
            confidence.append(frame["gi_reservoirs"]["confidence_weight"])
    skipped = (confidence[0] == 0) & (confidence[1] > 0)
    assert skipped.sum() > 20, f"the sphere is in {skipped.sum()} pixels"
    assert not found[1][skipped].any()
    assert np.array_equal(*found)


def test_confidence_grows_to_its_cap_and_is_reset(device):
    scene = cornell_box()
    with renderer_of(device, scene, gi_spatial=False, gi_confidence_cap=5.0) as renderer:
        for count in range(1, 10):
            confidence = renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"]
            assert confidence.max() == min(count, 6)
        renderer.reset()
        assert set(np.unique(renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"])) <= {0, 1}


def test_reservoirs_name_living_cells_that_hold_their_points(device):
    """After each frame: with the shortest lives, a moving camera, and settings that change."""
    changes = {4: {"gi_refresh": False}, 6: {"gi_refresh": True}, 8: {"world_cache": False}, 9: {"world_cache": True},
               11: {"world_cache_cells": 1 << 13}}  # fmt: skip
    few = {"world_cache_lifetime": 1, "world_cache_cells": 1 << 14}
    with make_renderer(device, cornell_box(), **SPLIT, **few) as renderer:
        for step in range(14):
            for name, value in changes.get(step, {}).items():
                setattr(renderer.settings, name, value)
            renderer.render(Camera.look_at((0.1 * step, 1.0, 3.9), (0.05 * step, 0.9, 0.0)))
            reservoirs = renderer["gi_reservoirs"]
            lit = reservoirs["unbiased_contribution_weight"] > 0
            named = reservoirs[lit & (reservoirs["world_cache_cell"] != NO_INDEX)]
            assert (len(named) > 0.1 * lit.sum()) == renderer.settings.world_cache, step
            cells, points = named["world_cache_cell"], named["sample_point_world_position"]
            assert renderer["world_cache_checksums"][cells].all(), step
            assert (renderer["world_cache_life"][cells] == 1).all(), step
            corners, size = np.split(renderer["world_cache_bounds"][cells], [3], axis=1)
            within = (points - corners) / size
            jitter = renderer.settings.world_cache_jitter + 1e-3
            assert ((within >= -jitter) & (within <= 1 + jitter)).all(), step


@pytest.mark.parametrize(("file", "old", "new"), [
    ("restir_gi/temporal.comp", "if (!refreshes) { reservoir.world_cache_cell = NO_INDEX; }", ""),
    ("world_cache/map.glsl", "atomicMax(world_cache_life.at[cell], lifetime);", ""),
    ("restir_gi/initial.comp", "? NO_INDEX : light.cell", "? NO_INDEX : light.cell ^ 1u"),
], ids=["cells kept unread", "cells not kept alive", "another cell"])  # fmt: skip
def test_a_seeded_bug_in_the_cells_of_reservoirs_is_noticed(device, file, old, new):
    with patched_shaders((f"passes/{file}", old, new)), pytest.raises(AssertionError):
        test_reservoirs_name_living_cells_that_hold_their_points(device)
