"""Pixels without much history take several paths: the mean stays, the noise falls, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import make_renderer, render_frames
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene.builtin import builtin

SIZE = (32, 32)
SEEDS = 96
ALONE = {"denoise": True, "jitter": False, "world_cache": False, "paths_bounces": 4}
PATHS = 3


def first_frames(device, samples):
    """The light (SEEDS, h, w, 2) of both lobes in the first frames of independent runs: means of three channels."""
    found = []
    with make_renderer(device, builtin("cornell_box"), SIZE, **ALONE, paths_short_history_samples=samples) as renderer:
        for renderer.seed in range(1000 * samples, 1000 * samples + SEEDS):
            renderer.reset()
            frame = renderer.render()
            lobes = [np.asarray(frame[name])[..., :3].mean(axis=-1) for name in ("paths_diffuse", "paths_specular")]
            found.append(np.stack(lobes, axis=-1))
    return np.array(found, np.float64).reshape(SEEDS, *SIZE[::-1], 2)


@pytest.mark.slow
def test_several_paths_keep_the_mean_and_lower_the_noise(device):
    """With several paths the lobes' means are those of one path, and their variances fall."""
    runs = [first_frames(device, samples) for samples in (1, PATHS)]
    means = [found.mean(axis=(1, 2)) for found in runs]
    noise = np.sqrt((means[0].var(axis=0, ddof=1) + means[1].var(axis=0, ddof=1)) / SEEDS)
    apart = np.abs(means[1].mean(axis=0) - means[0].mean(axis=0)) / noise
    spread = [found.var(axis=0, ddof=1).mean(axis=(0, 1)) for found in runs]
    variance = spread[1] / spread[0]
    print(apart, variance)
    assert (apart < 4).all(), f"the lobes' means are {apart} standard errors apart"
    assert (variance < 1.25 / PATHS).all(), f"the lobes' variances are {variance} of those of one path"


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "several paths: all are the same": (
            test_several_paths_keep_the_mean_and_lower_the_noise,
            Bug("passes/paths/first_ray.comp", "start_path", "return correct(pixel, surface, 0u);"),
        )
    }
)


def test_settled_pixels_take_one_path(device):
    """After nine frames of a still scene, all but the few pixels whose histories were cut have the light of one path,
    bit by bit."""
    pictures = []
    for samples in (1, PATHS):
        settings = ALONE | {"paths_short_history_samples": samples}
        with make_renderer(device, builtin("cornell_box"), SIZE, **settings) as renderer:
            pictures.append([render_frames(renderer, None, frames)["raw_radiance"].copy() for frames in (3, 6)])
    young, settled = ((one == several).all(axis=-1).mean() for one, several in zip(*pictures, strict=True))
    assert settled > 0.9
    assert young < 0.5


@pytest.mark.slow
def test_rays_are_counted_for_all_paths(device):
    counts = []
    for samples in (1, 2):
        settings = sv.Settings(paths_short_history_samples=samples, antialiasing=False)
        with sv.Renderer(device, builtin("cornell_box"), SIZE, settings, count_rays=True) as renderer:
            renderer.render()
            counts.append(int(renderer["ray_counts"][renderer.counted_passes.index("paths/first_ray")]))
    assert counts[1] == pytest.approx(2 * counts[0], rel=0.02)
