"""The setting upscale with the denoiser: a path in some pixels of the whole picture, by turns."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.frames import make_renderer, read_radiance
from support.scenes import camera_moved_by, white_wall
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require

import solari_vk as sv
from solari_vk.scene.builtin import builtin

SIZE = (12, 12)  # a multiple of the blocks of 2 x 2 and 3 x 3 pixels
FRAMES = 72
TURNS = Rule("each pixel takes a path in as many frames as others")
MOVING = Rule("surfaces that move by whole pixels a frame have half of the paths of others at least")


def paths_taken(device, upscale):
    """Which pixels took a path in each frame after the first one (frames, h, w)."""
    scene = white_wall()
    scene.add(sv.PointLight((0, 0, 0)))
    with make_renderer(device, scene, SIZE, denoise=True, world_cache=False, upscale=upscale) as renderer:
        assert renderer.render_size == SIZE
        renderer.render()
        return np.array([np.asarray(renderer.render()["paths_diffuse"])[..., 3] >= 0 for _ in range(FRAMES)])


def measure_turns(device):
    for upscale in (2.0, 3.0, 1.5):
        taken = paths_taken(device, upscale)
        off = np.abs(taken.sum(axis=0) - FRAMES / upscale**2).max()
        yield Measurement(TURNS, float(off), 1.0, "paths of a pixel too many or too few", f"upscale={upscale}")


def measure_moving(device):
    taken = paths_taken(device, 2.0)
    for motion in itertools.product((-1, 0, 1, 2, 3), repeat=2):
        counts = sum(np.roll(frame, (-index * np.array(motion)), (0, 1)) for index, frame in enumerate(taken))
        missing = 1 - float(counts.min()) / (FRAMES / 4)
        yield Measurement(MOVING, missing, 0.5, "of a surface's paths are missing", f"motion {motion}")


@pytest.mark.parametrize("measure", [measure_turns, measure_moving])
def test_rules_hold(device, measure):
    require(measure(device))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        TURNS: (
            measure_turns,
            Bug(
                "passes/paths/short_history.glsl",
                "turn_count",
                "return find_pixel_of(index).x > 0u ? correct(index, number) : 0u;",
            ),
        ),
        MOVING: (measure_moving, Bug("common/hash.glsl", "seed_rng", "return correct(pixel, 0u * number, seed) & 0u;")),
    }
)


def test_the_means_are_those_of_all_paths(device):
    """Of raw frames, the light of whose few pixels counts for all, and of denoised ones. With 1.1 a pixel may have two
    turns in a frame."""
    found = {}
    for upscale in (1.0, 1.1, 2.0):
        with make_renderer(device, builtin("cornell_box"), (32, 32), denoise=True, upscale=upscale) as renderer:
            raw, shown = np.zeros((2, 32, 32, 3))
            for _ in range(96):
                frame = renderer.render()
                raw += read_radiance(frame, "raw_radiance")
                shown += read_radiance(frame)
        found[upscale] = np.array([raw.mean(), shown.mean()])
    for upscale in (1.1, 2.0):
        ratios = found[upscale] / found[1.0]
        print("upscale {}: raw {:.4f}, denoised {:.4f} of the mean with all paths".format(upscale, *ratios))
        assert np.abs(ratios - 1).max() < 0.02


def test_what_comes_into_view_takes_a_path(device):
    """That is all of the first frame, then what a moved camera shows first; the rest takes its turns."""
    scene = white_wall()
    scene.add(sv.PointLight((0, 0, 0)))
    with make_renderer(device, scene, SIZE, denoise=True, world_cache=False, upscale=3.0) as renderer:
        first = renderer.render(camera_moved_by(0))
        assert (np.asarray(first["paths_diffuse"])[..., 3] >= 0).all()
        moved = renderer.render(camera_moved_by(16))
        taken = np.asarray(moved["paths_diffuse"])[..., 3] >= 0
    new = np.flatnonzero(taken.all(axis=0))
    assert new[0] > 2
    assert list(new) == list(range(new[0], SIZE[0]))
    assert taken[:, : new[0]].mean() < 0.25


def test_pixels_without_a_path_darken_nothing_that_moves(device):
    """Seen 4 % too dark when histories without a path counted as black."""
    means = []
    for upscale in (1.0, 2.0):
        scene = white_wall()
        scene.add(sv.PointLight((0, 0, 0)))
        with make_renderer(device, scene, (48, 32), denoise=True, world_cache=False, upscale=upscale) as renderer:
            frames = [renderer.render(camera_moved_by(0.7 * number)) for number in range(12)]
            means.append(read_radiance(frames[-1])[:, 8:-8].mean())
    assert means[1] == pytest.approx(means[0], rel=0.01)
