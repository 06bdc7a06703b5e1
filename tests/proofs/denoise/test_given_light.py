"""The denoiser, given noise in closed form in place of the light of paths: its rules, and a seeded bug for each."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from support.frames import frames_in_history
from support.given_light import DISTANCE, PIXEL, SIZE, moved, rendering, wall
from support.measured import hold
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule

_DENOISER = (SUITE, "Denoiser")
EVEN = Rule("noise around an even light becomes that light, pixel by pixel and on average", *_DENOISER)
ERROR = Rule("the estimated error of an even light is 0.8 to 2.5 times its deviation", *_DENOISER)
RETURNED = Rule("light by one sample in 100, or in 500, is in the picture when histories are long", *_DENOISER)
FOUND = Rule("histories are found after motion by known numbers of pixels", *_DENOISER)
NEW = Rule("what comes into view has no history", *_DENOISER)
SHARP = Rule("motion by parts of a pixel keeps patterns of light", *_DENOISER)
FORGOTTEN = Rule("a light that goes out is forgotten in a frame", *_DENOISER)
NOT_FINITE = Rule("light that isn't finite changes no pixel", *_DENOISER)
EDGES = Rule("the blur doesn't cross edges", *_DENOISER)
TURNS = Rule("of two surfaces that a pixel shows by turns, both keep their histories", *_DENOISER)
KEPT = Rule("the mean light of smooth surfaces is kept while the camera moves", *_DENOISER)
PASSES = ("gbuffer/", "guides/", "denoise/", "paths/compose", "taa/")
# `noise` has a long tail and the mean 1; `pixel` and `this_frame.index` are known to expressions too.
_GIVEN = """{pixel}
    uint rng = seed_rng(uvec2(pixel), this_frame.index, 0x5EED5EEDu);
    float u = rand_f(rng), noise = 4.0 * u * u * u;
    return vec4(vec3({light}), 1.0);"""
_PIXEL_OF_INDEX = "ivec2 pixel = ivec2(index % camera.size.x, index / camera.size.x);"


@contextmanager
def _denoising(device, scene, light, jitter=False):
    """A renderer whose paths found this light, a GLSL expression."""
    body = _GIVEN.format(pixel=_PIXEL_OF_INDEX, light=light)
    settings = {"denoise": True, "jitter": jitter}
    with rendering(device, scene, "passes/denoise/sample.glsl", "diffuse_sample", body, PASSES, **settings) as renderer:
        yield renderer


def _shining(device, light, frames):
    """The specular light of a smooth metal wall after some frames, in which the camera moves by 2 pixels each."""
    scene, body = wall(), _GIVEN.format(pixel="", light=light)
    scene.instances[0].material = sv.Material(base_color=np.ones(3, np.float32), metallic=1.0, perceptual_roughness=0.3)
    settings = {"denoise": True, "jitter": False}
    with rendering(
        device, scene, "passes/denoise/sample.glsl", "specular_sample", body, PASSES, **settings
    ) as renderer:
        for number in range(frames):
            frame = renderer.render(moved(2.0 * number))
        return np.asarray(frame["specular_radiance"], np.float64)[3:-3, 16:-16, 1]


def _light(frame):
    """Luminance, (h, w), over that of a light of 1."""
    return np.asarray(frame["diffuse_radiance"], np.float64)[..., 1]


def _scale(device, scene):
    """The picture of a light of 1: what the surfaces reflect of it."""
    with _denoising(device, scene, "1.0") as renderer:
        return _light(renderer.render())


def measure_even_light(device):
    """Frames 1, 4, 16 and 64 of noise around 1."""
    scene = wall()
    scale = _scale(device, scene)
    with _denoising(device, scene, "noise") as renderer:
        for number in range(1, 65):
            frame = renderer.render()
            if number not in (1, 4, 16, 64):
                continue
            off = _light(frame) / scale - 1
            deviation, note = float(np.sqrt((off**2).mean())), f"frame {number}"
            noise = 1.134 / number**0.5  # the standard deviation of the mean of as many samples
            yield Measurement(EVEN, abs(float(off.mean())), 0.03 if number == 1 else 0.015, "of the mean", note)
            yield Measurement(EVEN, deviation, max(noise / 8, 0.04), "deviation of pixels", note)
            ratio = float(np.sqrt((np.asarray(frame["error"], np.float64) ** 2 / scale**2).mean())) / deviation
            middle, most = (0.8 * 2.5) ** 0.5, (2.5 / 0.8) ** 0.5
            yield Measurement(ERROR, max(ratio / middle, middle / ratio), most, f"times off {middle:.2f}", note)


def measure_outliers(device):
    """Half of the light by one sample in 100 or 500: in few frames, the picture has less of it."""
    for once_in, bound in ((100, 0.04), (500, 0.06)):
        mean = _mean_after(device, 64, f"0.5 + (u * {once_in}.0 < 1.0 ? {once_in / 2} : 0.0)")
        yield Measurement(RETURNED, abs(mean - 1), bound, "of the mean", f"one in {once_in}: {mean:.3f} of it")


def measure_motion(device):
    """The camera moves to the right, parallel to the wall. Light on the wall stays where it is."""
    scene = wall()
    scale = _scale(device, scene).mean()
    for step, rule in ((3.0, FOUND), (2.5, FOUND), (0.4, SHARP)):
        # A wave of 8 pixels on the wall.
        place = f"float(pixel.x) + {step} * float(this_frame.index)"
        with _denoising(device, scene, f"1.0 + 0.5 * sin({2 * np.pi / 8} * ({place}))") as renderer:
            for number in range(12):
                frame = renderer.render(moved(step * number))
            lengths, picture = np.round(frames_in_history(frame)), _light(frame)
        note = f"{step} pixels a frame"
        if rule is FOUND:
            yield _count_unequal(FOUND, lengths[:, : SIZE[0] - int(11 * step) - 3], 12, note)
            # The first new column takes the history of the wall beside it.
            yield _count_unequal(NEW, lengths[:, SIZE[0] - int(step) + 1 :], 1, note)
        # In the middle of the picture all histories are long.
        columns = np.arange(8, 48)
        wave = np.sin(2 * np.pi / 8 * (columns + 11 * step))
        kept = 4 * float(((picture[:, columns] / scale - 1) * wave).mean())
        yield Measurement(SHARP, abs(kept - 1), 0.1, "of the contrast", f"{note}: {kept:.3f} of it")


def _mean_after(device, frames, light):
    """The mean of a denoised wall after some frames, where light of 1 would have the mean 1."""
    scene = wall()
    scale = _scale(device, scene)
    with _denoising(device, scene, light) as renderer:
        for _ in range(frames):
            frame = renderer.render()
        return float((_light(frame) / scale).mean())


def _count_unequal(rule, found, expected, note):
    return Measurement(rule, float((found != expected).sum()), 0.0, f"of {found.size} pixels", note)


def measure_light_off(device):
    """Noise around 1 for 32 frames, around 0.1 after it."""
    left = (_mean_after(device, 33, "this_frame.index < 32u ? noise : 0.1 * noise") - 0.1) / 0.9
    yield Measurement(FORGOTTEN, abs(left), 0.05, "of the old light")


def measure_smooth_surfaces(device):
    """Noise around 1, and 0.5 with one sample in twenty of 10.5."""
    scale = _shining(device, "1.0", 1).mean()
    for light in ("noise", "0.5 + (u < 0.05 ? 10.0 : 0.0)"):
        mean = float(_shining(device, light, 8).mean() / scale)
        yield Measurement(KEPT, abs(mean - 1), 0.08, "of the mean", f"{light}: {mean:.3f} of it")
    for value in ("0.0 / 0.0", "1.0 / 0.0"):
        wrong = "pixel == ivec2(40, 30) && (this_frame.index & 1u) == 0u"
        changed = _shining(device, f"{wrong} ? {value} : 1.0", 4) / scale
        yield _count_unequal(NOT_FINITE, np.abs(changed - 1) < 0.02, True, f"{value}, specular, in motion")


def measure_not_finite(device):
    """A pixel whose light is NaN or infinite in every second frame."""
    scene = wall()
    scale = _scale(device, scene)
    for value in ("0.0 / 0.0", "1.0 / 0.0", "-1.0 / 0.0"):
        wrong = "pixel == ivec2(40, 30) && (this_frame.index & 1u) == 0u"
        with _denoising(device, scene, f"{wrong} ? {value} : 1.0") as renderer:
            for _ in range(4):
                frame = renderer.render()
            changed = _light(frame) / scale
        yield _count_unequal(NOT_FINITE, np.abs(changed - 1) < 0.02, True, value)


def measure_edges(device):
    """Noise around 1 on the left half of the picture, around 3 on the right one, which shows another surface."""
    near, far, side = DISTANCE, 1.5 * DISTANCE, 5 * DISTANCE
    facing = [np.array([[x, -side, -z], [x + side, -side, -z], [x + side, side, -z], [x, side, -z]])
              for x, z in ((-side, near), (0.0, far))]  # fmt: skip
    corner = [np.array([[x, -side, -near - side * (x < 0)], [x + side, -side, -near - side * (x == 0)],
                        [x + side, side, -near - side * (x == 0)], [x, side, -near - side * (x < 0)]])
              for x in (-side, 0.0)]  # fmt: skip
    for name, quads in (("one nearer than the other", facing), ("an outer corner of 90 degrees", corner)):
        scene = wall(*quads)
        scale = _scale(device, scene)
        with _denoising(device, scene, f"(pixel.x < {SIZE[0] // 2} ? 1.0 : 3.0) * noise") as renderer:
            for _ in range(8):
                frame = renderer.render()
            beside = slice(SIZE[0] // 2 - 1, SIZE[0] // 2 + 1)
            columns = (_light(frame)[:, beside] / scale[:, beside]).mean(axis=0)
        leaks = (columns[0] - 1) / 2, (3 - columns[1]) / 2
        yield Measurement(EDGES, float(np.abs(leaks).max()), 0.05, "of the other side's light", name)


def measure_turns(device):
    """An edge in the middle of a column of pixels: samples to its left show a near wall, those to its right a far one.
    Noise around 1 for 32 frames, around 0.1 after it."""
    side, column = 5 * DISTANCE, SIZE[0] // 2
    walls = [np.array([[x - side, -side, z], [x, -side, z], [x, side, z], [x - side, side, z]])
             for x, z in ((PIXEL / 2, -DISTANCE), (side, -1.5 * DISTANCE))]  # fmt: skip
    for light in ("noise", "(this_frame.index < 32u ? 1.0 : 0.1) * noise"):
        with _denoising(device, wall(*walls), light, jitter=True) as renderer:
            for _ in range(34):
                frame = renderer.render()
            lengths, columns = frames_in_history(frame)[:, column], _light(frame).mean(axis=0)
        if light == "noise":
            yield Measurement(TURNS, float(np.abs(lengths - 17).max()), 2.0, "frames off the 17 that showed it")
        else:
            left = (columns[column] / columns[column - 8] - 1) / 9
            yield Measurement(FORGOTTEN, abs(float(left)), 0.05, "of the old light, at an edge")


# ---- each rule holds, and can fail --------------------------------------------------------------------

MEASURES = (measure_even_light, measure_outliers, measure_motion, measure_light_off, measure_smooth_surfaces,
            measure_not_finite, measure_edges, measure_turns)  # fmt: skip


@pytest.mark.parametrize("measure", MEASURES, ids=lambda measure: measure.__name__)
def test_rules_hold(device, measure):
    hold(measure(device))


TEMPORAL, PAST, BLUR = "passes/denoise/temporal.comp", "passes/denoise/previous_frame.glsl", "passes/denoise/blur.comp"
test_a_seeded_bug_is_noticed = bug_tests({
    EVEN: (measure_even_light, Bug(BLUR, "add_neighbor",
                                   "correct(sum, center, other, difference, 0.0, is_filtered);")),
    ERROR: (measure_even_light, Bug("passes/denoise/constants.glsl", "ERROR_OVER_NOISE", "0.5")),
    RETURNED: (measure_outliers, Bug(BLUR, "add_neighbor", "correct(sum, center, other, difference, weight, false);")),
    FOUND: (measure_motion, Bug(PAST, "in_pixels", "return correct(-motion);")),
    NEW: (measure_motion, Bug(PAST, "add_tap", "correct(taps, clamp(pixel, ivec2(0), ivec2(camera.size) - 1), weight, "
                              "previous, guide, plane_distance);")),
    SHARP: (measure_motion, Bug(
        PAST, "find_taps", "return correct(floor(where) + 0.5, previous, guide, plane_distance);")),
    FORGOTTEN: (measure_light_off, Bug(
        "passes/denoise/history_confidence.comp", "confidence(Gradient", "return 1.0;")),
    NOT_FINITE: (measure_not_finite, Bug("common/math.glsl", "is_valid", "return true;")),
    EDGES: (measure_edges, Bug("passes/denoise/edge_stopping.glsl", "edge_stopping_weights", "edges.plane = vec3(0.0); "
                               "edges.plane_offset = 0.0; return correct(edges, other, step);")),
    TURNS: (measure_turns, Bug(
        "passes/denoise/alternate_history.glsl", "unpack_alternate", "diffuse = specular = NO_HISTORY;")),
    KEPT: (measure_smooth_surfaces, Bug(TEMPORAL, "blend", "LobeHistory both = correct(a, b, share); "
                                        "both.radiance *= 0.9; return both;")),
}, quick=(FORGOTTEN,))  # fmt: skip
