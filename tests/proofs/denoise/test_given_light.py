"""The denoiser, given noise in closed form in place of the light of paths: its rules, and a seeded bug for each."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from support.frames import frames_in_history, frames_of_known_light
from support.scenes import WALL_DISTANCE, WALL_PIXEL, WALL_SIZE, camera_moved_by, white_wall
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.scene import shapes

PASSES = ("gbuffer/", "guides/", "denoise/", "display/compose", "taa/")
# `noise` has a long tail and the mean 1; `pixel` and `this_frame.index` are known to expressions too.
GIVEN = """{pixel}
    uint rng = seed_rng(uvec2(pixel), this_frame.index, 0x5EED5EEDu);
    float u = rand_f(rng), noise = 4.0 * u * u * u;
    return vec4(vec3({light}), 1.0);"""


@contextmanager
def denoising(device, scene, light, lobe="diffuse", **settings):
    """A renderer whose paths found this light, a GLSL expression."""
    pixel = "ivec2 pixel = ivec2(index % camera.size.x, index / camera.size.x);" if lobe == "diffuse" else ""
    body, settings = GIVEN.format(pixel=pixel, light=light), {"denoise": True, "jitter": False, **settings}
    source = "passes/denoise/noisy_input.glsl"
    with frames_of_known_light(device, scene, source, f"noisy_{lobe}", body, PASSES, **settings) as renderer:
        yield renderer


def light_of(frame):
    """Luminance, (h, w), over that of a light of 1."""
    return np.asarray(frame["diffuse_radiance"], np.float64)[..., 1]


def last_of(renderer, frames):
    for _ in range(frames):
        frame = renderer.render()
    return frame


def after(device, frames, light, scene=None):
    """Light (h, w) after some frames over the picture of a light of 1: what the surfaces reflect of it."""
    scene, pictures = scene or white_wall(), []
    for count, given in ((frames, light), (1, "1.0")):
        with denoising(device, scene, given) as renderer:
            pictures.append(light_of(last_of(renderer, count)))
    return pictures[0] / np.where(pictures[1] > 0, pictures[1], 1.0)


def shining(device, light, frames):
    """The specular light of a smooth metal wall after some frames, in which the camera moves by 2 pixels each."""
    scene = white_wall()
    scene.instances[0].material = sv.Material(base_color=1.0, metallic=1.0, perceptual_roughness=0.3)
    with denoising(device, scene, light, "specular") as renderer:
        for number in range(frames):
            frame = renderer.render(camera_moved_by(2.0 * number))
        return np.asarray(frame["specular_radiance"], np.float64)[3:-3, 16:-16, 1]


def check_even_light(device):
    """Noise around an even light becomes that light, on average and pixel by pixel, and the estimated error is 0.8 to
    2.5 times its deviation."""
    scene = white_wall()
    with denoising(device, scene, "1.0") as renderer:
        scale = light_of(renderer.render())
    with denoising(device, scene, "noise") as renderer:
        for number in range(1, 65):
            frame = renderer.render()
            if number not in (1, 4, 16, 64):
                continue
            off = light_of(frame) / scale - 1
            deviation, noise = np.sqrt((off**2).mean()), 1.134 / number**0.5  # that of the mean of as many samples
            ratio = np.sqrt(((frame["error"] / scale) ** 2).mean()) / deviation
            print(f"frame {number}: mean {off.mean():+.4f}, deviation {deviation:.4f}, error {ratio:.2f} times it")
            assert abs(off.mean()) < (0.03 if number == 1 else 0.015)
            assert deviation < max(noise / 8, 0.04)
            assert 0.8 < ratio < 2.5


def check_outliers(device):
    """Light by one sample in 100, or in 500, is in the picture when histories are long."""
    for once_in, bar in ((100, 0.04), (500, 0.06)):
        light = f"0.5 + (u * {once_in}.0 < 1.0 ? {once_in / 2} : 0.0)"
        assert after(device, 64, light).mean() == pytest.approx(1, abs=bar), once_in


def check_spread_light(device):
    """Light by one pixel in 256, another one in each frame, is in the picture from the first frame on: what is taken
    from fireflies is spread, as light and as error."""
    light = "0.5 + ((pixel.x + 5 * int(this_frame.index)) % 16 == 3 && pixel.y % 16 == 7 ? 128.0 : 0.0)"
    for frames in (1, 4, 16):
        found = after(device, frames, light)
        print(f"frame {frames}: mean {found.mean():.3f}, from {found.min():.2f} to {found.max():.2f}")
        assert found.mean() == pytest.approx(1, abs=0.01), frames
        assert found.min() > 0.4
        assert found.max() < 4
    with denoising(device, white_wall(), light) as renderer:
        frame = renderer.render()
        assert frame["error"].mean() > 0.4 * light_of(frame).mean()


def check_rare_reflections(device):
    """On a smooth ball, whose normals keep the blur narrow, reflections by one sample in 20 have less noise the longer
    the history is: 0.23 and 0.16 of the light were measured, 0.23 and 0.30 where pixels with 40 frames are judged by
    their own spread alone."""
    metal = sv.Material(base_color=1.0, metallic=1.0, perceptual_roughness=0.15)
    scene = sv.Scene(sv.Instance(shapes.sphere(1.0, 64), metal), sv.PointLight((0, 0, 9)))
    scene.add(sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.8))
    found = {}
    for light, looks in (("1.0", (1,)), ("u * 20.0 < 1.0 ? 20.0 : 0.0", (39, 64))):
        with denoising(device, scene, light, "specular") as renderer:
            for number in range(1, max(looks) + 1):
                frame = renderer.render()
                if number in looks:
                    found[number] = np.asarray(frame["specular_radiance"], np.float64)[16:-16, 32:-32, 1]
    young, old = (found[number] / found[1] for number in (39, 64))
    print(f"frame 39: {young.std():.3f}, frame 64: {old.std():.3f}, mean {old.mean():.3f}")
    assert young.std() < 0.28
    assert old.std() < 0.2
    assert old.mean() == pytest.approx(1, abs=0.05)


def move(device, step):
    """The lengths of histories and the light after twelve frames in which the camera moves parallel to a wall, by
    `step` pixels to the right in each. A wave of 8 pixels stays where it is on the wall."""
    place = f"float(pixel.x) + {step} * float(this_frame.index)"
    with denoising(device, white_wall(), f"1.0 + 0.5 * sin({2 * np.pi / 8} * ({place}))") as renderer:
        for number in range(12):
            frame = renderer.render(camera_moved_by(step * number))
        return np.round(frames_in_history(frame)), light_of(frame)


def check_motion(device):
    """Histories are found after motion by known numbers of pixels. What comes into view has none; its first column
    takes that of the wall beside it."""
    for step in (3.0, 2.5):
        lengths, _ = move(device, step)
        assert (lengths[:, : WALL_SIZE[0] - int(11 * step) - 3] == 12).all(), step
        assert (lengths[:, WALL_SIZE[0] - int(step) + 1 :] == 1).all(), step


def check_sharp(device):
    """Motion by parts of a pixel keeps patterns of light: in the middle of the picture, where histories are long."""
    columns = np.arange(8, 48)
    with denoising(device, white_wall(), "1.0") as renderer:
        scale = light_of(renderer.render()).mean()
    for step in (2.5, 0.4):
        wave = np.sin(2 * np.pi / 8 * (columns + 11 * step))
        kept = 4 * ((move(device, step)[1][:, columns] / scale - 1) * wave).mean()
        assert kept == pytest.approx(1, abs=0.1), step


def check_light_off(device):
    """A light that goes out is forgotten in a frame: noise around 1 for 32 frames, around 0.1 after it."""
    left = (after(device, 33, "this_frame.index < 32u ? noise : 0.1 * noise").mean() - 0.1) / 0.9
    assert abs(left) < 0.05


def check_light_off_at_once(device):
    """So is light that has been there for two frames, if a light of the scene's has changed."""
    scene = white_wall()
    lamp = scene.add(sv.PointLight((0, 0, 0), intensity=100.0))
    with denoising(device, scene, "(this_frame.index < 2u ? 1.0 : 0.1) * noise") as renderer:
        before = light_of(last_of(renderer, 2)).mean()
        lamp.intensity = 10.0
        left = (light_of(renderer.render()).mean() / before - 0.1) / 0.9
    assert abs(left) < 0.05


def check_new_beside_old(device):
    """Pixels that come into view say nothing of a change: beside them even light keeps its history, though a lamp
    changes."""
    scene = white_wall()
    lamp = scene.add(sv.PointLight((0, 0, 0), intensity=100.0))
    with denoising(device, scene, "1.0") as renderer:
        last_of(renderer, 8)
        lamp.intensity = 10.0
        lengths = frames_in_history(renderer.render(camera_moved_by(8.0)))
    assert lengths.min() == 1, "8 columns are new"
    assert np.abs(lengths[:, :-12] - 9).max() < 0.5


def check_smooth_surfaces(device):
    """The mean light of smooth surfaces is kept while the camera moves: noise around 1, and 0.5 with one sample in
    twenty of 10.5."""
    scale = shining(device, "1.0", 1).mean()
    for light in ("noise", "0.5 + (u < 0.05 ? 10.0 : 0.0)"):
        assert shining(device, light, 8).mean() / scale == pytest.approx(1, abs=0.08), light


def check_not_finite(device):
    """Pixels whose light is NaN or infinite in every second frame change none, also of a smooth wall in motion."""
    light = "1.0"
    for pixel, value in (("40, 30", "0.0 / 0.0"), ("30, 20", "1.0 / 0.0"), ("50, 50", "-1.0 / 0.0")):
        light = f"pixel == ivec2({pixel}) && (this_frame.index & 1u) == 0u ? {value} : {light}"
    np.testing.assert_allclose(after(device, 4, light), 1, atol=0.02)
    np.testing.assert_allclose(shining(device, light, 4) / shining(device, "1.0", 1).mean(), 1, atol=0.02)


def check_edges(device):
    """The blur doesn't cross edges: noise around 1 on the left half of the picture, around 3 on the right one, which
    shows another surface, farther away or behind a corner of 90 degrees."""
    near = WALL_DISTANCE
    far = 1.5 * WALL_DISTANCE
    side = 5 * WALL_DISTANCE
    facing = [
        np.array([[x, -side, -z], [x + side, -side, -z], [x + side, side, -z], [x, side, -z]])
        for x, z in ((-side, near), (0.0, far))
    ]
    corner = [
        np.array(
            [
                [x, -side, -near - side * (x < 0)],
                [x + side, -side, -near - side * (x == 0)],
                [x + side, side, -near - side * (x == 0)],
                [x, side, -near - side * (x < 0)],
            ]
        )
        for x in (-side, 0.0)
    ]
    middle = WALL_SIZE[0] // 2
    for quads in (facing, corner):
        found = after(device, 8, f"(pixel.x < {middle} ? 1.0 : 3.0) * noise", white_wall(*quads)).mean(axis=0)
        leaks = (found[middle - 1] - 1) / 2, (3 - found[middle]) / 2
        print(leaks)
        assert np.abs(leaks).max() < 0.05


def check_turns(device):
    """Of two surfaces that a pixel shows by turns, both keep their histories, and forget a light that goes out. An edge
    is in the middle of a column of pixels: samples to its left show a near wall, those to its right a far one."""
    side, column = 5 * WALL_DISTANCE, WALL_SIZE[0] // 2
    walls = [
        np.array([[x - side, -side, z], [x, -side, z], [x, side, z], [x - side, side, z]])
        for x, z in ((WALL_PIXEL / 2, -WALL_DISTANCE), (side, -1.5 * WALL_DISTANCE))
    ]
    with denoising(device, white_wall(*walls), "noise", jitter=True) as renderer:
        lengths = frames_in_history(last_of(renderer, 34))[:, column]
    assert np.abs(lengths - 17).max() < 2, "17 frames showed it"
    with denoising(device, white_wall(*walls), "(this_frame.index < 32u ? 1.0 : 0.1) * noise", jitter=True) as renderer:
        columns = light_of(last_of(renderer, 34)).mean(axis=0)
    assert abs(columns[column] / columns[column - 8] - 1) / 9 < 0.05


REPROJECT, BLUR = "passes/denoise/reproject.comp", "passes/denoise/blur.comp"
PREVIOUS_FRAME = "passes/denoise/previous_frame.glsl"
BUGS = {
    "reflections that are seldom found": (
        check_rare_reflections,
        Bug(
            "passes/denoise/variance.comp",
            "add_moments",
            "correct(sum, lobe, lobe.frames >= 40.0 && weight != CENTER_MOMENTS_WEIGHT ? 0.0 : weight);",
        ),
    ),
    "even light": (
        check_even_light,
        Bug(BLUR, "add_neighbor", "correct(sum, center, other, difference, 0.0, other_done);"),
    ),
    "estimated errors": (check_even_light, Bug("passes/denoise/constants.glsl", "ERROR_OVER_NOISE", "0.35")),
    "outliers": (
        check_outliers,
        Bug(
            "passes/denoise/variance.comp",
            "estimate_signal",
            "Signal found = correct(lobe, sum, trimmed_mean_luminance); "
            "found.radiance *= min(sum.luminance_sum / max(sum.weight_sum * luminance(found.radiance), 1e-9), 1.0); "
            "return found;",
        ),
    ),
    "spread light": (check_spread_light, Bug("passes/denoise/removed_light.glsl", "gains_at", "return vec2(0.0);")),
    "histories": (check_motion, Bug(PREVIOUS_FRAME, "motion_in_pixels", "return correct(-motion);")),
    "new pixels": (
        check_motion,
        Bug(
            PREVIOUS_FRAME,
            "add_tap",
            "correct(taps, clamp(pixel, ivec2(0), ivec2(camera.size) - 1), weight, previous, guide, plane_distance);",
        ),
    ),
    "patterns": (
        check_sharp,
        Bug(PREVIOUS_FRAME, "find_taps", "return correct(floor(position) + 0.5, previous, guide, plane_distance);"),
    ),
    "light off": (check_light_off, Bug("passes/denoise/history_confidence.comp", "confidence(Gradient", "return 1.0;")),
    "light off at once": (check_light_off_at_once, Bug("passes/denoise/constants.glsl", "YOUNG_VARIANCE_RATIO", "1e9")),
    "new beside old": (
        check_new_beside_old,
        Bug(
            "passes/denoise/temporal_gradient.comp",
            "add_pixel",
            "if (history.frames == 0.0) { add_gradient(young, compared(radiance), 0.0); } "
            "correct(cell, compared_sum, young, history, radiance);",
        ),
    ),
    "not finite": (check_not_finite, Bug("common/math.glsl", "is_finite_color", "return true;")),
    "edges": (
        check_edges,
        Bug(
            "passes/denoise/edge_stopping.glsl",
            "edge_stopping_weights",
            "edges.plane = vec3(0.0); edges.plane_offset = 0.0; return correct(edges, other, step);",
        ),
    ),
    "turns": (
        check_turns,
        Bug("passes/denoise/alternate_history.glsl", "unpack_alternate", "diffuse = specular = NO_HISTORY;"),
    ),
    "smooth surfaces": (
        check_smooth_surfaces,
        Bug(REPROJECT, "blend", "LobeHistory both = correct(a, b, share); both.radiance *= 0.9; return both;"),
    ),
}
test_a_seeded_bug_is_noticed = bug_tests(BUGS, quick=("light off",))


@pytest.mark.parametrize("check", dict.fromkeys(check for check, _ in BUGS.values()), ids=lambda check: check.__name__)
def test_holds(device, check):
    check(device)
