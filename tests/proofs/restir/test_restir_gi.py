"""ReSTIR GI without the world cache: one indirect bounce, which the path tracer can render alone."""

import numpy as np
import pytest
from support.frames import SPECULAR, SPLIT_LIGHTING, Effort, add_up, make_renderer, observe_runs, path_traced_runs
from support.seeded_bugs import Bug, Rule, bug_tests, require
from support.statistics import measure_mean, measure_tiles_t, relative_interval

from solari_vk.bound.constants import NO_INDEX
from solari_vk.scene.builtin import closed_box, cornell_box, place
from solari_vk.scene.model import Camera, Instance, Material
from solari_vk.scene.shapes import sphere

INDIRECT = Rule("one bounce of indirect light in a Cornell box")
SIXTEENTHS = Rule("no tile of 4 x 4 differs significantly from the path tracer's indirect light")
SIZE = (48, 48)


def trace_second_bounce(device, scene, samples):
    """16 independent pictures of the path tracer with two bounces minus those with one (16, h, w, 3)."""
    two, one = (path_traced_runs(device, scene, SIZE, samples, runs=16, max_bounces=n).runs for n in (2, 1))
    return two - one


def renderer_of(device, scene, size=(32, 32), **settings):
    """A renderer that computes only one bounce of indirect light, without the world cache."""
    alone = {"passes": SPECULAR, **SPLIT_LIGHTING, "world_cache": False, "di": False}
    return make_renderer(device, scene, size, **alone, **settings)


def observe_indirect(device, scene, effort, **settings):
    """One bounce of indirect light in independent runs (runs, h, w, 3)."""
    with renderer_of(device, scene, SIZE, **settings) as renderer:
        return observe_runs(renderer, scene.camera, effort, lambda frame: add_up(frame, "gi_diffuse", "specular_gi"))


def compare(found, expected, effort, bar):
    yield measure_mean(INDIRECT, found, expected, bar, effort)
    yield measure_tiles_t(SIXTEENTHS, found, expected)


def measure_indirect(device, effort, bar):
    """Without the cache, indirect light is the path tracer's second bounce."""
    scene = cornell_box()
    expected = trace_second_bounce(device, scene, effort.samples)
    yield from compare(observe_indirect(device, scene, effort), expected, effort, bar)


BRIEF = Effort(16, 24, 16)


@pytest.fixture(scope="module")
def cornell(device):
    scene = cornell_box()
    return scene, trace_second_bounce(device, scene, 256)


@pytest.mark.slow
def test_one_bounce_is_the_path_tracers(device):
    require(measure_indirect(device, Effort(16, 24, 256, 8192), 0.0075))


@pytest.mark.slow
def test_visibility_as_in_solari_loses_light(device, cornell):
    scene, expected = cornell
    error, half_width = relative_interval(observe_indirect(device, scene, BRIEF, gi_visibility="neighbor"), expected)
    assert error + half_width < -0.03


@pytest.mark.slow
@pytest.mark.parametrize(("temporal", "spatial"), [(False, False), (True, False), (False, True)])
def test_each_reuse_alone_is_unbiased(device, cornell, temporal, spatial):
    scene, expected = cornell
    effort = BRIEF if temporal or spatial else Effort(8, 2, 16)  # without reuse frames are independent
    found = observe_indirect(device, scene, effort, gi_temporal=temporal, gi_spatial=spatial)
    require(compare(found, expected, effort, 0.04))


def test_skipping_smooth_metals_changes_no_light(device):
    # The sphere touches no wall's plane. So its pixels and the walls' are never similar, and share no samples.
    scene = closed_box()
    metal = Material(base_color=(0.9, 0.6, 0.3), metallic=1.0, perceptual_roughness=0.2)
    scene.add(Instance(mesh=sphere(), material=metal, transform=place(0.3, at=(-0.2, -0.1, -0.3))))
    found, confidence = [], []
    for skip in (True, False):
        with renderer_of(device, scene, specular=False, gi_skip_smooth_metals=skip) as renderer:
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
    with renderer_of(device, scene, specular=False, gi_spatial=False, gi_confidence_cap=5.0) as renderer:
        for count in range(1, 10):
            confidence = renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"]
            assert confidence.max() == min(count, 6)
        renderer.reset()
        assert set(np.unique(renderer.render(scene.camera)["gi_reservoirs"]["confidence_weight"])) <= {0, 1}


@pytest.mark.slow
def test_reservoirs_name_living_cells_that_hold_their_points(device):
    """After each frame: with the shortest lives, a moving camera, and settings that change."""
    changes = {
        4: {"gi_refresh": False},
        6: {"gi_refresh": True},
        8: {"world_cache": False},
        9: {"world_cache": True},
        11: {"world_cache_cells": 1 << 13},
    }
    few = {"world_cache_lifetime": 1, "world_cache_cells": 1 << 14}
    with make_renderer(device, cornell_box(), **SPLIT_LIGHTING, **few) as renderer:
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


def brief(device):
    """With less effort than the rules take: the bugs are larger than this bar."""
    return measure_indirect(device, Effort(), 0.06)


@pytest.mark.slow
def test_brief_check_holds(device):
    require(brief(device))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        INDIRECT: (
            brief,
            Bug(
                "passes/solari019/restir_gi/initial.comp",
                "generate_initial_reservoir",
                "GiReservoir reservoir = correct(surface, rng); "
                "reservoir.unbiased_contribution_weight *= 0.5; return reservoir;",
            ),
        ),
        SIXTEENTHS: (
            brief,
            Bug(
                "passes/solari019/restir_gi/spatial_and_shade.comp",
                "shade_diffuse",
                "return correct(surface, reservoir) / max(reservoir.unbiased_contribution_weight, 1e-6);",
            ),
        ),
        "cells of reservoirs: kept unread": (
            test_reservoirs_name_living_cells_that_hold_their_points,
            Bug(
                "passes/solari019/restir_gi/temporal.comp",
                "refresh_radiance",
                "if (restir_gi_settings.refresh != 0u && frame_settings.world_cache != 0u) { correct(reservoir); }",
            ),
        ),
    }
)
