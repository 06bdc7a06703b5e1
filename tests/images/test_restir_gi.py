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
from solari_vk.conformance.realtime import SPECULAR, Effort, make_renderer, measure_mean, measure_significance
from solari_vk.measure.statistics import relative_interval
from solari_vk.scene.builtin import closed_box, cornell_box, place
from solari_vk.scene.model import Instance, Material
from solari_vk.scene.shapes import sphere

BRIEF = Effort(16, 24, 16)


def renderer_of(device, scene, **settings):
    """A renderer that computes only one bounce of indirect light."""
    return make_renderer(
        device, scene, passes=SPECULAR, world_cache=False, di=False, specular=False, gbuffer="traced", **settings
    )


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
