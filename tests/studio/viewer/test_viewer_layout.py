"""Where things are in the window, when the picture is refined, outlines and handles: mathematics without a window."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.scenes import field_names

import solari_vk as sv
from solari_vk.studio.viewer import markers, refinement
from solari_vk.studio.viewer.layout import Area, Layout
from solari_vk.studio.viewer.outline import COLOR, outline
from solari_vk.studio.viewer.refinement import FRAMES, HIDDEN, LEAST_FRAMES, REST, Refinement, in_words
from solari_vk.studio.viewer.status import state_in_words, status_line

SIZES = [(960, 540), (1600, 900), (160, 100), (40, 30), (3, 2), (1, 1)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_parts_tile_the_window(size, scale):
    layout = Layout.of(size, panels=True, scale=scale)
    covered = np.zeros(size[::-1], int)
    for area in (layout.picture, layout.panels, layout.status):
        covered[area.y : area.y + area.height, area.x : area.x + area.width] += 1
    assert (covered == 1).all()
    assert layout.picture.width >= 0.5 * size[0]
    assert layout.picture.height >= 0.5 * size[1]
    assert Layout.of(size, panels=False).picture == Area(0, 0, *size)


def test_areas_are_scaled_to_pixels_without_gaps():
    left, right = Area(0, 0, 333, 100), Area(333, 0, 167, 100)
    pixels = [area.scaled((500, 100), (750, 150)) for area in (left, right)]
    assert pixels[0].x + pixels[0].width == pixels[1].x
    assert pixels[1].x + pixels[1].width == 750
    assert left.share((333 / 2, 25)) == (0.5, 0.25)
    assert not left.holds((333, 0))
    assert not left.holds((np.nan, 0))


# ---- refinement -------------------------------------------------------------------------------------


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_the_full_size_is_rendered_once_nothing_moves():
    state = Refinement(Clock())
    for number in range(3):
        assert state.begin_frame(number)
        assert state.moves
    for _ in range(REST + 1):
        state.begin_frame("still")
        assert not state.rests
    state.begin_frame("still")
    assert state.rests
    assert state.begins
    state.begin_frame("still")
    assert (state.rests, state.begins, state.hides) == (True, False, True)
    state.begin_frame("moved")
    assert (state.rests, state.begins, state.hides) == (False, False, False)
    state.enabled = False
    for _ in range(2 * REST):
        state.begin_frame("still")
    assert not state.rests, "a fixed scale stays"


def rest(clock, traced, seconds=1.0, per_step=1.0, steps=1000):
    """A picture that gains samples or frames in steps of some seconds, until it is finished."""
    state = Refinement(clock)
    for _ in range(REST + 2):
        state.begin_frame("still")
    count, left = 0.0, []
    for _ in range(steps):
        if state.finished:
            break
        clock.now += seconds
        count += per_step
        state.end_frame(seconds, count, traced)
        left.append((state.seconds_left, state.hides))
        state.begin_frame("still")
    return state, left


def test_progress_and_time_left():
    clock = Clock()
    state, left = rest(clock, traced=True, seconds=0.1, per_step=0.5)
    assert state.finished
    assert state.count == state.samples == 256
    ends = clock.now
    times = [0.1 * (number + 1) for number in range(len(left))]
    for at, (seconds, _) in list(zip(times, left, strict=True))[1:-1]:
        assert at + seconds == pytest.approx(ends)
    hidden = [hides for _, hides in left]
    assert hidden == sorted(hidden, reverse=True)
    assert sum(hidden) == pytest.approx(HIDDEN / 0.5, abs=1), "noise of the first samples isn't shown"
    realtime, _ = rest(Clock(), traced=False, seconds=0.1)
    assert realtime.count == FRAMES
    slow, _ = rest(Clock(), traced=False, seconds=4.0)
    assert slow.count == 9, "after half a minute"
    slower, _ = rest(Clock(), traced=False, seconds=60.0)
    assert slower.count == LEAST_FRAMES
    endless = Refinement(Clock())
    endless.samples = 0
    for _ in range(REST + 2):
        endless.begin_frame("still")
    endless.end_frame(0.1, 1e6, True)
    assert not endless.finished


def test_steps_stay_short():
    """The bands of a step double while steps are short, and are halved when they take long."""
    state = Refinement(Clock())
    for _ in range(REST + 2):
        state.begin_frame("still")
    per_band = 0.004
    for _ in range(30):
        state.end_frame(state.bands * per_band, 0.1, True)
    assert 0.5 * refinement.LONGEST_STEP <= state.bands * per_band <= 1.5 * refinement.LONGEST_STEP
    for _ in range(30):
        state.end_frame(10.0, 0.1, True)
    assert state.bands == 1


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "0 s"), (59.4, "59 s"), (60, "1:00 min"), (125, "2:05 min"), (3725, "1:02 h")]
)
def test_times_in_words(seconds, text):
    assert in_words(seconds) == text


# ---- over the picture -------------------------------------------------------------------------------


def test_an_outline_is_around_the_object():
    inside = np.zeros((7, 9), bool)
    inside[2:5, 3:6] = True
    image = outline(inside)
    drawn = image[..., 3] > 0
    assert not (drawn & inside).any()
    assert drawn.sum() == 12, "four sides of three pixels"
    assert (image[drawn] == COLOR).all()
    whole = outline(np.ones((4, 5), bool))[..., 3] > 0
    assert whole.sum() == 14, "an object that fills the picture is outlined by the picture's edge"
    assert not outline(np.zeros((4, 5), bool))[..., 3].any()


def test_marks_are_where_the_picture_shows_the_point():
    camera = sv.Camera.look_at((0, 0, 4), (0, 0, 0), vertical_fov=np.pi / 2)
    area = Area(100, 50, 200, 100)
    places = markers.project(camera, np.array([(0, 0, 0), (4, 2, 0), (0, 0, 9)], float), area)
    assert places[0] == pytest.approx((200, 100))
    assert places[1] == pytest.approx((250, 75))
    assert np.isnan(places[2]).all(), "behind the camera"


@pytest.mark.parametrize("fields", [{}, {"orthographic_height": 3.0}, {"principal_point": (0.3, 0.6)}])
def test_handles_are_projected_as_the_picture(fields):
    gizmo = pytest.importorskip("solari_vk.studio.viewer.gizmo", exc_type=ImportError)
    camera = sv.Camera.look_at((1, 2, 4), (0, 0.5, 0), pixel_aspect=1.1, **fields)
    points = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    seen = np.c_[points, np.ones(20)] @ np.linalg.inv(camera.transform).T @ gizmo.projection(camera, 1.6).T
    ndc = seen[:, :2] / seen[:, 3:]
    pixels = (ndc * (0.5, -0.5) + 0.5) * (160, 100) - 0.5
    assert pixels == pytest.approx(camera.project(points, (160, 100)), abs=1e-6)


# ---- materials --------------------------------------------------------------------------------------


def test_every_field_of_a_material_has_its_group():
    panel = pytest.importorskip("solari_vk.studio.viewer.material_panel", exc_type=ImportError)
    group_of = panel.group_of
    names = [name for name in field_names(sv.Material) if name != "name"]
    assert {group_of(name) for name in names} == set(panel.GROUPS)
    assert group_of("diffuse_transmission_color") == "translucency"
    assert group_of("normal_texture") == group_of("metallic_roughness_texture") == "surface"
    assert group_of("clearcoat_normal_texture") == "clearcoat"


def test_the_status_line_makes_room_for_the_pixel_under_the_cursor():
    clock = Clock()
    state = Refinement(clock)
    for count in range(REST + 4):
        state.begin_frame("still")
        state.end_frame(0.1, count, False)
        clock.now += 1
    pictures = SimpleNamespace(mode="realtime", view="picture", rendered_size=(64, 48))
    session = SimpleNamespace(pictures=pictures, refinement=state, gesture=None)
    whole = state_in_words(session)
    brief = "realtime - 9 frames, 14 %"
    probe = "(3, 4)  R 1"
    assert whole == "realtime - picture - 64x48 - 9 frames, 14 %, 1:22 min left"
    for room, text in ((len(whole), whole), (len(whole) - 1, brief), (len(brief), brief), (len(brief) - 1, "")):
        assert status_line(session, probe, room + len(probe) + 2, len) == text
    assert status_line(session, "", len(brief) - 1, len) == brief
