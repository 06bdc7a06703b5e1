"""Several objects that are picked at once, and textures from files on what is picked."""

from __future__ import annotations

from unittest.mock import MagicMock

import glfw
import numpy as np
import pytest
from viewer_tools import drag, press, release

import solari_vk as sv
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.camera_control import CameraControl
from solari_vk.studio.viewer.controls import Controls
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.outline import covered
from solari_vk.studio.viewer.window import Event


@pytest.fixture
def blocks(session, scene):
    """Two instances, which are picked."""
    found = scene.instances["short block"], scene.instances["tall block"]
    for block in found:
        session.pick_also(block)
    return found


def test_clicks_with_shift_pick_several():
    done = []
    control = CameraControl(sv.Camera.look_at((0, 1, 4), (0, 1, 0)), 2.0)
    controls = Controls(control, lambda *action: done.append(action), lambda: Area(0, 0, 640, 360))
    controls.handle([press(glfw.KEY_LEFT_SHIFT), *drag(0), release(glfw.KEY_LEFT_SHIFT), *drag(0)])
    assert done == [("pick_also", (50.0, 50.0)), ("pick", (50.0, 50.0))]


def test_picking_again_takes_out_and_what_is_gone_is_not_picked(session, scene, blocks):
    short, tall = blocks
    assert (session.picked, session.selected) == ([short, tall], tall)
    session.pick_also(tall)
    assert (session.picked, session.selected) == ([short], short)
    session.pick_also(tall)
    scene.remove(short)
    assert session.picked == [tall]
    session.selected = tall
    assert session.picked == [tall]


def test_what_is_done_to_several_is_undone_at_once(session, scene, blocks):
    before = [block.position for block in blocks]
    for _ in range(3):
        act(session, "nudge_up")
    for block, place in zip(blocks, before, strict=True):
        assert block.position[1] > place[1]
    assert len(session.history.done) == 1, "keys that are held are one edit"
    act(session, "undo")
    assert all((block.position == place).all() for block, place in zip(blocks, before, strict=True))
    act(session, "redo")
    act(session, "undo")
    changes = {
        "hide": lambda: [block.visible for block in blocks] == [False, False],
        "remove": lambda: not {"short block", "tall block"} & set(scene.instances.names),
    }
    for action, changed in changes.items():
        act(session, action)
        assert changed()
        act(session, "undo")
        assert not changed()


def test_lights_are_removed_with_instances_and_locked_objects_stay(session, scene, blocks):
    lamp = scene.add(sv.PointLight((1, 1, 1)))
    session.pick_also(lamp)
    session.locked.add(blocks[0])
    height = blocks[0].position[1]
    act(session, "nudge_up")
    assert blocks[0].position[1] == height
    assert lamp.position[1] > 1
    act(session, "remove")
    assert blocks[0] in scene.instances
    assert blocks[1] not in scene.instances
    assert lamp not in scene.lights
    act(session, "undo")
    assert (blocks[1] in scene.instances, lamp in scene.lights) == (True, True)


def test_handles_turn_all_about_the_last(session, blocks):
    pytest.importorskip("imgui_bundle")
    from solari_vk.studio.viewer.gizmo import Gizmo

    short, tall = blocks
    short.position = np.add(tall.position, (0.5, 0, 0.2))
    apart = short.transform[:3, 3] - tall.transform[:3, 3]
    turn = np.eye(4)
    turn[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    turned = tall.transform.copy()
    turned[:3, :3] = turn[:3, :3] @ turned[:3, :3]
    Gizmo(session)._move(tall, tall.transform, turned)
    np.testing.assert_allclose(short.transform[:3, 3] - tall.transform[:3, 3], turn[:3, :3] @ apart, atol=1e-6)
    act(session, "undo")
    np.testing.assert_array_equal(short.transform[:3, 3] - tall.transform[:3, 3], apart)


def test_the_outline_is_around_all(blocks):
    class Pictures:
        ready = True
        mode = "reference"
        camera = sv.Camera()

        class binder:
            instances = {4: blocks[0], 5: blocks[1], 6: None}

        class reference:
            tracer = {"instance_id": np.array([[4, 5, 6]], np.uint32)}

    assert covered(Pictures, blocks).tolist() == [[True, True, False]]


def test_files_become_textures_of_what_is_picked(session, scene, blocks, tmp_path, monkeypatch):
    path = tmp_path / "red.png"
    sv.save_image(path, np.full((4, 8, 3), (1, 0, 0), np.float32), tonemap="none")
    materials = {block.material for block in blocks}
    act(session, "drop", Event("drop", paths=(str(path),)))
    assert all(material.base_color_texture.image.pixels[0, 0, 0] == 255 for material in materials)
    assert scene.environment is None
    session.texture_field = "clearcoat_texture"
    act(session, "put_texture", path)
    assert all(material.clearcoat_texture.image.name == "red" for material in materials)
    while session.history.done:
        act(session, "undo")
    assert all(material.base_color_texture is material.clearcoat_texture is None for material in materials)
    with monkeypatch.context() as patch:
        refused = MagicMock(side_effect=sv.SolariError("no room"))
        patch.setattr(session.history, "assign_all", refused)
        patch.setattr(session.history, "assign", refused)
        act(session, "put_texture", path)
    assert "no room" in session.message
    act(session, "put_texture", tmp_path / "none.png")
    assert "none.png: there is no such file" in session.message
    session.selected = None
    act(session, "drop", Event("drop", paths=(str(tmp_path / "a.ktx2"),)))
    assert "pick something first" in session.message or "a.ktx2" in session.message
    act(session, "drop", Event("drop", paths=(str(path),)))
    assert scene.environment.image.shape == (4, 8, 3), "without an instance a picture surrounds the scene"
