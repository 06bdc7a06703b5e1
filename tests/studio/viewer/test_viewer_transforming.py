"""What the cursor, axes and typed numbers make of an object's place, without a window and a device."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.transforming import KINDS, Sight, Transforming

AREA = Area(40, 0, 640, 360)  # beside something else
START = (400.0, 170.0)
PIVOT = np.array((0.2, 0.3, -0.1))


def sight_of(orthographic=0.0, position=(1, 2, 4)):
    camera = sv.Camera.look_at(position, np.add(PIVOT, (0.1, 0.2, 0)), fov=40)
    camera.orthographic_height = orthographic
    return Sight(camera, AREA)


def begin(kind="move", sight=None, own_axes=None, cursor=START):
    return Transforming(kind, sight or sight_of(), PIVOT, np.eye(3) if own_axes is None else own_axes, cursor)


def type_text(transforming, text):
    for character in text:
        assert transforming.type(character)


@pytest.mark.parametrize("orthographic", [0.0, 3.0])
@pytest.mark.parametrize("axis", [None, 0, 1, 2])
@pytest.mark.parametrize("is_plane", [False, True])
def test_what_moves_stays_under_the_cursor(orthographic, axis, is_plane):
    """By the camera's own projection: the pivot goes where the cursor takes it, or as near as its axis allows."""
    sight = sight_of(orthographic)
    transforming = begin(sight=sight, cursor=tuple(sight.project(PIVOT)))
    if axis is not None:
        transforming.constrain(axis, is_plane)
    goal = np.add(sight.project(PIVOT), (40, -25))
    transforming.move_cursor(tuple(goal))
    moved = transforming.vector
    assert np.linalg.norm(moved) > 0.05
    at = sight.project(PIVOT + moved)
    if axis is None or is_plane:
        assert at == pytest.approx(goal, abs=1e-6)
        across = sight.back if axis is None else np.eye(3)[axis]
        assert moved @ across == pytest.approx(0, abs=1e-9)
        return
    assert moved == pytest.approx(np.eye(3)[axis] * moved[axis], abs=1e-12)
    # No other point of the axis is nearer to the ray of the cursor.
    point, direction = sight.ray(tuple(goal), 4.0)
    places = PIVOT + np.eye(3)[axis] * (moved[axis] + np.array([[-0.01], [0], [0.01]]))
    distances = np.linalg.norm(np.cross(places - point, direction), axis=1)
    assert distances.argmin() == 1


def test_an_axis_along_the_view_follows_up_and_down_and_the_horizon_is_no_place():
    sight = sight_of()
    sight.camera.transform = sv.Camera.look_at(np.add(PIVOT, (0, 0, 4)), PIVOT).transform
    transforming = begin(sight=sight)
    transforming.constrain(2)
    transforming.move_cursor((START[0] + 20, START[1]))
    assert transforming.vector == pytest.approx(np.zeros(3))
    transforming.move_cursor((START[0], START[1] - 30))
    assert transforming.vector[2] < -0.05, "up is away from the camera"
    transforming.constrain(1, plane=True)  # seen from its edge
    transforming.move_cursor((START[0] + 30, START[1]))
    assert transforming.vector == pytest.approx(np.zeros(3))
    low = begin(sight=sight_of(position=(0, 0.8, 4)))
    low.constrain(1, plane=True)
    low.move_cursor((START[0], START[1] - 3))
    nearer = low.vector
    low.move_cursor((START[0], START[1] - 300))  # above the horizon
    assert low.vector == pytest.approx(nearer)


def test_the_same_axis_again_is_the_objects_own_and_then_none():
    turn = sv.scene.matrices.rotation((0, 0, 1), math.radians(30))
    transforming = begin(own_axes=turn)
    type_text(transforming, "2")
    texts, vectors = [], []
    for _ in range(3):
        transforming.constrain(0)
        texts.append(transforming.text)
        vectors.append(transforming.vector)
    assert texts == ["move [2] m along X", "move [2] m along its own X", "move [2] m"]
    assert vectors[0] == pytest.approx((2, 0, 0))
    assert vectors[1] == pytest.approx(2 * turn[:, 0])
    transforming.constrain(0)
    transforming.constrain(2)
    assert transforming.vector == pytest.approx((0, 0, 2)), "another axis is the world's again"


def test_numbers_are_typed_with_sign_comma_and_the_next_axis():
    transforming = begin()
    for character in "1,5-":
        assert transforming.type(character)
    assert not transforming.type("q")
    assert transforming.vector == pytest.approx((-1.5, 0, 0))
    transforming.next_number()
    transforming.next_number()
    type_text(transforming, ".25")
    assert transforming.text == "move [-1.5], [], [.25] m"
    assert transforming.vector == pytest.approx((-1.5, 0, 0.25))
    transforming.next_number()
    assert len(transforming.numbers) == 3, "there is no fourth axis"
    transforming.move_cursor((0, 0))
    assert transforming.vector == pytest.approx((-1.5, 0, 0.25)), "the cursor doesn't count"
    for _ in range(20):
        transforming.erase()
    assert not transforming.is_typed
    assert np.linalg.norm(transforming.vector) > 0.1, "it counts again"
    transforming.constrain(1, plane=True)
    type_text(transforming, "3")
    transforming.next_number()
    type_text(transforming, "4")
    assert transforming.vector == pytest.approx((3, 0, 4))


@pytest.mark.parametrize(("axis", "sign"), [(None, 1), (2, 1), (0, 1), (1, 1)])
def test_turns_follow_the_cursor_around_the_pivot(axis, sign):
    """Two and a half turns of the cursor are so many of the object, also about axes that point away."""
    for side in (1, -1):
        sight = sight_of(position=PIVOT + side * np.array((1, 2, 4)))
        center = sight.project(PIVOT)
        transforming = begin("turn", sight, cursor=tuple(np.add(center, (60, 0))))
        if axis is not None:
            transforming.constrain(axis)
        for angle in np.linspace(0, 5 * np.pi, 40):
            transforming.move_cursor(tuple(center + 60 * np.array((np.cos(angle), -np.sin(angle)))))
        expected = 900 * (1 if axis is None else side)
        assert math.degrees(transforming.angle) == pytest.approx(expected)
    start = np.eye(4)
    start[:3, 3] = np.add(PIVOT, (1, 0, 0))
    transforming.begin("turn")
    transforming.constrain(1)
    type_text(transforming, "90")
    placed = transforming.place(start, start[:3, 3])
    assert placed[:3, 3] == pytest.approx(np.add(PIVOT, (0, 0, -1))), "counter-clockwise seen from +y"
    assert placed[:3, 0] == pytest.approx((0, 0, -1))


def test_scaling_shears_nothing_and_keeps_the_middle():
    start = np.eye(4)
    start[:3, :3] = sv.scene.matrices.rotation((1, 2, 3), 0.7) * (1, 2, 3)
    start[:3, 3] = np.add(PIVOT, (0.1, 0, 0))
    inside = np.array((0.3, -0.2, 0.1))
    middle = start[:3, :3] @ inside + start[:3, 3]
    transforming = Transforming("scale", sight_of(), middle, start[:3, :3] / (1, 2, 3), START)
    transforming.constrain(1)
    assert transforming.is_own
    type_text(transforming, "-2")
    placed = transforming.place(start, middle)
    assert placed[:3, :3] == pytest.approx(start[:3, :3] * (1, -2, 1))
    assert placed[:3, :3] @ inside + placed[:3, 3] == pytest.approx(middle)
    transforming.constrain(1)
    center = transforming.sight.project(middle)
    transforming.begin("scale")
    transforming.move_cursor(tuple(center + 2.5 * (np.array(START) - center)))
    assert transforming.factors == pytest.approx([2.5] * 3)
    aside = np.array((1, 0, 0))
    apart = start.copy()
    apart[:3, 3] += aside
    placed = transforming.place(apart, middle + aside)
    assert placed[:3, :3] @ inside + placed[:3, 3] == pytest.approx(middle + 2.5 * aside)
    transforming.move_cursor(tuple(center))
    assert transforming.factors[0] > 0, "the cursor makes nothing vanish"
    type_text(transforming, "2")
    transforming.next_number()
    type_text(transforming, "3")
    assert transforming.factors == pytest.approx((2, 3, 1))


@pytest.mark.parametrize("kind", KINDS)
def test_ctrl_moves_in_steps_and_shift_a_tenth(kind):
    coarse, fine = begin(kind), begin(kind)
    goal = START[0] + 57.3, START[1] + 31.9
    fine.move_cursor(goal, fine=True)
    coarse.move_cursor(goal)
    amounts = [
        np.linalg.norm({"move": t.vector, "turn": t.angle, "scale": t.factors - 1}[kind]) for t in (fine, coarse)
    ]
    assert 0.03 < amounts[0] / amounts[1] < 0.3
    coarse.snaps = True
    steps = {
        "move": coarse.vector / 0.1,
        "turn": np.array([math.degrees(coarse.angle) / 5]),
        "scale": coarse.factors / 0.1,
    }[kind]
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.abs(steps).max() >= 1
