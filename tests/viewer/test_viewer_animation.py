"""The viewer plays, pauses and scrubs the clips of a scene."""

from __future__ import annotations

import glfw
import numpy as np
import pytest
from support.characters import bent, tube
from viewer_tools import type_keys

import solari_vk as sv
from solari_vk.viewer import panels
from solari_vk.viewer.player import Player
from solari_vk.viewer.screenshot import command_line


@pytest.fixture
def scene():
    """A tube with two clips, which turn its middle joint to the left and to the right."""
    mesh, rest = tube(3)
    local = np.tile(np.eye(4), (3, 1, 1))
    local[1:, 1, 3] = 1.0
    rig = sv.Rig([-1, 0, 1], local, local[:, :3, 3], [(0, 0, 0, 1)] * 3, np.ones((3, 3)))
    instance = sv.Instance(mesh, joint_matrices=bent(rest, 0))
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
