"""`illuminance` against Radiance, of the Python at SOLARI_VK_TRIAL_PYTHON, or of this one."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
from support import radiance

from solari_vk.measure.trial.process import Kind

PYTHON = os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable)


@pytest.mark.slow
def test_a_room_under_a_perez_sky(any_device, request, tmp_path):
    """Sun, sky and ground through a window, and up to 16 reflections: within 2 % at each point, 1 % on average."""
    if why := Kind("Radiance", "", "pyradiance").missing(PYTHON):
        pytest.skip(f"Radiance: {why}")
    found = radiance.compare(request.getfixturevalue("device"), PYTHON, tmp_path)
    print(radiance.table(*found))
    ours, our_error, theirs, their_error = found
    assert (our_error < 0.01 * ours).all()
    assert (their_error < 0.01 * theirs).all()
    assert ours == pytest.approx(theirs, rel=0.02)
    assert np.mean(ours / theirs) == pytest.approx(1, abs=0.01)
