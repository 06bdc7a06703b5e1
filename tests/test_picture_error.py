"""Estimated errors of pictures against errors that are known: made of noise, an offset, and both."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.output.error import ErrorEstimate, RunningMean, error_of_mean, error_of_other

SIZE = (64, 96)
LIGHT = 3.0


def gray(luminance):
    return np.repeat(np.asarray(luminance)[..., None], 3, axis=2)


def noisy(count, seed=0, spread=1.0):
    """Samples (count, height, width) of luminance, a third of which is dark."""
    truth = np.full(SIZE, LIGHT)
    truth[: SIZE[0] // 3] = LIGHT / 10
    return truth, truth * (1 + spread * np.random.default_rng(seed).standard_normal((count, *SIZE)))


def running(samples):
    mean = RunningMean()
    for sample in samples:
        mean.add(gray(sample))
    return mean


def test_a_running_mean_has_the_variance_of_its_samples():
    _, samples = noisy(9)
    mean = running(samples)
    np.testing.assert_allclose(mean.mean, gray(samples.mean(axis=0)))
    np.testing.assert_allclose(mean.variance, samples.var(axis=0, ddof=1) / 9)


@pytest.mark.parametrize("size", [SIZE, (61, 95), (1, 1), (3, 2)])
def test_noise_of_a_mean(size):
    """A standard error of 10 % everywhere is an error of 10 %, for sizes that are no multiple of a block too."""
    picture = np.full((*size, 3), LIGHT)
    error = error_of_mean(picture, np.full(size, (0.1 * LIGHT) ** 2))
    assert error == pytest.approx(0.1, rel=0.01)  # 1 % of the squared mean is added to the square


def test_noise_counts_relative_to_luminance():
    truth, samples = noisy(25)
    mean = running(samples)
    # 1 / sqrt(25) where it is bright; where luminance is a tenth of that, the added 1 % counts.
    added = 1e-2 * truth.mean() ** 2
    expected = np.sqrt((truth**2 / 25 / (truth**2 + added)).mean())
    assert error_of_mean(mean.mean, mean.variance) == pytest.approx(expected, rel=0.05)


def test_a_picture_that_is_off_by_a_tenth():
    """Samples without the offset show it, however noisy they are; the noise itself isn't counted."""
    truth, samples = noisy(16)
    mean = running(samples)
    assert 0.085 < error_of_other(gray(1.1 * truth), mean.mean, mean.variance) < 0.115
    assert error_of_other(gray(truth), mean.mean, mean.variance) < 0.05


def test_black_pictures_have_no_error():
    black = np.zeros((8, 8, 3))
    assert error_of_mean(black, black[..., 0]) == 0
    assert error_of_other(black, black, black[..., 0]) == 0


def test_later_samples_are_taken_apart_from_earlier_ones():
    """A picture is compared with the samples that came after it, of which only sums over all are known."""
    truth, samples = noisy(24, seed=3)
    picture = gray(1.05 * truth)
    estimate = ErrorEstimate(8)
    looks = []
    for count in (8, 24):
        mean = running(samples[:count])
        estimate.look_at_other(count, mean.mean, mean.variance, lambda: picture)
        looks.append(estimate.error)
    later = running(samples[8:])
    assert looks[0] == np.inf
    assert looks[1] == pytest.approx(error_of_other(picture, later.mean, later.variance), rel=1e-6)
    assert estimate.next_count == 48
