"""Pictures whose pixels take different numbers of samples."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.builtin import builtin

SIZE = 44, 36


@pytest.mark.slow
def test_pixels_that_catch_up_are_those_of_an_even_picture(device):
    """What pixels took, and in what order, isn't seen: a picture made even has the same bits as one that always was."""
    scene = builtin("sphere_grid")
    with sv.PathTracer(device, scene, SIZE, seed=3) as tracer, sv.PathTracer(device, scene, SIZE, seed=3) as even:
        frame = tracer.render(samples=4096, target_error=0.12)
        counts = tracer.sample_counts
        assert tracer.error <= 0.12
        assert 16 <= counts.min() < counts.max() / 2
        assert tracer.samples == counts.max()
        assert np.isfinite(frame["variance"]).all()
        tracer.render(samples=60, target_error=0.06)
        assert tracer.samples == max(60, counts.max())
        samples = tracer.samples
        picture = tracer.render(samples=samples)
        assert (tracer.sample_counts == samples).all()
        expected = even.render(samples=samples)
        for name in ("radiance", "variance"):
            assert np.array_equal(picture[name], expected[name])
        assert tracer.rays == even.rays
