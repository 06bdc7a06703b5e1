"""Estimated errors of pictures against errors that are known: made of noise, an offset, and both."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.output.error import ErrorEstimate, area_means, error_of_mean, error_of_other

SIZE = (64, 96)
LIGHT = 3.0


def gray(luminance):
    return np.repeat(np.asarray(luminance)[..., None], 3, axis=2)


def noisy(count, seed=0):
    """Samples (count, height, width) of luminance, a third of which is dark, and their expected values."""
    truth = np.full(SIZE, LIGHT)
    truth[: SIZE[0] // 3] = LIGHT / 10
    return truth, truth * (1 + np.random.default_rng(seed).standard_normal((count, *SIZE)))


def mean_of(samples):
    return gray(samples.mean(axis=0))


@pytest.mark.parametrize("size", [(61, 95), (1, 1)])
def test_noise_of_a_mean(size):
    """A standard error of 10 % everywhere is an error of 10 %, for sizes that are no multiple of a block too."""
    error = error_of_mean(np.full((*size, 3), LIGHT), np.full(size, (0.1 * LIGHT) ** 2))
    assert error == pytest.approx(0.1, rel=0.01)  # 1 % of the squared mean is added to the square


def test_noise_counts_relative_to_luminance():
    truth, samples = noisy(25)
    # 1 / sqrt(25) where it is bright; where luminance is a tenth of that, the added 1 % counts.
    expected = np.sqrt((truth**2 / 25 / (truth**2 + 1e-2 * truth.mean() ** 2)).mean())
    assert error_of_mean(mean_of(samples), samples.var(axis=0, ddof=1) / 25) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("off", "low", "high"), [(0.0, 0.0, 0.05), (0.1, 0.08, 0.11), (0.3, 0.21, 0.25)])
def test_a_picture_that_is_off(off, low, high):
    """Noisy samples without the offset show it, relative to the picture; their own noise is not counted."""
    truth, samples = noisy(16)
    error = error_of_other(gray(truth + off * truth), mean_of(samples[:8]), mean_of(samples[8:]))
    assert low <= error < high


def test_black_pictures_have_no_error():
    black = np.zeros((8, 8, 3))
    assert error_of_mean(black, black[..., 0]) == 0
    assert error_of_other(black, black, black) == 0


def test_a_picture_is_compared_with_later_samples():
    """Of these only means over all samples are known, at the numbers of samples that are asked for."""
    truth, samples = noisy(40, seed=3)
    estimate = ErrorEstimate(8)
    pictures = {8: gray(1.05 * truth), 17: gray(1.2 * truth), 34: gray(truth)}
    looks = []
    for count in range(1, 41):
        if count >= estimate.next_look and count != 16:  # the owner may be late
            estimate.add_denoised(count, mean_of(samples[:count]), lambda: pictures[count])  # noqa: B023
            looks.append((count, estimate.error))
    expected = [
        error_of_other(pictures[begin], mean_of(samples[begin:middle]), mean_of(samples[middle:end]))
        for begin, middle, end in ((8, 12, 17), (17, 26, 34))
    ]
    assert [count for count, _ in looks] == [8, 12, 17, 26, 34]
    assert [error for _, error in looks[:2]] == [np.inf, np.inf]
    assert [looks[2][1], looks[4][1]] == pytest.approx(expected, rel=1e-9)
    assert looks[3][1] == looks[2][1]


def test_the_halves_of_a_mean_tell_its_error():
    """Also where points are so even that the mean's variance falls faster than 1 / count, as of Owen's sequences."""
    for exponent in (0.5, 0.75):
        estimate, noise = ErrorEstimate(1), np.random.default_rng(4)
        off, share = np.zeros(SIZE), 0.0
        for count in (1, 2, 4, 8, 16, 32):
            # Both halves of the samples are as good as a mean of half as many, so they correlate if the mean is better.
            variance = 0.09 * count ** (-2 * exponent)
            off = share * off + np.sqrt(variance * (1 - share)) * noise.standard_normal(SIZE)
            share = 2 ** (-2 * exponent)
            estimate.add_mean(count, gray(LIGHT * (1 + off)))
            assert np.isinf(estimate.error) == (count == 1)
        error = np.sqrt((off**2).mean())
        assert 0.85 < estimate.error / error < 1.15


def test_means_over_larger_pixels():
    picture = np.random.default_rng(2).random((6, 8, 3))
    blocks = picture.reshape(3, 2, 2, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(area_means(picture, (2, 3)), blocks)
    np.testing.assert_allclose(area_means(picture, (8, 6)), picture)
    for size in ((5, 4), (7, 5), (1, 1), (11, 9)):
        means = area_means(picture, size)
        assert means.shape == (size[1], size[0], 3)
        assert means.mean() == pytest.approx(picture.mean())
