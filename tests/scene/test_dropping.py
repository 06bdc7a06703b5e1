"""Things that fall: they rest on something, meet nothing, and the seed decides where."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.matrices import transform_points

pytest.importorskip("mujoco")
GAP = 0.001  # meters, at most between what rests and what it rests on
KINDS = {
    "box": lambda: shapes.box((0.5, 0.2, 0), (0.7, 0.32, 0.08)),
    "ball": lambda: shapes.sphere(0.08, 12),
    "cone": lambda: shapes.cone(0.08, 0.2, 12),
    "can": lambda: shapes.cylinder(0.05, 0.16, 12),
}


def planes(instance, shift=0.0):
    """The planes (P, 4) of an instance's convex hull in the world, moved upwards."""
    points = transform_points(instance.transform, instance.mesh.positions.astype(np.float64))
    return ConvexHull(points + np.array((0, shift, 0))).equations


def depth(*bodies):
    """The radius of the largest sphere in all of these convex bodies: below 0 if they don't meet."""
    equations = np.concatenate(bodies)
    found = linprog(
        (0, 0, 0, -1),
        A_ub=np.column_stack([equations[:, :3], np.ones(len(equations))]),
        b_ub=-equations[:, 3],
        bounds=[(None, None)] * 3 + [(-10, 10)],
    )
    assert found.success
    return -found.fun


def table_scene():
    """A floor, and a table that is no convex mesh: a plate on a leg."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 0.7), (0.7, 0, 0)), name="floor")
    scene.add(shapes.box((-0.4, 0.3, -0.4), (0.4, 0.34, 0.4)), name="plate")
    scene.add(shapes.box((-0.05, 0, -0.05), (0.05, 0.3, 0.05)), name="leg")
    return scene


def add_things(scene, count):
    names = [name for _ in range(count) for name in KINDS]
    return [scene.add(KINDS[name](), name=f"{name} {number}") for number, name in enumerate(names)]


def check_rest(scene, things):
    """Nothing penetrates, and each thing would meet something if it were lower by the gap."""
    still = [planes(scene.instances[name]) for name in ("plate", "leg") if name in scene.instances]
    floor = np.array([[0, 1, 0, 0], [0, -1, 0, -10], [1, 0, 0, -9], [-1, 0, 0, -9], [0, 0, 1, -9], [0, 0, -1, -9.0]])
    still.append(floor)  # all below the floor
    bodies = [planes(thing) for thing in things]
    for number, body in enumerate(bodies):
        others = [*bodies[:number], *bodies[number + 1 :], *still]
        assert max(depth(body, other) for other in others) < 1e-4
        lower = planes(things[number], -GAP)
        assert max(depth(lower, other) for other in others) > 0


def test_things_rest_on_a_table_and_on_each_other():
    scene = table_scene()
    things = add_things(scene, 4)
    scene.drop(*things, seed=1)
    check_rest(scene, things)
    heights = np.array([thing.position[1] for thing in things])
    assert (heights > 0.33).any()
    assert np.ptp(np.round(heights, 2)) > 0.1


def test_the_seed_decides():
    found = []
    for seed in (1, 1, 2):
        scene = table_scene()
        things = add_things(scene, 1)
        scene.drop(*(thing.name for thing in things), seed=seed)
        found.append(np.stack([thing.transform for thing in things]))
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[2] - found[0]).max() > 0.05


def test_scales_mirrors_and_what_lies_above():
    """In a room: the ceiling is above the region. Things keep their scale."""
    scene = sv.Scene(sv.Instance(shapes.box((-1, 0, -1), (1, 2, 1), inward=True), name="room"))
    transform = np.diag((-0.5, 2.0, 1.0, 1.0))
    thing = scene.add(KINDS["box"](), transform=transform, name="thing")
    scene.drop(thing, region=[(-1, 0, -1), (1, 1.5, 1)], upright=True)
    check_rest(scene, [thing])
    np.testing.assert_allclose(thing.scale, (0.5, 2, 1))
    assert np.linalg.det(thing.transform[:3, :3]) == pytest.approx(-1)
    assert thing.transform[1, 1] == pytest.approx(2, abs=1e-2)
    corners = transform_points(thing.transform, thing.mesh.positions.astype(np.float64))
    assert np.abs(corners[:, [0, 2]]).max() < 1


def test_parts_of_an_object_fall_together():
    """A bench stands on its legs around a pole, on which the hull of all its parts would lie. A flat part falls too."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (0, 0, 2), (2, 0, 0)), name="floor"))
    scene.add(shapes.box((-0.02, 0, -0.02), (0.02, 0.2, 0.02)), name="pole")
    sizes = [((x, -0.3, -0.2), (x + 0.02, 0, 0.2)) for x in (-0.2, 0.18)] + [((-0.2, 0, -0.2), (0.2, 0.02, 0.2))]
    parts = [
        scene.add(shapes.box(*size), name=f"bench/{number}", part_of="bench", position=(3, 1, 0))
        for number, size in enumerate(sizes)
    ]
    for flat in (False, True):
        if flat:
            parts.append(scene.add(shapes.quad((0, 0.03, 0), (0, 0, 0.1), (0.1, 0, 0)), part_of="bench"))
        before = [part.transform for part in parts]
        scene.drop("bench", region=[(-0.34, 0, -0.34), (0.34, 0.5, 0.34)], upright=True)
        moves = [part.transform @ np.linalg.inv(was) for part, was in zip(parts, before, strict=True)]
        np.testing.assert_allclose(moves, [moves[0]] * len(parts), atol=1e-9)
        if not flat:
            points = [transform_points(part.transform, part.mesh.positions.astype(np.float64)) for part in parts]
            assert 0 <= np.concatenate(points)[:, 1].min() < GAP


def test_a_group_is_one_thing():
    scene = table_scene()
    parts = [scene.add(shapes.box(), name=f"cup/{x}", position=(x, 1, 0), scale=0.1) for x in (0.0, 0.1)]
    group = scene.group(*parts)
    before = np.linalg.inv(group.transform) @ parts[0].transform
    scene.drop(group, seed=3)
    np.testing.assert_allclose(group.transform @ before, parts[0].transform, atol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(parts[0].transform) @ parts[1].transform[:, 3], (1, 0, 0, 1), atol=1e-9)
    scene.drop(*group, seed=3)
    assert abs((np.linalg.inv(parts[0].transform) @ parts[1].transform[:, 3])[0] - 1) > 0.1
    with pytest.raises(SolariError, match=r"Instance 'cup/0\.0' is given twice"):
        scene.drop(group, parts[0])


def test_what_lies_far_below_the_region():
    scene = table_scene()
    scene.add(shapes.box((1, -9, 1), (4, -8, 4)), name="cellar")
    ball = scene.add(KINDS["ball"](), name="ball")
    scene.drop("ball", on=["cellar"], region=[(2, 0, 2), (3, 1, 3)])
    assert ball.position[1] == pytest.approx(-7.92, abs=0.01)


def test_what_can_not_fall():
    scene = table_scene()
    flat = scene.add(shapes.plane(0.2), name="sheet")
    with pytest.raises(SolariError, match="Instance 'sheet' is flat"):
        scene.drop(flat)
    large = scene.add(shapes.sphere(3), name="moon")
    with pytest.raises(SolariError, match=r"'moon', 6 m long, doesn't fit into a region of"):
        scene.drop(large, on=[scene.instances["floor"]])
    thing = scene.add(KINDS["ball"](), name="ball")
    before = thing.transform
    with pytest.raises(SolariError, match=r"region is a box"):
        scene.drop(thing, region=(1, 2))
    with pytest.raises(SolariError, match=r"things don't rest after 0.01 s"):
        scene.drop(thing, seconds=0.01)
    beside = {"on": ["leg"], "region": [(2, 0, 2), (3, 1, 3)]}
    with pytest.raises(SolariError, match=r"'ball' fell through: nothing is below it in the region"):
        scene.drop(thing, **beside, seconds=1000)
    with pytest.raises(SolariError, match="nothing to fall on"):
        sv.Scene(thing).drop(thing)
    speck = scene.add(shapes.sphere(1e-6, 8), name="speck")
    with pytest.raises(SolariError, match="Instance 'speck': MuJoCo can't"):
        scene.drop(speck, on="floor")
    stranger = sv.Instance(KINDS["ball"](), name="stranger")
    for items, fields, message in (
        ([thing, "ball"], {}, "Instance 'ball' is given twice"),
        ([stranger], {}, "Instance 'stranger' is not in the scene: add it first"),
        ([thing], {"on": [stranger]}, "Instance 'stranger' is not in the scene"),
        ([thing], {"on": ["flor"]}, "'flor'"),
        ([thing], {"on": 5}, "drop takes instances, not 5"),
        ([thing], {"seed": -1}, "seed must be a whole number from 0 on, not -1"),
        ([thing], {"seconds": 0}, "seconds must be a finite number between 0.002 and 100000 s, not 0"),
    ):
        with pytest.raises(SolariError, match=message):
            scene.drop(*items, **fields)
    assert thing.transform is before
