"""What one camera of `solari-vk serve` shows, on a device."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from support.frames import leaves_nothing

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.studio.browser import screen as screen_module
from solari_vk.studio.browser.screen import REST, Screens
from solari_vk.studio.viewer.camera_control import TURN, WHEEL

SIZE, ENOUGH_FRAMES = (64, 64), 6


@pytest.fixture
def screens(device, monkeypatch):
    """A function that makes screens; at the end all must have left nothing on the device."""
    monkeypatch.setattr(screen_module, "ENOUGH_FRAMES", ENOUGH_FRAMES)
    made = []

    def make(**options):
        scene = sv.builtin("cornell_box")
        made.append(Screens(device, scene, scene.camera, **{"size": SIZE, "scale": 0.5, "samples": 4, **options}))
        return made[-1]

    with leaves_nothing(device):
        yield make
        for one in made:
            one.close()


@pytest.fixture
def shown(screens):
    opened = screens().open(lambda *_: None)
    yield opened
    opened.close()


def settle(screen):
    """The pictures until it is finished."""
    found = []
    while not screen.finished:
        found.append(screen.render())
        assert len(found) < 100
    return found


def position(screen):
    return screen.control.camera.transform[:3, 3].copy()


@pytest.mark.parametrize("value", ["nan", math.nan, math.inf, "-inf", 10**400, None])
def test_numbers_of_pages_are_finite(shown, value):
    """Minimum and maximum don't refuse NaN, with which all comparisons are false."""
    state = shown.state()
    for message in (
        *({"set": {name: value}} for name in ("divider", "ev100", "exposure", "spatial_reuse_radius")),
        *({"move": {name: value}} for name in ("right", "pan_down", "notches")),
        *({kind: [0.5, value]} for kind in ("pick", "grab")),
    ):
        with pytest.raises((SolariError, ValueError, TypeError, OverflowError)):
            shown.do(message)
    with pytest.raises((SolariError, ValueError, TypeError, OverflowError)):
        shown._restore({**state, "distance": value})
    assert json.dumps(shown.state(), allow_nan=False)


def test_a_still_camera_is_refined_and_a_movement_begins_anew(shown):
    pictures = settle(shown)
    assert len(pictures) == REST + ENOUGH_FRAMES
    sizes = [one and one.about["rendered"] for one in pictures]
    assert sizes[:REST] == [(32, 32)] * REST
    assert sizes[-1] == SIZE
    assert None in pictures[REST:], "a picture that is worse than the one before is not shown"
    assert [one.finished for one in pictures if one] == [False] * (len(pictures) - pictures.count(None) - 1) + [True]
    assert json.loads(json.dumps(pictures[-1].about))

    assert shown.do({"pick": [0.42, 0.7]})["picked"]["name"] == "tall block"
    assert shown.do({"pick": [0.0, 5.0]}) == {"picked": None}
    shown.do({"grab": [0.42, 0.7]})
    home, center = position(shown), shown._center
    shown.do({"move": {"right": 40}, "input": 1})
    now = position(shown)
    assert np.linalg.norm(now - center) == pytest.approx(np.linalg.norm(home - center))
    x, z = (home - center)[[0, 2]], (now - center)[[0, 2]]
    assert np.arctan2(x[1] * z[0] - x[0] * z[1], x @ z) == pytest.approx(-40 * TURN)
    assert shown.render().about["rendered"] == (32, 32)
    distance = shown.control.distance
    shown.do({"move": {"notches": 1}})
    assert shown.control.distance == pytest.approx(distance / WHEEL)
    shown.do({"move": {"home": True}})
    assert position(shown) == pytest.approx(home)


def test_a_pan_moves_what_is_seen_with_the_cursor(shown):
    shown.render()
    shown.do({"grab": [0.5, 0.5]})
    camera, point = shown.control.camera, shown.control.center
    before = np.asarray(camera.project(point[None], SIZE))[0, :2]
    shown.do({"move": {"pan_right": 0.25, "pan_down": -0.125}})
    after = np.asarray(shown.control.camera.project(point[None], SIZE))[0, :2]
    assert after - before == pytest.approx([16, -8], abs=0.5)


def test_the_reference_comes_when_the_camera_rests(screens, monkeypatch):
    monkeypatch.setattr(screen_module, "LONGEST", np.inf)
    shown = screens(mode="reference").open(lambda *_: None)
    pictures = [one for one in settle(shown) if one]
    assert [list(one.about["columns"]) for one in pictures[:REST]] == [["realtime"]] * REST
    assert list(pictures[-1].about["columns"]) == ["reference"]
    assert pictures[-1].about["samples"] >= 4
    assert shown.pictures.most_samples > 1, "quick frames have more samples"
    monkeypatch.setattr(screen_module, "LONGEST", 0.0)
    for _ in range(7):
        shown.render()
    assert shown.pictures.most_samples == 1, "movements wait for a frame, so slow ones have fewer samples"
    assert shown.do({"pick": [0.42, 0.7]})["picked"]["name"] == "tall block"
    shown.do({"set": {"divider": 0.25, "mode": "split"}})
    assert shown.render().about["columns"]["reference"][1] == 1.0
    shown.close()


def test_options_are_followed_and_a_state_goes_on_elsewhere(screens):
    tower = screens()
    shown, said = tower.open(lambda *_: None), tower.describe()
    assert "upscale" not in {field["name"] for field in said["settings"]}
    json.dumps(said, allow_nan=False)
    options = shown.do({"set": {"quality": "low", "ev100": 3.5, "tonemap": "aces", "denoise": False}})["options"]
    assert (options["ev100"], options["tonemap"], options["settings"]["denoise"]) == (3.5, "aces", False)
    assert options["settings"]["paths_bounces"] == 4
    shown.render()
    shown.do({"move": {"right": 30, "down": 10}})
    state = json.loads(json.dumps(shown.render().about["state"]))
    other = tower.open(lambda *_: None, state)
    assert other.control.camera.transform == pytest.approx(shown.control.camera.transform)
    other.render()
    assert other.control.distance == state["distance"], "what is zoomed to stays"
    assert other.options() == state["options"]
    assert tower.settings.denoise, "other cameras keep their settings"
    for name, value, words in (
        ("mode", "x", "no mode"),
        ("view", 3, "view"),
        ("upscale", 2, "no option"),
        ("paths_bounces", 0, "from 1 to 64"),
        ("quality", [], "no quality"),
    ):
        with pytest.raises(SolariError, match=words):
            other.do({"set": {name: value}})
    other.close()
    shown.close()
