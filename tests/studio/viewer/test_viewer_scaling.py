"""The scale of the picture follows the time of a frame; a formula stands for that time."""

from __future__ import annotations

import random

import pytest

import solari_vk as sv
from solari_vk.passes.taa import render_size
from solari_vk.studio.viewer.scaling import MIN_SCALE, STEPS, Build, ScaleControl, Upscaling


def settle(control, fixed, growth, frames=300, noise=0.0):
    """Note frames of fixed + growth * scale^2 seconds; returns how often the scale changes in the second half."""
    generator = random.Random(5)
    changes = 0
    for frame in range(frames):
        time = (fixed + growth * control.scale**2) * (1 + noise * generator.uniform(-1, 1))
        changes += control.record_frame(time) and frame > frames // 2
    return changes


@pytest.mark.parametrize(("fixed", "growth"), [(0.0, 1.0), (0.01, 0.5), (0.03, 0.2), (0.0, 0.11), (1e-4, 1e-3)])
def test_frames_meet_the_time_limit(fixed, growth):
    control = ScaleControl("auto", 0.1)
    assert settle(control, fixed, growth) == 0, "the scale settles"
    assert fixed + growth * control.scale**2 <= 0.1
    larger = STEPS[min(STEPS.index(control.scale) + 2, len(STEPS) - 1)]
    assert control.scale == 1 or fixed + growth * larger**2 > 0.1 * 0.7, "the picture is no smaller than it must be"


def test_a_time_limit_out_of_reach_does_not_ruin_the_picture():
    control = ScaleControl("auto", 0.02)
    settle(control, 0.1, 0.1)
    assert 0.5 <= control.scale < 1, "a smaller picture would hardly be faster"
    hopeless = ScaleControl("auto", 0.001)
    settle(hopeless, 0.0, 100.0)
    assert hopeless.scale == MIN_SCALE


def test_noise_does_not_make_the_scale_oscillate():
    assert settle(ScaleControl("auto", 0.1), 0.01, 0.5, frames=1000, noise=0.1) <= 6


def test_the_scale_grows_when_frames_become_faster():
    control = ScaleControl("auto", 0.1)
    settle(control, 0.0, 2.0)
    small = control.scale
    control.forget_times()
    settle(control, 0.0, 0.2)
    assert control.scale > small


def test_a_fixed_scale_stays():
    control = ScaleControl(0.37)
    settle(control, 1.0, 1.0)
    assert control.scale == 0.37
    control.fix(7)
    assert control.scale == 1
    for scale in ("fast", 0, 2, "nan", None):
        with pytest.raises(sv.SolariError, match="scale"):
            ScaleControl(scale)


def test_the_realtime_picture_is_upscaled_to_the_window():
    """As far as the renderer can upscale: by 3. What it renders then is the share of the window that was asked for."""
    for scale, upscale, realtime, reference in (
        (1.0, 1, (640, 360), (640, 360)),
        (0.5, 2, (640, 360), (320, 180)),
        (0.25, 3, (480, 270), (160, 90)),
        (0.1, 3, (192, 108), (64, 36)),
    ):
        build = Build.of((640, 360), scale, False)
        assert (build.upscale, build.realtime, build.reference) == (upscale, realtime, reference)
        assert render_size(build.realtime, sv.Settings(upscale=build.upscale, denoise=False)) == reference
    build = Build.of((1, 2), 0.1, False)
    assert (build.realtime, build.reference) == ((1, 1), (1, 1))


def test_the_users_upscale_overrides_the_scale_until_the_scale_changes():
    user = sv.Settings()
    upscaling = Upscaling(user)
    assert upscaling.follow(user, 2.0).upscale == upscaling.factor(user) == 2
    user.denoise = not user.denoise
    assert upscaling.follow(user, 2.0).upscale == 2, "another setting is no choice of this one"
    for chosen in (1.5, 1.0):
        user.upscale = chosen
        assert upscaling.factor(user) == chosen, "panels show it before the next frame"
        assert upscaling.follow(user, 2.0).upscale == chosen
    assert upscaling.follow(user, 2.5).upscale == 2.5
    upscaling.prefer(user)
    assert upscaling.follow(user, 2.5).upscale == user.upscale == 1
