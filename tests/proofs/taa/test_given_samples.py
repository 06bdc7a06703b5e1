"""Antialiasing and upscaling, given patterns on a wall in place of rendered light: rules, and a seeded bug for each."""

import numpy as np
import pytest
from support.frames import frames_of_known_light
from support.scenes import WALL_SIZE, camera_moved_by, white_wall
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require

import solari_vk as sv
from solari_vk.scene import shapes

EVEN = Rule("an even light stays as it is, also upscaled and in motion")
AREA = Rule("a pixel of a still picture tends to the mean of the light in its area")
COVERED = Rule("at rest all frames tell alike how much of a pixel a surface covers")
LATER = Rule("at rest later samples tell more of a surface's light")
UPSCALED = Rule("an upscaled still picture tends to the mean of the light in each of its pixels")
SHARP = Rule("motion by parts of a pixel keeps patterns")
FOLLOWED = Rule("light that changes everywhere is followed in few frames")
NOISE = Rule("noise of samples becomes less with the square root of their number")
BLENDED = Rule("blended surfaces in motion show their alpha, with little noise")
NOT_FINITE = Rule("samples that aren't finite change no pixel")
PASSES = ("gbuffer/", "guides/", "denoise/reflection_motion", "taa/")
PLATE_DISTANCE = 1.5  # from the camera
SETTLED = 96  # frames: three times all positions in a pixel
SAMPLES = "passes/taa/samples.glsl"
# `at` is the sample's position in pixels of the picture, `noise` has the mean 1 and the deviation 0.577.
_GIVEN = """
    vec2 at = (vec2(pixel) + 0.5 + this_frame.sample_jitter) / render_scale();
    uint rng = seed_rng(uvec2(pixel), this_frame.index, 0x5EED5EEDu);
    float noise = 2.0 * rand_f(rng);
    return vec3({light});"""


def _picture(device, light, frames=SETTLED, step=0.0, upscale=1.0, scene=None):
    """The picture (h, w) of samples with this light, a GLSL expression, after some frames, in which the camera moves to
    the right by `step` pixels a frame. scene: by default a white wall."""
    body, settings = _GIVEN.format(light=light), {"antialiasing": True, "jitter": True, "upscale": upscale}
    scene = scene or white_wall()
    with frames_of_known_light(device, scene, SAMPLES, "load_sample", body, PASSES, **settings) as renderer:
        for number in range(frames):
            frame = renderer.render(camera_moved_by(step * number))
        return np.asarray(frame["radiance"], np.float64)[..., 1]


def _inside(picture):
    """A picture without its border, beyond which there are no samples."""
    return picture[3:-3, 3:-3]


def measure_even_light(device):
    """Light of 1 everywhere."""
    for step, upscale in ((0.0, 1.0), (0.0, 2.0), (0.7, 1.0), (0.7, 1.5)):
        off = np.abs(_picture(device, "1.0", 12, step, upscale) - 1).max()
        yield Measurement(EVEN, float(off), 1e-4, "of it", f"upscaled by {upscale}, {step} pixels a frame")


def measure_areas(device):
    """An edge that crosses pixels at an angle, and stripes 1.5 pixels wide: bright 3, dark 1."""
    y, x = np.indices((WALL_SIZE[1], WALL_SIZE[0]))
    fine = (np.arange(64) + 0.5) / 64
    columns, rows = x[..., None, None] + fine, y[..., None, None] + fine[:, None]
    patterns = (
        ("an edge", "at.x + 0.37 * at.y < 50.3 ? 3.0 : 1.0", columns + 0.37 * rows < 50.3),
        ("stripes", "mod(at.x, 3.0) < 1.5 ? 3.0 : 1.0", np.broadcast_to(columns % 3 < 1.5, (*x.shape, 64, 64))),
    )
    for rule, upscale, frames, bar in ((AREA, 1.0, SETTLED, 0.01), (UPSCALED, 2.0, 4 * SETTLED, 0.02)):
        for name, light, bright in patterns:
            off = _inside(_picture(device, light, frames, upscale=upscale) - (1 + 2 * bright.mean(axis=(-2, -1))))
            yield Measurement(rule, float(np.sqrt((off**2).mean())) / 2, bar, "of the contrast, rms", name)
            yield Measurement(rule, abs(float(off.mean())), 0.01, "off in the mean, which is about 2", name)


def measure_motion(device):
    """The camera moves to the right, parallel to a wall with a wave of 8 pixels."""
    whole = float(np.sinc(1 / 8))  # of the wave's contrast: pixels show the mean of their area
    for step, upscale, bar in ((3.0, 1.0, 0.02), (0.4, 1.0, 0.1), (0.4, 2.0, 0.1)):
        light = f"1.0 + 0.5 * sin({2 * np.pi / 8} * (at.x + {step} * float(this_frame.index)))"
        picture = _picture(device, light, 24, step, upscale)
        columns = np.arange(8, 56)
        wave = np.sin(2 * np.pi / 8 * (columns + 0.5 + 23 * step))
        kept = 4 * float(((picture[:, columns] - 1) * wave).mean()) / whole
        note = f"upscaled by {upscale}, {step} pixels a frame: {kept:.3f} of it"
        yield Measurement(SHARP, abs(kept - 1), bar, "of the contrast", note)


def measure_changes(device):
    """Light of 1 that is 0.1 after 40 frames, with and without a pattern."""
    for name, pattern in (("even", "1.0"), ("stripes", "(mod(at.x, 8.0) < 4.0 ? 1.5 : 0.5)")):
        light = f"(this_frame.index < 40u ? 1.0 : 0.1) * {pattern}"
        left = (float(_inside(_picture(device, light, 43)).mean()) - 0.1) / 0.9
        yield Measurement(FOLLOWED, abs(left), 0.05, "of the old light after 3 frames", name)


def measure_coverage(device):
    """A plate of 5 before a wall of 1, with an edge that crosses pixels at an angle: the error of the pixels at that
    edge, over the contrast. Measured: 0.045, 0.024 and 0.009; by samples alone 0.098, 0.075 and 0.020."""
    per_pixel = 2 * PLATE_DISTANCE / WALL_SIZE[1]
    ends = [((36.3 + 0.37 * y - WALL_SIZE[0] / 2) * per_pixel, (WALL_SIZE[1] / 2 - y) * per_pixel) for y in (200, -200)]
    right = [(x, y, -PLATE_DISTANCE) for x, y in ends]
    left = [(-20.0, y, -PLATE_DISTANCE) for _, y in reversed(ends)]
    scene = white_wall()
    scene.add(shapes.polygons(np.array(right + left)), sv.Material())
    y, x = np.indices((WALL_SIZE[1], WALL_SIZE[0]))
    fine = (np.arange(64) + 0.5) / 64
    covered = (x[..., None, None] + fine - 0.37 * (y[..., None, None] + fine[:, None]) < 36.3).mean(axis=(-2, -1))
    at_edge = _inside((covered > 0) & (covered < 1))
    row = "imageLoad(gbuffer_surface, texel_of(pixel)).y"
    light = f"instances.at[{row}].material == instances.at[0].material ? 1.0 : 5.0"
    for frames, bar in ((3, 0.06), (8, 0.03), (32, 0.012)):
        off = _inside(_picture(device, light, frames, scene=scene) - (1 + 4 * covered))[at_edge] / 4
        yield Measurement(COVERED, float(np.sqrt((off**2).mean())), bar, "of the contrast, rms", f"{frames} frames")


def measure_later_samples(device):
    """A light of 1 plus 0.08 over the number of the frame, which is too little to count as a change: what is left of
    the second part after 32 frames. Samples that count alike leave 0.127, and those that count in proportion to their
    number 0.059."""
    picture = _inside(_picture(device, "1.0 + 0.08 / float(this_frame.index + 1u)", 32))
    yield Measurement(LATER, float(np.abs(picture.mean() - 1)) / 0.08, 0.07, "of it")


def measure_noise(device):
    """Independent noise in all samples: the deviation of pixels of a settled picture, over that of samples."""
    picture = _inside(_picture(device, "noise"))
    # 1 / 8 for a plain mean of 64 samples; later ones count more.
    yield Measurement(NOISE, float(picture.std()) * 3**0.5, 0.16, "of the samples' deviation")
    yield Measurement(NOISE, abs(float(picture.mean()) - 1), 0.02, "of the mean")


def measure_blended(device):
    """A black pane before a white wall. By chance samples show one or the other."""
    for alpha in (0.5, 0.9):
        scene = white_wall()
        pane = sv.Material(alpha=alpha, alpha_mode="blend")
        scene.add(shapes.polygons(np.array([[-9, -9, -1.5], [9, -9, -1.5], [9, 9, -1.5], [-9, 9, -1.5]])), pane)
        row = "imageLoad(gbuffer_surface, texel_of(pixel)).y"
        light = f"instances.at[{row}].material == instances.at[0].material ? 1.0 : 0.0"
        picture = _inside(_picture(device, light, 12, 0.7, scene=scene))
        yield Measurement(BLENDED, abs(float(picture.mean()) - 1 + alpha), 0.01, "off in the mean", f"alpha {alpha}")
        yield Measurement(BLENDED, float(picture.std()), 0.06, "of the contrast is noise", f"alpha {alpha}")


def measure_not_finite(device):
    """A sample that is NaN or infinite in every second frame."""
    for value in ("0.0 / 0.0", "1.0 / 0.0", "-1.0 / 0.0"):
        wrong = "pixel == ivec2(40, 30) && (this_frame.index & 1u) == 0u"
        picture = _picture(device, f"{wrong} ? {value} : 1.0", 8)
        changed = float((~(np.abs(picture - 1) < 1e-3)).sum())
        yield Measurement(NOT_FINITE, changed, 0.0, f"of {picture.size} pixels", value)


MEASURES = (
    measure_even_light,
    measure_coverage,
    measure_later_samples,
    measure_motion,
    measure_changes,
    measure_noise,
    measure_blended,
    measure_not_finite,
)


@pytest.mark.parametrize(
    "measure", [*MEASURES, pytest.param(measure_areas, marks=pytest.mark.slow)], ids=lambda measure: measure.__name__
)
def test_rules_hold(device, measure):
    require(measure(device))


HISTORY = "passes/taa/history.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        EVEN: (
            measure_even_light,
            Bug(
                SAMPLES,
                "interpolate",
                "NearestSample found = correct(at, around); found.radiance *= 0.9; return found;",
            ),
        ),
        AREA: (measure_areas, Bug(HISTORY, "is_still", "return false;")),
        COVERED: (measure_coverage, Bug("passes/taa/strata.glsl", "is_complete", "return false;")),
        LATER: (
            measure_later_samples,
            Bug("passes/taa/strata.glsl", "add_to_mean", "count += 1.0; mean += (found - mean) / count;"),
        ),
        UPSCALED: (
            measure_areas,
            Bug(SAMPLES, "among_samples", "return position * render_scale() - 0.5 + this_frame.sample_jitter;"),
        ),
        SHARP: (measure_motion, Bug(HISTORY, "interpolate_history", "return correct(floor(position) + 0.5, around);")),
        FOLLOWED: (measure_changes, Bug("passes/taa/constants.glsl", "SUSPECT", "1e9")),
        NOISE: (measure_noise, Bug("passes/taa/constants.glsl", "LONGEST", "31.0")),
        BLENDED: (measure_blended, Bug("passes/taa/coverage.comp", "find_samples", "")),
        NOT_FINITE: (measure_not_finite, Bug("common/math.glsl", "is_finite_color", "return true;")),
    },
    quick=(EVEN,),
)
