"""Numbers of samples chosen by pixel, in pictures of known noise."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.output.adaptive import MIN_SAMPLES, SamplePlan
from solari_vk.scene.builtin import builtin

SIZE = 60, 44  # blocks at the right and lower edge are smaller
CHANCE = 0.01  # of a rare sample, which is as much brighter


class Noise:
    """A picture of mean 1: a quarter has rare bright samples, half is noisy, and the rest hardly."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.rare, self.noisy = np.zeros(SIZE[::-1], bool), np.zeros(SIZE[::-1], bool)
        self.rare[:22, :30], self.noisy[:, 30:] = True, True
        self.variance = np.where(self.rare, 1 / CHANCE - 1, np.where(self.noisy, 4.0, 0.01))

    def sums(self, counts):
        steady = self._rng.gamma(np.maximum(counts / self.variance, 1e-9), self.variance)
        return np.where(self.rare, self._rng.binomial(counts, CHANCE) / CHANCE, steady)


def rendered(seed, target, rays=10):
    """A picture's mean, number of samples of each pixel, and estimated error."""
    noise, plan = Noise(seed), SamplePlan(SIZE, 8)
    total, counts = np.zeros(SIZE[::-1]), plan.counts
    plan.begin_pass_towards(target, 1_000_000)
    while plan.remaining:
        plan.traced += plan.remaining
        total += noise.sums(plan.counts - counts)
        counts = plan.counts
        plan.estimate_error(np.repeat((total / counts)[..., None], 3, axis=2), rays * counts)
        plan.begin_pass_towards(target, 1_000_000)
    return total / counts, counts, plan.error


def test_the_error_is_reached_with_fewer_samples():
    mean, counts, error = rendered(seed=1, target=0.1)
    noise = Noise(1)
    assert error <= 0.1
    assert np.sqrt(np.square(mean - 1).mean()) == pytest.approx(0.1, rel=0.1)
    assert counts.min() >= MIN_SAMPLES
    even, best = noise.variance.mean() / 0.1**2, np.sqrt(noise.variance).mean() ** 2 / 0.1**2
    assert counts.mean() < 0.5 * (even + best)  # Neyman's bound is `best`


def test_costly_pixels_get_fewer_samples():
    rays = np.where(np.arange(SIZE[0]) < 48, 40, 10)  # of a sample, in the noisy half
    counts = np.mean([rendered(seed, 0.1, rays)[1] for seed in range(4)], axis=0)
    assert counts[32:, 56:].mean() / counts[32:, 40:48].mean() == pytest.approx(2, rel=0.15)


def test_choosing_numbers_of_samples_is_not_seen_in_the_mean():
    means = [rendered(seed, 0.25)[0] for seed in range(60)]
    for region in (Noise(0).rare, Noise(0).noisy):
        values = [mean[region].mean() for mean in means]
        assert abs(np.mean(values) - 1) < 4 * np.std(values) / np.sqrt(len(values))


def test_pixels_catch_up():
    plan = SamplePlan(SIZE, 8, samples=20)
    plan.ends = np.where(np.arange(len(plan.ends)) % 3 == 0, 50, 20)
    plan.traced = 10
    plan.begin_even_pass()
    assert (plan.begins == np.where(np.arange(len(plan.ends)) % 3 == 0, 30, 20)).all()
    assert plan.remaining == 10
    plan.traced += 10
    assert (plan.counts == 30).all()


# ---- the path tracer's pictures ----


@pytest.mark.slow
def test_pixels_that_catch_up_are_those_of_an_even_picture(device):
    """What pixels took, and in what order, isn't seen: a picture made even has the same bits as one that always was."""
    scene = builtin("sphere_grid")
    with (
        sv.PathTracer(device, scene, (44, 36), seed=3) as tracer,
        sv.PathTracer(device, scene, (44, 36), seed=3) as even,
    ):
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
