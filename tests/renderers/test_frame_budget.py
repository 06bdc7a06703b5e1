"""The setting frame_ms: frames take the time that is asked for, and pixels without a path keep their light's mean."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import Effort, make_renderer, observe_runs, read_radiance, render_frames
from support.seeded_bugs import Bug, Rule, bug_tests, require
from support.statistics import measure_mean, measure_tiles_t

import solari_vk as sv
from solari_vk.renderers.frame_budget import MAX_SHARE, MIN_SHARE, FrameBudget
from solari_vk.scene.builtin import builtin

SIZE = (32, 32)
PLAIN = {"denoise": True, "world_cache": False, "paths_bounces": 2, "paths_short_history_samples": 2}
MEAN = Rule("frames with half of the paths have the mean of those with all")
TILES = Rule("so has each of 4 x 4 tiles")


def device_times(control, target, frames=400, paths=lambda frame: 4.0, cuts=(), hitches=(), noise=0.05, delay=2):
    """The times of the frames of a device whose other passes take 2 ms and its paths `paths(frame)` at a share of 1,
    each up to `noise` (a standard deviation); they are known `delay` frames later. After a cut pixels take two paths
    for 8 frames, one at least in the first, at first of 1.5 times the length. Hitches take ten times as long."""
    random = np.random.default_rng(1)
    times = []
    history = 0.0
    for frame in range(frames):
        if frame >= delay:
            control.record_times(frame - delay, times[frame - delay])
        cut = frame == 0 or frame in cuts
        share = control.choose(target, 2, cut)
        control.record_submission(frame)
        history = 0.0 if cut else history
        count = max(min(share * (2 if history < 8 else 1), 2.0), float(history < 1))
        length = 1.5 if history < 3 else 1.0
        history += min(count, 1.0)
        spread = np.exp(noise * random.standard_normal(2)) * (10 if frame in hitches else 1)
        traced = 0.3 + paths(frame) * count * length
        times.append({"paths/first_ray": traced * spread[0], "taa/resolve": 2.0 * spread[1]})
    return np.array([sum(passes.values()) for passes in times])


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.1])
@pytest.mark.parametrize(
    "case",
    [
        {},
        {"paths": lambda frame: 4.0 if frame < 200 else 7.0},
        {"paths": lambda frame: 7.0 if frame < 200 else 4.0},
        {"cuts": (100, 200, 300)},
        {"paths": lambda frame: 4.0 + 2.0 * np.sin(frame / 20)},
    ],
    ids=["steady", "slower", "faster", "cuts", "waves"],
)
def test_the_percentile_holds(case, noise):
    for target in (4.0, 6.0, 8.0):
        control = FrameBudget()
        found = np.percentile(device_times(control, target, noise=noise, **case), 95) / target
        assert 0.9 < found < 1.1, f"{target} ms: {found:.3f}"
        assert control.limit == ""


def test_slower_frames_are_followed_at_once():
    """Their times are known two frames later, and two of them count."""
    paths = lambda frame: 4.0 if frame < 200 else 9.0  # noqa: E731
    times = device_times(FrameBudget(), 6.0, frames=220, paths=paths, noise=0.0)
    assert (times[200:203] > 1.1 * 6.0).all()
    assert (times[203:] < 1.1 * 6.0).all()


def test_one_slow_frame_costs_no_paths():
    """Neither the first one nor one later."""
    times = device_times(FrameBudget(), 6.0, hitches=(0, 200), noise=0.0)
    assert (times[16:200] > 0.9 * 6.0).all()
    assert (times[201:] > 0.85 * 6.0).all()


@pytest.mark.parametrize("samples", [1, 2, 4])
def test_pixels_with_a_short_history_take_no_more_than_they_may(samples):
    """A device of plenty: first 4 paths or 2, then 2."""
    control = FrameBudget()
    control.record_submission(0)
    for frame in range(1, 12):
        control.record_times(frame - 1, {"paths/first_ray": 1.0})
        control.choose(1e3, samples, frame == 1, 4.0)
        count = control._next[0]
        control.record_submission(frame)
        if frame > 2:
            assert count == (max(samples, 2) if frame < 5 else 2.0)


def test_it_says_what_it_cannot_hold():
    control = FrameBudget()
    for target, share, limit in ((1.0, MIN_SHARE, "fewest paths"), (20.0, MAX_SHARE, "most paths"), (5.0, None, "")):
        times = device_times(control, target)
        assert control.limit == limit
        assert share in (None, control.share)
        assert (np.percentile(times[-64:], 95) > 1.1 * target) == (limit == "fewest paths")
        control = FrameBudget()


class FixedShare(FrameBudget):
    def choose(self, *_, **__):
        return self.share


def with_share(device, share, scene=None, **settings):
    chosen = PLAIN | settings | {"frame_ms": 1.0}
    renderer = make_renderer(device, scene or builtin("cornell_box"), SIZE, **chosen)
    renderer.frame_time = FixedShare()
    renderer.frame_time.share = share
    return renderer


def check_mean(device, **settings):
    """Denoised frames with half of the paths against those with all."""
    effort, found = Effort(), []
    for share in (0.5, 1.0):
        with with_share(device, share, **settings) as renderer:
            found.append(observe_runs(renderer, renderer.binder.scene.camera, effort, read_radiance))
    half, whole = found
    return [measure_mean(MEAN, half, whole.mean(axis=0), 0.005, effort), measure_tiles_t(TILES, half, whole)]


@pytest.mark.slow
def test_half_of_the_paths_have_the_same_mean(device):
    require(check_mean(device))


@pytest.mark.slow
def test_so_they_have_with_the_world_cache(device):
    """With the default's bounces: where fewer paths know fewer cells, they go on until light is negligible."""
    require(check_mean(device, world_cache=True, paths_bounces=sv.Settings().paths_bounces))


test_a_seeded_bug_is_noticed = bug_tests(
    {
        MEAN: (
            check_mean,
            Bug("passes/denoise/noisy_input.glsl", "has_no_path", "return correct(radiance_hit_distance) && false;"),
        )
    }
)


def test_pixels_take_no_one_or_two_paths(device):
    with with_share(device, 0.5, jitter=False) as renderer:
        first = np.asarray(renderer.render()["paths_diffuse"])[..., 3]
        later = [np.asarray(render_frames(renderer, None, 12)["paths_diffuse"])[..., 3] < 0 for _ in range(2)]
        assert (first >= 0).all(), "pixels without a history take a path"
        assert all(0.45 < skipped.mean() < 0.55 for skipped in later)
        assert (later[0] != later[1]).any()
        lit = np.asarray(renderer["raw_radiance"]).any(axis=-1)
        shown = np.asarray(renderer["sample_radiance"]).any(axis=-1)
        assert (shown >= lit).all()
        assert shown[later[1]].all(), "pixels without a path show their history"


def test_few_paths_follow_a_lamp(device):
    """The share of the former light that is left: pixels without a path show it in one frame and no longer."""
    scene = builtin("cornell_box")
    lamp = scene.instances["lamp"].material
    with with_share(device, MIN_SHARE, scene, world_cache=True, jitter=False) as renderer:
        before = read_radiance(render_frames(renderer, None, 64)).mean()
        lamp.emissive = tuple(0.2 * np.array(lamp.emissive))
        left = [(read_radiance(renderer.render()).mean() / before - 0.2) / 0.8 for _ in range(8)]
    assert left[0] < 0.5
    assert np.abs(left[1:]).max() < 0.05, left


@pytest.mark.slow
def test_all_of_the_paths_are_the_frame_without_it(device):
    """Bit by bit, while histories are short and later."""
    with with_share(device, 1.0) as timed, make_renderer(device, builtin("cornell_box"), SIZE, **PLAIN) as plain:
        for frames in (1, 3, 12):
            assert np.array_equal(*(render_frames(renderer, None, frames)["radiance"] for renderer in (timed, plain)))


def test_on_a_device(device):
    with make_renderer(device, builtin("cornell_box"), SIZE, **PLAIN, frame_ms=1e-3) as renderer:
        for frame_ms, share, limit in ((1e-3, MIN_SHARE, "fewest paths"), (1e4, MAX_SHARE, "most paths")):
            renderer.settings.frame_ms = frame_ms
            render_frames(renderer, None, 16)
            assert (renderer.frame_time.share, renderer.frame_time.limit) == (share, limit)
        control = renderer.frame_time
        renderer.resize((16, 16))
        renderer.render()
        assert renderer.frame_time is not control
        renderer.settings.denoise = False
        renderer.render()
        assert (renderer.frame_time.share, renderer.frame_time.limit) == (1.0, "denoise=off")
        assert len(renderer.frame_time._submitted) < 4
        renderer.settings.frame_ms = 0.0
        render_frames(renderer, None, 4)
        assert not renderer.frame_time._submitted, "frames without frame_ms are not noted"
        renderer.settings.frame_ms = 1.0
        renderer.settings.reset("denoise")
        for name, value in (("restir", True), ("lighting", "split")):
            setattr(renderer.settings, name, value)
            with pytest.raises(sv.SolariError, match="frame_ms needs lighting=paths and restir=off"):
                renderer.render()
            renderer.settings.reset(name)
        renderer.render()
    with pytest.raises(sv.SolariError, match="frame_ms=0"):
        sv.Batch(device, builtin("cornell_box"), SIZE, 2, renderer="realtime", settings=sv.Settings(frame_ms=8.0))
