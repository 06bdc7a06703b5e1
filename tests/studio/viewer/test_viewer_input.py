"""What keys and mouse do, tested with made-up events; and a window on GLFW's null platform, which needs no screen."""

from __future__ import annotations

import math
from pathlib import Path

import glfw
import numpy as np
import pytest
from viewer_tools import drag, press, release

import solari_vk as sv
from solari_vk.studio.viewer.camera_control import MAX_ELEVATION, PACE, CameraControl
from solari_vk.studio.viewer.controls import ACTIONS, FLY_KEYS, KEYS_HELP, Controls
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.window import Event, Window

DISTANCE = 4.0
SEEN = np.array((0.0, 1.0, 0.0))
LEFT = glfw.MOUSE_BUTTON_LEFT
MIDDLE = glfw.MOUSE_BUTTON_MIDDLE
RIGHT = glfw.MOUSE_BUTTON_RIGHT
AREA = Area(0, 0, 200, 100)  # of the picture in the window


def make_control():
    """A camera that looks along -z at SEEN, which it has seen."""
    control = CameraControl(sv.Camera.look_at((0, 1, DISTANCE), SEEN), extent=8.0)
    control.see(DISTANCE)
    return control


@pytest.fixture
def control():
    return make_control()


@pytest.fixture
def called():
    """The actions that the controls called, with their arguments."""
    return []


@pytest.fixture
def handle(control, called):
    """`Controls.handle` with the events as arguments. What is grabbed is SEEN."""

    def act(name, argument):
        called.append((name, argument))
        return SEEN if name == "grab" else None

    controls = Controls(control, act, lambda: AREA)
    return lambda *events, **options: controls.handle(events, **options)


def test_escape_ends_a_drag_and_closes_nothing(handle, called, control):
    events = drag(LEFT, (20, 0), (20, 0))
    handle(*events[:3], press(glfw.KEY_ESCAPE), release(glfw.KEY_ESCAPE))
    before = position(control)
    handle(*events[3:])
    assert [name for name, _ in called] == ["grab"], "neither close nor a click"
    assert (position(control) == before).all()
    handle(press(glfw.KEY_ESCAPE))
    assert called[-1] == ("close", None)


def position(control):
    return control.camera.transform[:3, 3].copy()


def speed(control, seconds=1e-3):
    before = position(control)
    control.advance(seconds)
    return np.linalg.norm(position(control) - before) / seconds


# ---- flying -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "direction"),
    [("W", (0, 0, -1)), ("S", (0, 0, 1)), ("A", (-1, 0, 0)), ("D", (1, 0, 0)), ("E", (0, 1, 0)), ("Q", (0, -1, 0))],
)
def test_keys_fly(handle, control, key, direction):
    code = getattr(glfw, f"KEY_{key}")
    before = position(control)
    handle(press(code))
    control.advance(0.5)
    moved = position(control) - before
    assert moved == pytest.approx(np.array(direction) * np.linalg.norm(moved))
    assert np.linalg.norm(moved) > 0.3 * PACE * DISTANCE
    handle(release(code))
    control.advance(2)
    assert not control.flies
    assert speed(control) == 0


def test_shift_flies_faster_and_two_keys_are_as_fast_as_one(handle, control):
    handle(press(glfw.KEY_D), press(glfw.KEY_E))
    control.advance(1)
    assert speed(control) == pytest.approx(control.speed, rel=1e-3)
    handle(press(glfw.KEY_LEFT_SHIFT))
    control.advance(1)
    assert speed(control) == pytest.approx(4 * control.speed, rel=1e-3)
    handle(release(glfw.KEY_LEFT_SHIFT), press(glfw.KEY_A), press(glfw.KEY_Q))
    control.advance(2)
    assert speed(control) == pytest.approx(0, abs=1e-6), "opposite keys cancel"


def test_velocity_changes_smoothly(handle, control):
    """After a press and after a release, no frame's velocity differs by more than a share of the speed."""
    speeds = [0.0]
    for event in (press(glfw.KEY_D), release(glfw.KEY_D)):
        handle(event)
        speeds += [speed(control, 1 / 60) for _ in range(60)]
    assert max(speeds) == pytest.approx(control.speed, rel=1e-3)
    assert np.abs(np.diff(speeds)).max() < 0.25 * control.speed
    assert speeds[-1] == 0


@pytest.mark.parametrize("keys", [(glfw.KEY_W,), (glfw.KEY_S, glfw.KEY_D)])
def test_flying_does_not_depend_on_the_frame_rate(keys):
    """Keys that are held for a second end at the same place with 7, 30 and 144 frames a second."""
    ends = []
    for rate in (7, 30, 144):
        control = make_control()
        Controls(control, lambda name, argument: None, lambda: AREA).handle([press(key) for key in keys])
        for _ in range(rate):
            control.advance(1 / rate)
        ends.append(position(control))
    way = np.linalg.norm(ends[0] - position(make_control()))
    assert way > 1
    assert np.linalg.norm(ends[1:] - ends[0], axis=1).max() < 0.01 * way


@pytest.mark.parametrize("rate", [7, 60])
def test_flying_to_a_wall_ends_before_it(handle, control, rate):
    """The speed falls with the distance to the wall, which is seen ten times a second; away from it, it grows."""
    seen_at, speeds = -1.0, []
    handle(press(glfw.KEY_W))
    for frame in range(6 * rate):
        if frame / rate - seen_at > 0.1:
            seen_at = frame / rate
            control.see(position(control)[2])  # a wall at z = 0
        control.advance(1 / rate)
        speeds.append(control.speed)
    assert 0 < position(control)[2] < 0.1 * DISTANCE
    assert speeds == sorted(speeds, reverse=True)
    handle(release(glfw.KEY_W), press(glfw.KEY_S))
    control.advance(4)
    assert position(control)[2] > 0.2 * DISTANCE


def test_home_is_found_from_everywhere(handle, control):
    """F without a picked instance shows what was seen first, from as far away; R shows it as at first."""
    home = control.camera.transform.copy()
    for key in (glfw.KEY_W, glfw.KEY_S, glfw.KEY_E):
        handle(press(key), press(glfw.KEY_LEFT_SHIFT))
        control.advance(1)
        control.see(None)
        control.advance(1)
        control.look(300, 100)
        handle(release(key))
        control.focus_home()
        assert not control.flies
        assert position(control) == pytest.approx(SEEN + DISTANCE * control.camera.transform[:3, 2])
        assert control.distance == pytest.approx(DISTANCE)
        control.advance(1)
    control.reset()
    control.advance(1)
    assert (control.camera.transform == home).all()
    assert control.speed == pytest.approx(PACE * DISTANCE)


def test_the_background_is_as_far_as_what_was_seen_first(control):
    control.camera.transform = sv.Camera.look_at((0, 1, 40), (0, 1, 80)).transform
    control.see(None)
    assert control.distance == pytest.approx(40)


def test_the_wheel_changes_the_speed_while_keys_fly(handle, control):
    before = control.speed
    handle(press(glfw.KEY_W), Event("scroll", y=2.0), release(glfw.KEY_W))
    assert control.speed == pytest.approx(before * 1.25**2)
    handle(press(glfw.KEY_W), *[Event("scroll", y=-1e9)] * 3)
    assert 0 < control.speed < before
    handle(*[Event("scroll", y=1e9)] * 9)
    assert before < control.speed < 1e3 * before
    for _ in range(100):
        control.advance(1e6)
    assert np.isfinite(control.camera.transform).all()


def test_keys_are_released_without_the_focus_and_while_panels_use_them(handle, control):
    handle(press(glfw.KEY_W), press(glfw.KEY_LEFT_SHIFT), Event("focus", pressed=False))
    assert (control.pressed, control.fast) == (set(), False)
    handle(press(glfw.KEY_W))
    handle(release(glfw.KEY_W), press(glfw.KEY_S), takes_keys=False)
    assert not control.pressed


# ---- mouse ------------------------------------------------------------------------------------------


def seen_at(control, point):
    """Where a point of the world is in the picture of AREA, in pixels from its top left corner."""
    return control.camera.project(np.array([point]), (AREA.width, AREA.height))[0] + 0.5


@pytest.mark.parametrize("orthographic", [0.0, 3.0])
@pytest.mark.parametrize("cursor", [(100, 50), (30, 20), (190, 90)])
def test_the_wheel_zooms_to_what_is_under_the_cursor(control, orthographic, cursor):
    control.camera.orthographic_height = orthographic
    aim = control.camera.unproject(np.array(cursor) - 0.5, 3.0, (AREA.width, AREA.height))
    controls = Controls(control, lambda name, argument: aim, lambda: AREA)
    control.see(3.0)
    height = control.seen_height
    controls.handle([Event("cursor", x=cursor[0], y=cursor[1]), Event("scroll", y=1.0), Event("scroll", y=2.0)])
    assert control.seen_height == pytest.approx(height / 1.25**3)
    assert seen_at(control, aim) == pytest.approx(cursor), "the point stays under the cursor"
    assert control.distance == pytest.approx(3 / 1.25**3)
    before = control.camera.transform.copy()
    controls.handle([Event("scroll", y=-1.0), Event("scroll", y=1.0)])
    assert control.camera.transform == pytest.approx(before), "zooming out undoes zooming in"
    controls.handle([Event("scroll", y=1e9)] * 99 + [Event("scroll", y=-1e9)] * 99)
    assert np.isfinite(control.camera.transform).all()


def test_shift_and_the_wheel_fly_past_what_is_seen(handle, control, called):
    handle(press(glfw.KEY_LEFT_SHIFT), *[Event("scroll", y=1.0)] * 6)
    assert position(control)[2] < 0, "beyond SEEN"
    handle(*[Event("scroll", y=-1.0)] * 6)
    assert position(control) == pytest.approx((0, 1, DISTANCE))
    assert not called


def test_shift_and_a_left_drag_look_around(handle, control, called):
    before = position(control)
    handle(press(glfw.KEY_LEFT_SHIFT), *drag(LEFT, (20, 0), (20, 0)))
    assert position(control) == pytest.approx(before)
    assert -control.camera.transform[0, 2] == pytest.approx(math.sin(40 * 0.005))
    assert not called


def test_middle_drag_pans_what_is_under_the_cursor(control):
    aim = control.camera.unproject((49.5, 49.5), 2.5, (AREA.width, AREA.height))
    controls = Controls(control, lambda name, argument: aim, lambda: AREA)
    view = control.camera.transform[:3, :3].copy()
    controls.handle(drag(MIDDLE, (30, 0), (10, -20)))
    assert seen_at(control, aim) == pytest.approx((90, 30)), "it follows the cursor"
    assert (control.camera.transform[:3, :3] == view).all()


def test_framing_shows_all_of_a_sphere(control):
    rim = np.random.default_rng(2).normal(size=(4000, 3))
    rim = np.array((3, 1, -5)) + 0.7 * rim / np.linalg.norm(rim, axis=1, keepdims=True)
    for aspect in (0.4, 1.0, 2.5):
        size = round(200 * aspect), 200
        control.focus((3, 1, -5), 0.7, aspect)
        at = control.camera.project(rim, size) + 0.5
        assert (at >= 0).all()
        assert (at <= size).all()
        share = np.ptp(at, axis=0) / size
        assert share.max() > 0.97, "and no more"


def test_right_drag_looks_around(handle, control, called):
    before = position(control)
    handle(*drag(RIGHT, (20, 0), (20, 0)))
    assert position(control) == pytest.approx(before)
    assert -control.camera.transform[0, 2] == pytest.approx(math.sin(40 * 0.005)), "to the right of -z"
    assert not called


def test_left_drag_orbits_around_the_grabbed_point(handle, control, called):
    handle(*drag(LEFT, (100, 0), (100, 0), (0, 50)))
    assert [name for name, _ in called] == ["grab"]
    view = -control.camera.transform[:3, 2]
    assert position(control) == pytest.approx(SEEN - 4 * view), "the point stays in the center, as far away"
    assert view[0] > 0.5


def test_other_drags_do_not_move(handle, control, called):
    """A click picks; a drag over the sky looks around; over panels, nothing happens."""
    before = control.camera.transform.copy()
    handle(*drag(LEFT, (1, 1), (1, -1)))
    handle(*drag(LEFT, (100, 0)), takes_mouse=False)
    assert called == [("pick", (52.0, 50.0))]
    assert (control.camera.transform == before).all()
    handle(*drag(LEFT, (-90, 0), start=(250.0, 50.0)))  # pressed beside the picture, before a frame could note it
    assert (control.camera.transform == before).all()
    Controls(control, lambda name, argument: None, lambda: AREA).handle(drag(LEFT, (100, 30)))
    assert position(control) == pytest.approx(before[:3, 3])
    assert (control.camera.transform != before).any()


def test_looking_up_stops_before_the_pole(handle, control):
    handle(*drag(RIGHT, *[(3, -400)] * 30))
    transform = control.camera.transform
    assert math.asin(-transform[1, 2]) == pytest.approx(MAX_ELEVATION)
    assert transform[:3, :3].T @ transform[:3, :3] == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
    assert transform[1, 0] == pytest.approx(0), "the horizon stays level"


# ---- actions ----------------------------------------------------------------------------------------


def test_every_action_has_its_key(handle, control, called):
    for code, modifiers in ACTIONS:
        handle(press(code, modifiers), release(code))
    assert [name for name, _ in called] == list(ACTIONS.values())
    called.clear()
    handle(press(glfw.KEY_1), press(glfw.KEY_9), press(glfw.KEY_1, repeats=True))
    assert called == [("camera", 0), ("camera", 8)]
    handle(press(glfw.KEY_F2, repeats=True), press(glfw.KEY_PERIOD, repeats=True))
    assert called[2:] == [("move_divider_right", None)], "only some held keys repeat"
    handle(press(glfw.KEY_EQUAL, glfw.MOD_SHIFT), press(glfw.KEY_S, glfw.MOD_CONTROL | glfw.MOD_SHIFT))
    assert called[3:] == [("brighter", None), ("save", None)], "Shift counts where it has a meaning of its own"
    handle(Event("text", ord("?")), Event("text", ord("z")), Event("close"))
    assert called[5:] == [("help", None), ("close_window", None)]
    handle(Event("text", ord("?")), takes_keys=False)
    assert len(called) == 7
    assert not control.pressed, "Ctrl doesn't fly"
    assert not FLY_KEYS.keys() & {code for code, modifiers in ACTIONS if not modifiers}


def test_the_guide_lists_the_keys():
    guide = (Path(__file__).resolve().parents[3] / "docs/guides/viewer.md").read_text(encoding="utf-8")
    for keys, meaning in KEYS_HELP:
        assert f"| {keys} | {meaning} |\n" in guide


@pytest.mark.parametrize("text", ["", "[1, 2]", '{"position": 3}', '{"transform": [[1]]}'])
def test_other_texts_are_refused_as_poses(control, text):
    before = control.camera.transform.copy()
    with pytest.raises(sv.SolariError):
        control.paste_pose(text)
    assert (control.camera.transform == before).all()


def test_windows_are_minimized():
    """Uses GLFW's null platform, because the X server of the other tests has no window manager to minimize windows."""
    glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL)
    try:
        window = Window((200, 100), "test")
        assert window.pixels == (200, 100)
        for change, pixels in ((glfw.iconify_window, (0, 0)), (glfw.restore_window, (200, 100))):
            change(window.handle)
            assert window.pixels == pixels
        window.poll_events()
        assert window.poll_events() == []
        window.close()
    finally:
        glfw.init_hint(glfw.PLATFORM, glfw.ANY_PLATFORM)


def test_windows_take_files_and_ask_before_they_close(monkeypatch):
    """By GLFW's callbacks, on its null platform, where nobody drops or closes anything."""
    callbacks = {}
    for name in ("set_drop_callback", "set_window_close_callback"):
        monkeypatch.setattr(glfw, name, lambda handle, callback, name=name: callbacks.update({name: callback}))
    monkeypatch.setattr(glfw, "get_window_content_scale", lambda handle: (1.5, 1.5))
    monkeypatch.setattr(glfw, "get_key", lambda handle, code: code == glfw.KEY_RIGHT_SHIFT)
    glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL)
    try:
        window = Window((200, 100), "test")
        callbacks["set_drop_callback"](window.handle, ["a.glb", "b.hdr"])
        glfw.set_window_should_close(window.handle, True)
        callbacks["set_window_close_callback"](window.handle)
        dropped, closed = (event for event in window.poll_events() if event.kind in ("drop", "close"))
        assert (dropped.paths, dropped.code) == (("a.glb", "b.hdr"), glfw.MOD_SHIFT)
        assert closed.kind == "close"
        assert not window.wants_to_close, "the viewer decides"
        assert window.text_scale == 1.5
        monkeypatch.setattr(Window, "pixels", (300, 150))
        assert window.text_scale == 1.0, "the system enlarges the window's coordinates itself"
        window.close()
        assert window.text_scale == 1.0
    finally:
        glfw.init_hint(glfw.PLATFORM, glfw.ANY_PLATFORM)
