"""The panels: where they are drawn, how they use the window's events, and what they edit."""

from __future__ import annotations

import sys

import glfw
import numpy as np
import pytest

import solari_vk as sv
from solari_vk.passes.debug_views import views_of
from solari_vk.settings import DEFAULTS, FIELDS
from solari_vk.viewer import panels
from solari_vk.viewer.overlay import MARGIN
from solari_vk.viewer.pictures import MODES
from solari_vk.viewer.window import Event

SIZE = (160, 100)


def mouse(viewer, x, y, *presses):
    viewer.window.events.append(Event("cursor", x=x, y=y))
    viewer.step()
    for pressed in presses:
        viewer.window.events.append(Event("button", 0, pressed))
        viewer.step()


# ---- drawing ----------------------------------------------------------------------------------------


def test_panels_lie_over_the_picture(open_viewer):
    viewer = open_viewer(size=SIZE)
    viewer.say("a message")
    viewer.run(frames=3)
    shown, picture = viewer.capture(), viewer.pictures.pixels()
    row = MARGIN + 4, slice(MARGIN + 4, -MARGIN - 4)
    assert (shown[row] != picture[row]).any(axis=1).all()
    assert (shown[: MARGIN - 1] == picture[: MARGIN - 1]).all(), "nothing is drawn beside them"
    assert (shown[MARGIN : MARGIN + 20] > 240).all(axis=2).any(), "white letters in the title"
    viewer.act("panels")
    viewer.message = ""
    viewer.run(frames=2)
    assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_all_panels_can_be_laid_out(open_viewer, replace):
    replace()
    viewer = open_viewer(size=(400, 340), scale=0.2)
    viewer.scene.add(sv.DirectionalLight(direction=(0, -1, 0)))
    viewer.scene.warnings.append("something was left out")
    viewer.run(frames=1)
    viewer.act("pick", (200, 170))
    assert viewer.pick is not None
    viewer.act("help")
    viewer.run(frames=3)


def test_panels_fit_windows_of_all_sizes(open_viewer, replace):
    replace()
    viewer = open_viewer(scale=0.5)
    for size in ((40, 30), (1, 1), (300, 50), SIZE):
        glfw.set_window_size(viewer.window.handle, *size)
        viewer.run(frames=2)
        assert viewer.capture().shape == (size[1], size[0], 3)


def test_the_divider_of_the_split_view_can_be_dragged(open_viewer, monkeypatch):
    viewer = open_viewer(size=SIZE, scale=0.25)
    viewer.shows_panels = False
    viewer.run(frames=1)
    monkeypatch.setattr(viewer.pictures, "render", lambda *_: None)  # the realtime picture would take long
    viewer.pictures.mode = "split"
    viewer.step()
    mouse(viewer, 80, 60)
    mouse(viewer, 80, 60, True)
    mouse(viewer, 120, 60, False)
    assert viewer.pictures.divider == pytest.approx(0.75)
    assert viewer.pick is None, "the divider's clicks are not the viewer's"


# ---- input ------------------------------------------------------------------------------------------


def test_clicks_on_panels_do_not_pick(open_viewer):
    viewer = open_viewer(size=SIZE)
    viewer.run(frames=2)
    mouse(viewer, 80, 60)
    mouse(viewer, 80, 60, True, False)
    assert viewer.pick is None
    viewer.act("panels")
    viewer.run(frames=2)
    mouse(viewer, 80, 60, True, False)
    assert viewer.pick is not None


def test_typing_into_a_field_does_not_fly(open_viewer, replace):
    viewer = open_viewer(size=SIZE)
    viewer.run(frames=1)
    imgui = panels.imgui
    focused = []

    def input_int(label, value, **options):
        if not focused:
            imgui.set_keyboard_focus_here()
            focused.append(label)
        return imgui.input_int(label, value, **options)

    replace(input_int=input_int)
    viewer.run(frames=3)
    viewer.window.events += [Event("key", glfw.KEY_W, True), Event("text", ord("9"))]
    viewer.step()
    assert not viewer.camera_control.held
    viewer.window.events += [Event("key", glfw.KEY_ENTER, True)]
    viewer.run(frames=2)
    assert getattr(viewer.settings, focused[0].split()[0]) == 9


# ---- editing ----------------------------------------------------------------------------------------


def test_every_setting_can_be_changed_and_reset(open_viewer, replace):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    offered = {}

    def combo(label, at, names):
        offered[label] = names
        return True, at if label in ("mode", "view", "tone mapping") else (at + 1) % len(names)

    replace(
        checkbox=lambda label, value: (True, not value),
        combo=combo,
        input_int=lambda label, value, **_: (True, value // 2),
        input_float=lambda label, value, **_: (True, 2.0 if "upscale" in label else value / 2 or 0.5),
    )
    viewer.step()
    assert [name for name in FIELDS if getattr(viewer.settings, name) == DEFAULTS[name]] == []
    assert (offered["mode"], offered["view"]) == (list(MODES), list(views_of("paths")))
    replace(checkbox=lambda label, value: (False, value), small_button=lambda label: label.startswith("reset##"))
    viewer.step()
    assert [name for name in FIELDS if getattr(viewer.settings, name) != DEFAULTS[name]] == []
    replace(input_int=lambda label, value, **_: (True, -5))
    viewer.step()
    assert "must be a whole number" in viewer.message
    assert viewer.settings.di_candidates == DEFAULTS["di_candidates"]


def dragging(**values):
    """A panel's function that drags the fields of these labels to their value, or to a function of it."""

    def drag(label, value, *_, **__):
        new = values.get(label.replace(" ", "_").replace("/", "_"))
        return new is not None, value if new is None else new(value) if callable(new) else new

    return drag


def test_the_scene_can_be_edited(open_viewer, replace):
    viewer = open_viewer(size=SIZE, scale=0.2)
    sun = viewer.scene.add(sv.DirectionalLight(direction=(0, -1, 0), illuminance=5))
    viewer.run(frames=1)
    before = {instance: instance.transform.copy() for instance in viewer.scene.instances}
    replace(
        drag_float3=dragging(position=lambda value: [x + 0.01 for x in value]),
        drag_float=dragging(illuminance=6.0, cd_m2=lambda value: value + 1),
        slider_float=dragging(roughness=0.75),
        color_edit3=dragging(base_color=[0.1, 0.2, 0.3]),
    )
    viewer.step()
    assert sun.illuminance == 6
    for instance, transform in before.items():
        assert instance.transform[:3, 3] == pytest.approx(transform[:3, 3] + 0.01)
        assert instance.material.perceptual_roughness == 0.75
        assert instance.material.base_color == pytest.approx((0.1, 0.2, 0.3))
        assert instance.material.emits
    instance.transform = np.array([(2, 0, 0, 5), (0, 2, 0, 6), (0, 0, 2, 7), (0, 0, 0, 1)])
    replace(drag_float3=dragging(turn_by=[0, 90, 0]), drag_float=dragging(scale_by=0.5))
    viewer.step()
    assert instance.transform == pytest.approx(np.array([(0, 0, 1, 5), (0, 1, 0, 6), (-1, 0, 0, 7), (0, 0, 0, 1)]))
    viewer.scene.environment = sv.Environment(1.0)
    replace(drag_float=dragging(turn_by=90.0))
    viewer.step()
    assert viewer.scene.environment.rotation == pytest.approx(np.array([(0, 0, 1), (0, 1, 0), (-1, 0, 0)]), abs=1e-6)


def test_the_viewer_works_without_imgui(open_viewer, monkeypatch):
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    for name in ("overlay", "overlay_renderer", "panels", "scene_panel"):
        monkeypatch.delitem(sys.modules, f"solari_vk.viewer.{name}", raising=False)
    viewer = open_viewer(size=(64, 64))
    assert viewer.overlay is None
    assert "imgui-bundle" in viewer.message
    viewer.run(frames=2)
    assert (viewer.capture() == viewer.pictures.pixels()).all()
