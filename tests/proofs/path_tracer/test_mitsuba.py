"""The Cornell box against Mitsuba 3, with Lambert surfaces, and with our BRDF written as a Mitsuba BSDF.

The references are stored with their variances and a fingerprint of the scene they show
(`python -m oracles.mitsuba_scene` in tests/ renders them anew). A small live render checks that
the installed Mitsuba still makes them.
"""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mitsuba_scene
from oracles.mitsuba_scene import REFERENCE_BOUNCES, REFERENCE_SCENES, REFERENCE_SIZE, fingerprint, load_reference
from support.statistics import assert_equal, compare


@pytest.mark.parametrize(
    ("samples", "bar"), [(512, 0.008), pytest.param(6144, 0.003, marks=pytest.mark.slow)], ids=["quick", "exact"]
)
@pytest.mark.parametrize("name", [pytest.param("lambert", marks=pytest.mark.slow), "glossy"])
def test_cornell_box_is_mitsubas(picture, name, samples, bar):
    """Each 16x16 tile differs by no more than statistical error; the mean's 95 % interval is within the bar."""
    scene, lambert = REFERENCE_SCENES[name]()
    reference = load_reference(name)
    assert reference["fingerprint"] == fingerprint(scene), "the scene changed: python -m oracles.mitsuba_scene"
    made = picture(scene, (REFERENCE_SIZE, REFERENCE_SIZE), samples, max_bounces=REFERENCE_BOUNCES, lambert=lambert)
    result = compare(made.mean, made.variance, reference["mean"], reference["variance"])
    print(name, result)
    assert_equal(result, bar, name)


@pytest.mark.slow
def test_a_thin_lens_is_mitsubas(picture):
    """The Cornell box out of focus, by the rule of the other pictures."""
    scene, _ = REFERENCE_SCENES["lambert"]()
    mitsuba = mitsuba_scene.select_variant(vectorized=False)
    scene.camera.update(aperture=0.5, focus_distance=2.0)
    live = mitsuba_scene.scene_of(mitsuba, scene, 48, 48, bounces=REFERENCE_BOUNCES, lambert=True)
    mean, variance = mitsuba_scene.render(mitsuba, live, 8, 48, seed=5)
    made = picture(scene, (48, 48), 512, max_bounces=REFERENCE_BOUNCES, lambert=True)
    result = compare(made.mean, made.variance, mean, variance)
    print(result)
    assert_equal(result, 0.03, "thin lens")
    scene.camera.aperture = 0.0
    sharp = picture(scene, (48, 48), 128, max_bounces=REFERENCE_BOUNCES, lambert=True)
    assert compare(sharp.mean, sharp.variance, mean, variance).max_z > 3 * result.z_bar


@pytest.mark.slow
@pytest.mark.parametrize("name", REFERENCE_SCENES)
def test_stored_reference_is_what_mitsuba_renders(name):
    scene, lambert = REFERENCE_SCENES[name]()
    mitsuba = mitsuba_scene.select_variant(vectorized=not lambert)
    if mitsuba is None:
        pytest.skip("the vectorized Mitsuba needs LLVM 19 (Debian: libllvm19)")
    if not lambert:
        mitsuba_scene.register_bsdf(mitsuba)
    reference = load_reference(name)
    live = mitsuba_scene.scene_of(
        mitsuba, scene, REFERENCE_SIZE, REFERENCE_SIZE, bounces=REFERENCE_BOUNCES, lambert=lambert
    )
    mean, variance = mitsuba_scene.render(mitsuba, live, 8, 8, seed=99)
    result = compare(mean, variance, reference["mean"], reference["variance"])
    print(name, result)
    assert_equal(result, 0.05, name)
    assert np.isfinite(mean).all()
