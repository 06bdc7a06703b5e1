"""The viewer plays, pauses and scrubs the clips of a scene."""

from __future__ import annotations

import glfw
import numpy as np
import pytest
from support.scenes import bent_joints, tube
from viewer_tools import make_session, type_keys

import solari_vk as sv
from solari_vk.studio.viewer import panels
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.player import Player
from solari_vk.studio.viewer.saving import script_text
from solari_vk.studio.viewer.screenshot import command_line


@pytest.fixture
def scene():
    """A tube with two clips, which turn its middle joint to the left and to the right."""
    mesh, rest = tube(3)
    local = np.tile(np.eye(4), (3, 1, 1))
    local[1:, 1, 3] = 1.0
    rig = sv.Rig([-1, 0, 1], local, local[:, :3, 3], [(0, 0, 0, 1)] * 3, np.ones((3, 3)))
    instance = sv.Instance(mesh, joint_matrices=bent_joints(rest, 0))
    rig.attach_skin(instance, range(3), rest, np.linalg.inv(rest))
    made = sv.Scene(instance, sv.DirectionalLight((0, -1, -1)), sv.Camera.look_at((0, 1, 4), (0, 1, 0)))
    for name, side in (("left", 1.0), ("right", -1.0)):
        keys = [[0, 0, 0, 1], [0, 0, 0.6 * side, 0.8]]
        made.animations.add(sv.Animation(rig, [sv.Channel(1, "rotation", [0, 2], keys)], name=name))
    return made


def lean(scene):
    """How far the tip of the tube is to the right."""
    return float(scene.instances[0].posed_mesh().positions[-8:, 0].mean())


def test_a_player(scene):
    player = Player(scene)
    player.advance(1.0)
    assert not player.posed
    assert lean(scene) == pytest.approx(0)
    player.playing = True
    player.advance(1.0)
    middle = lean(scene)
    assert middle < -0.3
    player.advance(0.9)
    assert lean(scene) < middle
    player.advance(0.2)
    assert player.seconds == pytest.approx(0.1), "a clip starts again"
    player.choose(1)
    assert player.seconds == 0
    player.show(1.0)
    assert lean(scene) == pytest.approx(-middle)
    player.playing = False
    player.advance(0.5)
    assert player.seconds == 1.0
    scene.animations.clear()
    player.show(0.5)
    assert player.clip is None


@pytest.fixture
def moving_ball():
    """A session without a window whose ball two clips move to the right, the second one faster; and the ball."""
    rig = sv.Rig([-1], [np.eye(4)], [(0, 0, 0)], [(0, 0, 0, 1)], np.ones((1, 3)))
    ball = sv.Instance(sv.shapes.sphere(), name="ball")
    rig.attach(ball, 0)
    scene = sv.Scene(ball, sv.PointLight((0, 3, 0)))
    for speed in (1.0, 2.0):
        scene.animations.add(sv.Animation(rig, [sv.Channel(0, "translation", [0, 4], [(0, 0, 0), (4 * speed, 0, 0)])]))
    return make_session(scene), ball


def run_script(path):
    """The scene of a saved script, without its picture."""
    names = {"__file__": str(path)}
    exec(path.read_text().partition("with sv.Device")[0], names)
    return names["scene"]


def test_saved_scripts_show_the_clip_and_the_edits(moving_ball, tmp_path):
    session, ball = moving_ball
    session.player.choose(1)
    session.player.show(1.0)
    act(session, "save", tmp_path / "posed.glb")
    np.testing.assert_allclose(run_script(tmp_path / "posed.py").instances["ball"].position, (2, 0, 0), atol=1e-6)
    session.edit(ball, position=(0, 5, 0))
    session.edit(ball, visible=False)
    session.scene.animations.remove(session.scene.animations[1])
    act(session, "save", tmp_path / "edited.glb")
    assert "scene.animate(1.0, 0)" in (tmp_path / "edited.py").read_text()
    found = run_script(tmp_path / "edited.py").instances["ball"]
    assert (found.position.tolist(), found.visible) == ([0, 5, 0], False)
    ball.name = ""
    act(session, "save", tmp_path / "nameless.glb")
    assert "the transform of Instance" in session.message
    run_script(tmp_path / "nameless.py")


def test_saved_scripts_render_the_frames_since_a_change(moving_ball):
    session, _ = moving_ball
    session.pictures.mode, session.pictures.ready = "split", True
    session.pictures.upscale, area = 2.0, session.picture_area
    moving = script_text(session, "a.glb")
    assert "range(64)" in moving, "the finished picture's"
    assert f"scene, ({area.width}, {area.height})" in moving
    assert "upscale" not in moving
    session.refinement.enabled = False
    assert "upscale=2.0" in script_text(session, "a.glb")
    for number, view in enumerate("abbb"):
        session.refinement.begin_frame(view)
        assert f"range({max(number, 1)})" in script_text(session, "a.glb")
    for _ in range(200):
        session.refinement.begin_frame("b")
    assert "range(64)" in script_text(session, "a.glb")
    assert "realtime picture of the mode split" in script_text(session, "a.glb").partition("\n")[0]


def test_keys_play_and_choose(open_viewer, scene):
    viewer = open_viewer(scene, overlay=False)
    viewer.run(frames=2)
    assert lean(scene) == pytest.approx(0)
    type_keys(viewer, glfw.KEY_SPACE)
    viewer.run(frames=3)
    assert viewer.player.playing
    assert lean(scene) < 0
    type_keys(viewer, glfw.KEY_SPACE, glfw.KEY_N)
    assert not viewer.player.playing
    assert viewer.player.clip.name == "right"
    assert "--clip 1 --time 0.0" in command_line(viewer, viewer.folder)
    rig = scene.animations[0].rig
    scene.animations.clear()
    scene.animations.add(sv.Animation(rig, [sv.Channel(0, "scale", [0, 1], [[1, 1, 1], [1e30, 1, 1]])], name="burst"))
    viewer.player.playing, viewer.player.seconds = True, 0.5
    viewer.run(frames=2)
    assert not viewer.player.playing, "poses that can't be shown end playing"
    assert "burst" in viewer.message


def test_the_panel_scrubs(open_viewer, scene, replace):
    viewer = open_viewer(scene, size=(160, 100))
    slider = panels.imgui.slider_float

    def scrub(label, *given, **options):
        return (True, 1.5) if label == "seconds" else slider(label, *given, **options)

    replace(slider_float=scrub)
    viewer.run(frames=2)
    assert viewer.player.seconds == 1.5
    assert lean(scene) < -0.3
