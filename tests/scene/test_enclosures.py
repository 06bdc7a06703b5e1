"""Where the default camera stands with domes, shells and rooms, and that what it sees gets light."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.presenting import enclosures
from solari_vk.scene.presenting.lamplight import lit_shell
from solari_vk.scene.presenting.surroundings import surround

WHITE = matte(0.5)
SKY = sv.Material(base_color=(0.3, 0.5, 0.9), unlit=True, double_sided=True)
GROUND = shapes.cylinder(9.9, 0.1)
BALL = shapes.sphere(1.0, 16)


def flipped(mesh):
    return sv.Mesh(mesh.positions, mesh.triangles[:, ::-1])


def joined(*meshes):
    """One mesh of several."""
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    indices = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)]
    return sv.Mesh(np.concatenate([mesh.positions for mesh in meshes]), np.concatenate(indices))


def cave(radius):
    """The rough surface of a cave that is open to no side, with its front outside."""
    positions = shapes.sphere(radius, 24).positions
    rough = 1 + 0.05 * np.sin(7 * positions[:, :1] / radius) * np.cos(5 * positions[:, 1:2] / radius)
    return sv.Mesh(positions * rough, shapes.sphere(radius, 24).triangles)


def half(mesh):
    """The part of a mesh above its center."""
    return sv.Mesh(mesh.positions, mesh.triangles[(mesh.positions[mesh.triangles, 1] > -1e-3).all(axis=1)])


SPHERE = shapes.sphere(10.0, 24)
HOUSE = joined(shapes.box((-3, 0, -2), (3, 3, 2)), shapes.box((-2.8, 0.2, -1.8), (2.8, 2.8, 1.8), inward=True))
TABLE = shapes.box((-1, 0.2, -0.5), (1, 0.9, 0.5))
# For each scene its meshes, the first of them the shell with its material, and whether the camera is inside the shell.
SHAPES = {
    "a sky around a ball": (True, WHITE, flipped(SPHERE), BALL),
    "a tight sky": (True, WHITE, flipped(shapes.sphere(2.0, 24)), BALL),
    "a wide sky": (True, WHITE, flipped(shapes.sphere(900.0, 24)), BALL),
    "an unlit sky, seen from both sides": (True, SKY, SPHERE, BALL),
    "an unlit skybox": (True, SKY, shapes.box((-10, -10, -10), (10, 10, 10)), BALL),
    "half a sky": (True, WHITE, half(flipped(SPHERE)), shapes.sphere(1.0, 16)),
    "half a sky over ground": (True, WHITE, half(flipped(SPHERE)), GROUND, shapes.box((-1, 0.05, -1), (1, 2, 1))),
    "a sky without anything in it": (True, SKY, flipped(SPHERE)),
    "a cave without an outside": (True, WHITE, flipped(cave(4.0))),
    "a room": (True, WHITE, shapes.box((-3, 0, -2), (3, 3, 2), inward=True), TABLE),
    "a room in centimeters": (True, WHITE, shapes.box((-300, 0, -200), (300, 300, 200), inward=True)),
    "a furnished house": (True, WHITE, HOUSE, TABLE),
    "an empty house": (False, WHITE, HOUSE),
    "a cave in a rock": (False, WHITE, joined(cave(5.0), flipped(cave(4.0)))),
    "a statue": (False, WHITE, shapes.sphere(4.0, 24)),
    "a statue, seen from both sides": (False, replace(WHITE, double_sided=True), shapes.sphere(4.0, 24)),
    "a car with seats": (False, replace(WHITE, double_sided=True), shapes.box((-3, 0, -2), (3, 3, 2)), TABLE),
    "a hollow statue": (False, WHITE, joined(shapes.sphere(4.0, 24), flipped(shapes.sphere(3.9, 24)))),
    "a jar with honey": (False, WHITE, shapes.sphere(2.0, 24), flipped(shapes.sphere(1.9, 24)), BALL),
}


def lit_share(scene):
    """The share of the picture, of 8 x 8 pixels, that shows something lit."""
    camera, eye = scene.camera, scene.camera.transform[:3, 3]
    every = enclosures.largest_triangles(list(scene))
    shown, bright = [], []
    for instance in scene:  # without the faces that cameras don't see
        triangles = enclosures.largest_triangles([instance])
        a, b, c = triangles.swapaxes(0, 1)
        front = (np.cross(b - a, c - a) * (eye - a)).sum(axis=1) > 0
        shown.append(triangles[front | (not instance.material.hides_back)])
        bright += [instance.material.unlit] * len(shown[-1])
    triangles = np.concatenate(shown)
    lamps = [light.position for light in scene.lights if isinstance(light, PointLight)]
    count = 0
    for y, x in np.ndindex(8, 8):
        slope = np.tan(camera.vertical_fov / 2)
        direction = camera.transform[:3, :3] @ np.array(((x - 3.5) / 4 * slope, (y - 3.5) / 4 * slope, -1))
        seen = enclosures.trace(eye, direction[None], triangles)
        if not np.isfinite(seen.distance[0]):
            continue
        point = eye + seen.distance[0] * direction
        normal = seen.normal[0] * -np.sign(seen.normal[0] @ direction)
        toward = [lamp - point for lamp in lamps] or [np.add(normal, (0, 0.5, 0)), normal]
        free = enclosures.trace(point + 1e-3 * normal, np.array(toward), every).distance
        is_bright = enclosures.trace(eye, direction[None], triangles[bright]).distance[0] == seen.distance[0]
        count += is_bright or bool(((free > 0.999) & (np.array(toward) @ normal > 0)).any())
    return count / 64


@pytest.mark.parametrize("shape", SHAPES)
def test_the_camera_and_its_light_are_on_one_side_of_a_shell(shape):
    inside, material, *meshes = SHAPES[shape]
    scene = sv.Scene(sv.Instance(meshes[0], material), *(sv.Instance(mesh, WHITE) for mesh in meshes[1:]))
    bounds, camera = enclosures.extent([scene.instances[0]]), scene.camera
    eye = camera.transform[:3, 3]
    assert ((eye > bounds.min(axis=0)) & (eye < bounds.max(axis=0))).all() == inside
    if "sky" in shape and len(meshes) > 1:
        target = enclosures.extent([scene.instances[-1]])
        x, y, z = ((target - eye) @ camera.transform[:3, :3]).T
        assert (z < 0).all(), "in front of the camera"
        reach = np.abs([x / z, y / z]).max() / np.tan(camera.vertical_fov / 2)
        assert 0.5 < reach < 1, "in the picture, and fills it"
    surround(scene, camera, "auto")
    assert [light.emits for light in scene.lights] == [True]
    assert (scene.environment is None) == inside
    assert lit_share(scene) > 0.4


def test_a_camera_of_the_file_in_a_closed_shell_gets_a_lamp():
    scene = sv.Scene(sv.Instance(HOUSE, WHITE), sv.Camera.look_at((2, 1.6, 0), (-2, 1.5, 0)))
    given, in_studio = surround(scene, scene.camera, "auto")
    assert (given, in_studio) == ("seen within a closed shell, and gets a lamp", False)
    assert lit_share(scene) > 0.9


@pytest.mark.parametrize("away", [True, False])
def test_a_spot_outside_lights_a_closed_shell_only_within_its_cone(away):
    camera = sv.Camera.look_at((8, 1.5, 0), (0, 1.5, 0))
    lamps = [PointLight((0, 1, 0)), SpotLight((6, 1.5, 0), (1 if away else -1, 0, 0))]
    room = lit_shell(camera, [sv.Instance(HOUSE, WHITE)], lamps, HOUSE.positions)
    assert (room is not None) == away


def thick_room(*, front):
    """A room of slabs, 4 m wide, without a lamp; the side towards +z may be missing."""
    low, high = np.array((-2, 0, -2)), np.array((2, 4, 2))
    scene = sv.Scene()
    for axis, (side, at) in [(axis, end) for axis in range(3) for end in ((0, low), (1, high))]:
        ends = np.array([low, high], float)
        ends[:, axis] = at[axis] + np.array([side - 1, side]) * 0.1
        if front or (axis, side) != (2, 1):
            scene.add(shapes.box(*ends), sv.Material(base_color=0.7))
    return scene


LAMP = shapes.box((-0.6, 3.97, -0.6), (0.6, 3.99, 0.6))
# What is in the room, whether it is open in front, where the camera is along z, and what it gets for light.
ROOMS = {
    "a panel, open": ({"emissive": 1.0}, False, (8, 10), ""),
    "a panel, closed": ({"emissive": 1.0}, True, (-2, 2), ""),
    "a label": ({"emissive": 1e-4}, False, (8, 10), "a room, and gets a lamp, since its emissive surfaces light too"),
    "no lamp, open": ({}, False, (8, 10), "a room, and gets a lamp"),
    "no lamp, closed": ({}, True, (-2, 2), "a room, and gets a lamp"),
    "a lamp of the file, closed": (None, True, (-2, 2), ""),
}


@pytest.mark.parametrize("name", ROOMS)
def test_rooms_keep_their_lamps_and_are_seen_where_their_light_is(name, tmp_path):
    panel, closed, (low, high), words = ROOMS[name]
    scene = thick_room(front=closed)
    if panel is None:  # in an empty room, which has an outside too, but no light there
        scene.add(PointLight((0, 3, 0)))
    else:
        scene.add(BALL, WHITE, (0, 1, 0))
        scene.add(LAMP, sv.Material(**panel), name="panel")
    scene.save(tmp_path / "room.glb")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        opened = sv.open(tmp_path / "room.glb")
    x, _, z = opened.camera.transform[:3, 3]
    assert low < z < high
    assert abs(x) < 2
    told = f"Scene 'room' has no light of its own: it is {words}"
    assert bool(words) == any(text.startswith(told) for text in opened.warnings)
    assert len(opened.lights) == (panel is None) + bool(words)
    assert any(told in str(warning.message) for warning in said) == ("lamp" in words)


def test_a_screen_on_a_thing_is_no_light():
    """A strip around a drum lights nothing else that is seen."""
    scene = sv.Scene(sv.Instance(shapes.cylinder(1.0, 2.0), WHITE))
    scene.add(shapes.cylinder(1.001, 0.2), sv.Material(emissive=5.0), name="display")
    given, in_studio = surround(scene, scene.camera, "auto")
    assert (given.partition(",")[0], in_studio) == ("shown in a studio", True)
