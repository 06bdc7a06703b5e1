"""Undo and redo, and the actions that edit a scene, without a window and a device."""

from __future__ import annotations

import random

import glfw
import numpy as np
import pytest
from support.scenes import field_names
from viewer_tools import make_session

import solari_vk as sv
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.controls import ACTIONS
from solari_vk.studio.viewer.history import History
from solari_vk.studio.viewer.new_objects import LIGHTS
from solari_vk.studio.viewer.placing import move_to, transform_of
from solari_vk.studio.viewer.reload import Sources
from solari_vk.studio.viewer.session import GIZMOS
from solari_vk.studio.viewer.window import Event


def state(scene, settings):
    """Everything that edits may change, as values that compare."""
    items = [*scene.instances, *scene.lights, *scene.cameras, *scene.materials]
    fields = [
        (id(item), name, np.asarray(getattr(item, name)).tolist())
        for item in items
        for name in field_names(item)
        if not isinstance(getattr(item, name), (sv.Mesh, sv.Material, sv.Texture))
    ]
    return str(fields), repr(settings), str(scene.environment)


# ---- the history ------------------------------------------------------------------------------------


def test_assignments_are_undone_and_done_again(scene):
    history, material = History(), scene.materials[0]
    before = material.base_color
    history.assign(material, base_color=(1, 0, 0), metallic=1)
    history.assign(scene.instances[1], visible=False)
    assert (history.undo(), scene.instances[1].visible) == ("visible of " + scene.instances[1].describe(), True)
    assert "base color, metallic" in history.undo()
    assert (material.base_color == before).all()
    assert (material.metallic, history.undo()) == (0, "")
    history.redo()
    history.redo()
    assert (material.base_color.tolist(), material.metallic, history.redo()) == ([1, 0, 0], 1, "")
    assert not scene.instances[1].visible


def test_a_drag_is_one_edit(scene):
    history, material = History(), scene.materials[0]
    for value in (0.1, 0.2, 0.3):
        history.assign(material, metallic=value)
    history.end_gesture()
    history.assign(material, metallic=0.9)
    history.assign(scene.materials[1], metallic=0.9)
    history.assign(scene.materials[1], perceptual_roughness=0.9)
    assert len(history.done) == 4
    for expected in (0.9, 0.9, 0.3, 0.0):
        history.undo()
        assert material.metallic == pytest.approx(expected)
    history.redo()
    assert material.metallic == pytest.approx(0.3), "the end of the drag"


def test_a_new_edit_ends_what_can_be_done_again(scene):
    history = History()
    history.assign(scene.materials[0], metallic=1)
    history.undo()
    history.assign(scene.materials[1], metallic=1)
    assert history.redo() == ""


def test_refused_edits_leave_everything_as_it_was(scene):
    history, settings = History(), sv.Settings()
    before = state(scene, settings)
    wrong = (scene.materials[0], {"base_color": (1, 0, 0), "metallic": 7}), (settings, {"di_candidates": -1})
    for item, fields in wrong:
        with pytest.raises(sv.SolariError):
            history.assign(item, **fields)
    with pytest.raises(sv.SolariError):
        history.assign_each("several", settings, {"denoise": False, "di_candidates": -1})
    assert (history.done, state(scene, settings)) == ([], before)


def test_edits_that_cannot_be_undone_are_forgotten(scene):
    """All parts of an edit stay if one can't be undone; the scene then isn't what was saved before."""
    history = History()
    items = list(scene.instances)
    lamp = sv.PointLight((0, 1, 0))
    history.mark_saved()
    history.remove((scene.instances, [items[1], items[4]]))
    left = list(scene.instances)
    scene.add(items[1])  # by a script, so that there would be two
    with pytest.raises(sv.SolariError, match="can't undo removing 2 objects, which is forgotten"):
        history.undo()
    assert (list(scene.instances), history.done, history.unsaved) == ([*left, items[1]], [], True)
    history.add(scene.lights, lamp)
    history.undo()
    scene.add(lamp)
    with pytest.raises(sv.SolariError, match="can't redo adding"):
        history.redo()
    assert (history.undone, list(scene.lights)) == ([], [lamp])


def test_the_oldest_edits_stay_unsaved(scene, monkeypatch):
    monkeypatch.setattr("solari_vk.studio.viewer.history.MOST_EDITS", 3)
    history = History()
    for value in (0.1, 0.2, 0.3, 0.4):
        history.assign(scene.materials[0], metallic=value)
        history.end_gesture()
    while history.undo():
        pass
    assert scene.materials[0].metallic == pytest.approx(0.1)
    assert history.unsaved
    history.mark_saved()
    assert not history.unsaved


def test_objects_return_to_their_places(scene):
    history, items = History(), list(scene.instances)
    lamp = scene.add(sv.PointLight((0, 1, 0)))
    history.remove((scene.instances, [items[1], items[4], items[2]]), (scene.lights, [lamp]))
    assert (list(scene.instances), list(scene.lights)) == ([items[0], items[3], *items[5:]], [])
    other = sv.PointLight((0, 1, 0))
    history.add(scene.lights, other)
    history.undo()
    history.undo()
    assert (list(scene.instances), list(scene.lights)) == (items, [lamp])
    history.redo()
    history.redo()
    assert (len(scene.instances), list(scene.lights)) == (len(items) - 3, [other])


def test_what_is_unsaved(scene):
    history = History()
    assert not history.unsaved
    history.assign(scene.materials[0], metallic=0.5)
    assert history.unsaved
    history.mark_saved()
    assert not history.unsaved
    history.assign(scene.materials[0], metallic=0.6)
    history.undo()
    assert not history.unsaved, "what was saved is there again"
    history.undo()
    assert history.unsaved


def test_random_edits_are_undone_in_order(session, scene):
    """Any sequence of edits, undone as a whole and done again, gives the states that were there before."""
    generator = random.Random(4)
    states = [state(scene, session.settings)]
    kinds = ("hide", "remove", "nudge_up", "nudge_left", "add_light", "surround", "assign", "quality", "show_all")
    for _ in range(60):
        session.selected = generator.choice([*scene.instances, *scene.lights])
        kind, count = generator.choice(kinds), len(session.history.done)
        if kind == "assign":
            session.edit(generator.choice(list(scene.materials)), metallic=generator.random())
        elif kind == "quality":
            session.history.assign_each("a quality", session.settings, {"denoise": generator.random() < 0.5})
        else:
            argument = {"add_light": generator.choice(list(LIGHTS)), "surround": generator.choice(["none", "sky"])}
            act(session, kind, argument.get(kind))
        session.history.end_gesture()
        if len(session.history.done) > count:
            states.append(state(scene, session.settings))
    assert len(states) > 40
    for expected in states[-2::-1]:
        assert session.history.undo()
        assert state(scene, session.settings) == expected
    for expected in states[1:]:
        assert session.history.redo()
        assert state(scene, session.settings) == expected


# ---- actions ----------------------------------------------------------------------------------------


def test_every_action_exists(session):
    from solari_vk.studio.viewer.actions import Actions

    for name in (*ACTIONS.values(), "close_window", "pick", "grab", "camera", "drop", "add_light", "answer"):
        assert callable(getattr(Actions(session), name)), name


def test_locked_objects_are_not_edited(session, scene):
    session.selected = item = scene.instances[0]
    session.locked.add(item)
    before = state(scene, session.settings)
    for name in ("hide", "remove", "nudge_up"):
        act(session, name)
        assert "locked" in session.message, name
    session.edit(item, visible=False)
    assert (state(scene, session.settings), session.history.done) == (before, [])


def test_nudges_follow_the_view(session, scene):
    session.selected = item = scene.instances[3]
    at = item.position
    step = 0.02 * session.camera_control.seen_height
    for name, moved in (("right", (1, 0, 0)), ("up", (0, 1, 0)), ("away", (0, 0, -1)), ("left", (-1, 0, 0))):
        act(session, f"nudge_{name}")
        at = at + step * np.array(moved)
        assert item.position == pytest.approx(at), name
    session.camera_control.orbit(-np.pi / 2 / 0.005, 0, (0, 1, 0))  # the camera is at -x or +x
    right = session.camera.transform[:3, 0]
    act(session, "nudge_right")
    assert (item.position - at) @ right == pytest.approx(step)


@pytest.mark.parametrize("kind", LIGHTS)
def test_new_lights_light_what_is_seen(session, scene, kind):
    act(session, "add_light", kind)
    light = session.selected
    assert light in scene.lights
    center, up = session.camera_control.center, np.array((0, 1, 0))
    if kind == "sun":
        illuminance = light.illuminance * -light.direction @ up
    else:
        to = light.position - center
        distance = np.linalg.norm(to)
        illuminance = light.intensity / distance**2 * (to / distance) @ up
        if kind == "spot":
            assert light.direction @ to / distance == pytest.approx(-1, abs=1e-5)
    white = np.pi * 1.2 * 2.0**session.camera.ev100
    assert 0.3 * white < illuminance < 1.5 * white, "a white floor is neither black nor burnt out"
    act(session, "remove")
    assert light not in scene.lights
    assert session.selected is None
    act(session, "undo")
    assert session.selected is light


def test_gizmos_take_turns(session):
    seen = []
    for _ in GIZMOS:
        act(session, "next_gizmo")
        seen.append(session.gizmo)
    assert sorted(seen) == sorted(GIZMOS)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0.3, -0.5, 0.2), (0, 1, 0)])
def test_what_moves_a_light_turns_it_too(direction):
    for light in (sv.SpotLight((1, 2, 3), direction), sv.DirectionalLight(direction)):
        transform = transform_of(light, np.zeros(3))
        assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
        before = light.direction
        light.update(**move_to(light, transform))
        assert light.direction == pytest.approx(before, abs=1e-6)
        transform[:3, :3] = np.array([(0, 0, 1), (0, 1, 0), (-1, 0, 0)]) @ transform[:3, :3]
        light.update(**move_to(light, transform))
        assert light.direction == pytest.approx((before[2], before[1], -before[0]), abs=1e-6)


def test_surroundings_are_switched(session, scene, tmp_path):
    for kind, made in (("sky", sv.Sky), ("studio", sv.Environment), ("none", type(None))):
        act(session, "surround", kind)
        assert isinstance(scene.environment, made)
    act(session, "undo")
    act(session, "surround", str(tmp_path / "missing.hdr"))
    assert "missing.hdr" in session.message
    assert scene.environment is not None


# ---- closing ----------------------------------------------------------------------------------------


def test_closing_asks_about_edits(session, scene):
    session.has_panels = True
    for asked in (True, False, True):
        act(session, "close")
        assert (session.question is not None, session.window.wants_to_close) == (asked, False), "Esc alone never closes"
    act(session, "answer", "close")
    assert session.window.wants_to_close
    session.window.wants_to_close = False
    act(session, "close_window")
    assert session.window.wants_to_close, "Ctrl+Q and the window's button do"
    session.window.wants_to_close = False
    session.edit(scene.materials[0], metallic=1)
    act(session, "close")
    assert session.question is not None
    assert not session.window.wants_to_close
    act(session, "close")
    assert (session.question, session.window.wants_to_close) == (None, False), "Esc again stays"
    act(session, "close")
    act(session, "answer", "close without saving")
    assert session.window.wants_to_close


def test_closing_without_panels_takes_two_keys(session, scene):
    act(session, "close")
    assert (session.window.wants_to_close, session.message) == (False, "Esc once more closes the window")
    act(session, "brighter")
    act(session, "close")
    assert not session.window.wants_to_close
    act(session, "close")
    assert session.window.wants_to_close
    session.window.wants_to_close = False
    session.edit(scene.materials[0], metallic=1)
    for _ in range(2):
        act(session, "close")
        assert "Ctrl+S" in session.message
        assert not session.window.wants_to_close
        act(session, "brighter")  # the next Esc asks again
    act(session, "close")
    act(session, "close")
    assert session.window.wants_to_close


def test_a_file_that_changed_does_not_take_edits_away(session, scene, monkeypatch):
    monkeypatch.setattr(session.sources, "load", lambda: sv.builtin("thin_wall"))
    monkeypatch.setattr(session.sources, "changed", lambda: (False, True))
    session.edit(scene.materials[0], metallic=1)
    count = len(scene.instances)
    session.reload_changed()
    assert "F5" in session.message
    act(session, "reload")
    assert (len(scene.instances), scene.materials[0].metallic) == (count, 1)
    act(session, "reload")
    assert (len(scene.instances) != count, session.history.unsaved) == (True, False), "asked twice, without panels"
    act(session, "undo")
    assert "nothing" in session.message
    session.reload_changed()
    assert "reloaded" in session.message


def test_saving_answers_the_question(scene, tmp_path):
    session = make_session(scene, tmp_path)
    session.edit(scene.materials[0], metallic=1)
    act(session, "close_window")
    act(session, "answer", "save and close")
    assert session.window.wants_to_close
    assert not session.history.unsaved
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".glb", ".py"]


# ---- files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", [".glb", ".py"])
def test_other_files_are_replaced_after_asking(scene, tmp_path, ending):
    session, other = make_session(scene, tmp_path), tmp_path / f"model{ending}"
    session.has_panels = True
    other.write_text("mine")
    for answer, kept in (("cancel", True), ("replace", False)):
        act(session, "save", str(tmp_path / "model.glb"))
        assert str(other) in session.question.text
        act(session, "answer", answer)
        assert (other.read_bytes() == b"mine", session.history.unsaved) == (kept, False)
    session.edit(scene.materials[0], metallic=1)
    act(session, "save", str(tmp_path / "model.glb"))
    assert (session.question, session.history.unsaved) == (None, False), "the session's own file"


def test_other_files_are_replaced_by_two_keys_without_panels(scene, tmp_path):
    session, other = make_session(scene), tmp_path / "model.py"
    other.write_text("mine")
    act(session, "save", tmp_path / "model.glb")
    assert "once more" in session.message
    assert other.read_text() == "mine"
    act(session, "save", tmp_path / "model.glb")
    assert other.read_text() != "mine"


def test_saving_the_scenes_own_file_loads_nothing(scene, tmp_path, monkeypatch):
    """Undoing and what is picked stay; a later change by others is loaded."""
    monkeypatch.setattr("solari_vk.studio.viewer.reload.INTERVAL", 0)
    file = tmp_path / "model.glb"
    scene.save(file)
    session = make_session(scene)
    session.sources = Sources(scene, file, lambda: sv.load(file))
    session.edit(scene.materials[0], metallic=0.5)
    session.selected = item = scene.instances[0]
    act(session, "save", file)
    act(session, "save", file)
    session.reload_changed()
    assert (session.selected, len(session.history.done)) == (item, 1)
    sv.builtin("thin_wall").save(file)
    session.reload_changed()
    assert session.selected is None


def test_dropped_files_are_opened_added_or_surround(session, scene, tmp_path):
    model, map_file = tmp_path / "model.glb", tmp_path / "map.exr"
    other = sv.Scene(name="other")
    other.add(sv.shapes.sphere(), sv.Material(name="only"), name="ball")
    other.save(model)
    sv.save_image(map_file, np.ones((4, 8, 3), np.float32))
    count = len(scene.instances)
    act(session, "drop", Event("drop", glfw.MOD_SHIFT, paths=(str(model),)))
    assert len(scene.instances) == count + 1
    act(session, "undo")
    assert len(scene.instances) == count
    act(session, "drop", Event("drop", paths=(str(map_file),)))
    assert scene.environment.image.shape == (4, 8, 3)
    session.history.clear()
    session.locked.add(scene.instances[0])
    act(session, "drop", Event("drop", paths=(str(model),)))
    assert "ball" in scene.instances
    assert session.name == "model.glb"
    assert (len(session.history.done), len(session.locked)) == (0, 0)
    assert np.isfinite(session.camera.transform).all()
    act(session, "drop", Event("drop", paths=(str(tmp_path / "none.glb"),)))
    assert "none.glb" in session.message
    assert "ball" in scene.instances, "a file that can't be read leaves the scene as it is"
