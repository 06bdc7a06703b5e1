"""Position, rotation and scale of instances and groups."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.matrices import rotation

TURN = rotation((1, 2, 3), 0.8)


def instance(**fields):
    return sv.Instance(sv.shapes.box(), **fields)


def test_parts_are_assigned_one_by_one():
    made = instance(position=(1, 2, 3), scale=(2, 3, 4), rotation=TURN)
    np.testing.assert_allclose(made.transform[:3, :3], TURN * (2, 3, 4))
    for name, value in (("position", (7, 8, 9)), ("scale", (5, 5, 6)), ("rotation", rotation((0, 0, 1), 2))):
        before = {part: getattr(made, part) for part in ("position", "rotation", "scale")} | {name: value}
        for _ in range(2):  # the second time changes nothing
            setattr(made, name, value)
            for part, wanted in before.items():
                np.testing.assert_allclose(getattr(made, part), wanted, atol=1e-12)


QUATERNION = np.array((0, math.sin(0.25), 0, math.cos(0.25)))


@pytest.mark.parametrize("value", [0.5, QUATERNION, 2 * QUATERNION], ids=["angle", "unit", "longer"])
def test_rotations_are_angles_and_quaternions_too(value):
    np.testing.assert_allclose(instance(rotation=value).rotation, rotation((0, 1, 0), 0.5), atol=1e-12)


def test_shear_and_mirrors_stay():
    sheared = np.eye(4)
    sheared[:3, :3] = TURN @ [[-1, 0.3, 0], [0, 2, 0], [0, 0, 1]]
    made = instance(transform=sheared)
    np.testing.assert_allclose(made.scale, (1, math.hypot(0.3, 2), 1))
    held = made.rotation
    made.rotation = np.eye(3)
    made.rotation = held
    made.scale = made.scale
    np.testing.assert_allclose(made.transform, sheared, atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"scale": 0}, "Instance: scale must be one factor or three, .* not 0"),
        ({"scale": (1, -1, 1)}, "above 0"),
        ({"rotation": (0, 45, 0)}, r"must be a quaternion .* solari_vk.euler\(0, 90, 0\)"),
        ({"rotation": np.diag([1, 1, 2])}, "rotation must be"),
        ({"position": (1, 2)}, r"position must have the shape \(3,\)"),
        ({"position": (1, 2, np.nan)}, "must be finite"),
        ({"postion": (1, 2, 3)}, "did you mean 'position'"),
    ],
)
def test_refused_parts(fields, message):
    with pytest.raises(sv.SolariError, match=message):
        instance(**fields)
    made = instance()
    with pytest.raises(sv.SolariError, match=message):
        made.update(**fields)
    np.testing.assert_array_equal(made.transform, np.eye(4))


@pytest.mark.parametrize("name", ["position", "scale", "rotation"])
def test_elements_of_parts_are_not_lost_in_silence(name):
    made = sv.Group([instance()])
    for item in (made, *made, *([sv.Camera()] if name != "scale" else [])):
        with pytest.raises(sv.SolariError, match=r"read-only, and nothing moved: assign .*\.position = \(x, y, z\)"):
            getattr(item, name)[1] = 3
        mine = getattr(item, name).copy()
        mine[1] = 3  # a copy is the caller's
        assert not np.array_equal(mine, getattr(item, name))


def test_parts_change_in_place_by_operators():
    made = instance(position=(1, 2, 3))
    held = made.position
    made.position += (0, 1, 0)
    made.position -= (1, 0, 0)
    made.scale *= 2
    made.scale /= (1, 2, 1)
    made.rotation @= TURN
    np.testing.assert_allclose(made.position, (0, 3, 3))
    np.testing.assert_allclose(made.scale, (2, 1, 2))
    np.testing.assert_allclose(made.rotation, TURN, atol=1e-12)
    np.testing.assert_array_equal(held, (1, 2, 3))


def test_euler_angles_turn_about_x_then_y_then_z():
    turns = [rotation(axis, math.radians(angle)) for axis, angle in zip(np.eye(3), (20, -50, 110), strict=True)]
    made = instance(rotation=sv.euler(20, -50, 110))
    np.testing.assert_allclose(made.rotation, turns[2] @ turns[1] @ turns[0], atol=1e-12)
    with pytest.raises(sv.SolariError, match=r"three angles in degrees, such as euler\(0, 90, 0\)"):
        sv.euler((0, 90, 0))
    with pytest.raises(sv.SolariError, match="euler: takes three angles in degrees"):
        sv.euler(0, float("nan"))
