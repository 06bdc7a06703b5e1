"""`illuminance` against Radiance, of the Python at SOLARI_VK_TRIAL_PYTHON, or of this one."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
from support import radiance

from solari_vk.lab.trial.process import Kind
from tests.proofs.lights import test_profiles

PYTHON = os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable)


@pytest.fixture
def python():
    """The Python that has Radiance."""
    if why := Kind("Radiance", "", "pyradiance").missing(PYTHON):
        pytest.skip(f"Radiance: {why}")
    return PYTHON


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in test_profiles.KINDS if kind.startswith("C")])
def test_luminaires(device, python, tmp_path, kind):
    """300 points around each. Radiance turns those with angles from 90 to 270 degrees by half a turn. It doesn't read
    type A, nor, off the two main planes, type B as photometry has it."""
    turned = {"horizontal": (-1, 0, 0)} if kind == "C, the other half" else {}
    (tmp_path / "lamp.ies").write_text(test_profiles.make_file(kind).replace(".1,.1 0", "0 0 0"))
    rng = np.random.default_rng(5)
    away = rng.normal(size=(300, 3))
    points = away * (rng.uniform(2, 6, 300) / np.linalg.norm(away, axis=1))[:, None]
    ours, theirs = radiance.luminaire(device, python, tmp_path / "lamp.ies", points, **turned)
    print(f"{kind}: {np.median(ours[theirs > 0.1] / theirs[theirs > 0.1]):.4f}, {np.abs(ours - theirs).max():.3f} lux")
    np.testing.assert_allclose(ours, theirs, rtol=0.002, atol=0.2)


@pytest.mark.slow
def test_a_room_under_a_perez_sky(device, python, tmp_path):
    """Sun, sky and ground through a window, and up to 16 reflections: within 2 % at each point, 1 % on average."""
    found = radiance.compare(device, python, tmp_path)
    print(radiance.table(*found))
    ours, our_error, theirs, their_error = found
    assert (our_error < 0.01 * ours).all()
    assert (their_error < 0.01 * theirs).all()
    assert ours == pytest.approx(theirs, rel=0.02)
    assert np.mean(ours / theirs) == pytest.approx(1, abs=0.01)
