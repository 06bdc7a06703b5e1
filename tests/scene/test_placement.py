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


@pytest.mark.parametrize(("fields", "message"), [
    ({"scale": 0}, "Instance: scale must be one factor or three, .* not 0"), ({"scale": (1, -1, 1)}, "above 0"),
    ({"rotation": (0, 45, 0)}, "rotation must be a quaternion"), ({"rotation": np.diag([1, 1, 2])}, "rotation must be"),
    ({"position": (1, 2)}, r"position must have the shape \(3\)"), ({"position": (1, 2, np.nan)}, "must be finite"),
    ({"postion": (1, 2, 3)}, "did you mean 'position'"),
])  # fmt: skip
def test_refused_parts(fields, message):
    with pytest.raises(sv.SolariError, match=message):
        instance(**fields)
    made = instance()
    with pytest.raises(sv.SolariError, match=message):
        made.update(**fields)
    np.testing.assert_array_equal(made.transform, np.eye(4))
