"""Ids of lights and the translation between two frames' lists of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.index_translation import (
    CHANGE_DECAY,
    NAMES,
    IndexTranslation,
    share_changed,
    share_moved,
    translate,
)
from solari_vk.scene.model import DirectionalLight, Instance, Material, Mesh

IDS = st.lists(st.integers(1, 12), unique=True).map(lambda ids: np.array(ids, np.uint32))


@given(IDS, IDS)
def test_translate_agrees_with_a_linear_search(ids, others):
    expected = [others.tolist().index(n) if n in others else NO_INDEX for n in ids]
    np.testing.assert_array_equal(translate(ids, others), np.array(expected, np.uint32))


@pytest.fixture
def lights(device):
    made = IndexTranslation(device)
    yield made
    made.close()


def read(lights, count):
    return [lights.buffers[name].read(np.uint32, count).tolist() for name in NAMES]


def test_buffers_map_indices_of_two_frames_to_each_other(lights):
    powers = np.ones(199)
    first = np.array([1, 2, 3], np.uint32)
    lights.update(first, powers[:3])
    assert read(lights, 3)[1] == [NO_INDEX] * 3  # all are new
    lights.update(first, powers[:3])
    assert read(lights, 3) == [[0, 1, 2], [0, 1, 2]]
    second = np.array([3, 4, 1], np.uint32)
    assert not lights.update(second, powers[:3])
    assert read(lights, 3) == [[2, NO_INDEX, 0], [2, NO_INDEX, 0]]
    many = np.arange(1, 200, dtype=np.uint32)
    assert lights.update(many, powers), "a longer list needs new buffers"
    assert read(lights, 3)[0] == [2, 3, 0]


def test_pixels_of_the_previous_frame_know_no_light_that_moved(lights):
    """Where a light moves, only its samples of this frame count; indices of stored samples stay valid."""
    ids = np.array([1, 2, 3], np.uint32)
    first = np.zeros((3, 3))
    powers = np.ones(3)
    moved = np.array([[0, 0, 0], [0, 1e-3, 0], [0, 0, 0]])
    known = []
    for order, places in (([0, 1, 2], first), ([0, 1, 2], moved), ([0, 1, 2], moved), ([2, 1, 0], first)):
        lights.update(ids if order == [0, 1, 2] else ids[order], powers, places)
        known.append(read(lights, 3))
    assert known[1:] == [[[0, 1, 2], [0, NO_INDEX, 2]], [[0, 1, 2]] * 2, [[2, 1, 0], [2, NO_INDEX, 0]]]


def test_share_of_power_that_was_added_or_removed():
    ids, powers = np.array([1, 2, 3], np.uint32), np.array([1.0, 2.0, 5.0])
    none, dark = np.zeros(0, np.uint32), np.zeros(0)
    for old, new, share in (
        ((ids, powers), (ids, powers), 0),
        ((ids, powers), (ids[::-1], powers[::-1]), 0),  # the order of the lights doesn't matter
        ((ids, powers), (none, dark), 1),
        ((none, dark), (ids, powers), 1),
        ((none, dark), (none, dark), 0),
        ((ids, 0 * powers), (ids, 0 * powers), 0),
        ((ids, powers), (ids[1:], powers[1:]), 1 / 8),
        ((ids, powers), (ids[:2], powers[:2]), 1),  # more than half counts as all
        ((ids, powers), (ids, np.array([1.0, 2.0, 6.0])), 1 / 9),
        ((ids, powers), (ids + 10, powers), 1),  # the share is at most 1
    ):
        assert share_changed(*old, *new) == share


def test_change_decays(lights):
    ids, powers = np.array([1, 2], np.uint32), np.array([3.0, 1.0])
    lights.update(ids, powers)
    assert lights.changed_power == 0, "the first frame has nothing to compare with"
    lights.update(ids[:1], powers[:1])
    assert lights.changed_power == 1 / 4
    dimmed = powers[:1]
    for frame in range(1, 40):
        lights.update(ids[:1], dimmed)
        assert lights.changed_power in (0, pytest.approx(CHANGE_DECAY**frame / 4))
    assert lights.changed_power == 0


def test_share_of_power_that_moved():
    """A light counts with its distance in cells, at most 1, times its power; added and removed lights don't count."""
    ids, powers = np.array([7, 5, 9], np.uint32), np.array([1.0, 2.0, 5.0])
    positions = np.arange(9.0).reshape(3, 3)
    assert share_moved(ids, positions, ids, positions, powers, 0.5) == 0
    assert share_moved(ids, positions, ids[::-1], positions[::-1], powers[::-1], 0.5) == 0, "order"
    moved = positions + np.array([(0, 0, 0), (0, 0.25, 0), (100, 0, 0)])
    assert share_moved(ids, positions, ids, moved, powers, 0.5) == pytest.approx((2 * 0.5 + 5) / 8)
    assert share_moved(ids + 10, positions, ids, moved, powers, 0.5) == 0
    assert share_moved(ids[1:], positions[1:], ids[:2], positions[:2] + 1.0, powers[:2], 0.5) == pytest.approx(2 / 3)


# ---- lights of a scene ------------------------------------------------------------------------------


def triangle(width=2, height=1):
    return Mesh(positions=[[0, 0, 0], [width, 0, 0], [0, height, 0]])


def test_positions_follow_lamps_and_suns(bound):
    mesh = triangle(height=4)
    lamps = [Instance(mesh=mesh, material=Material(emissive=1.0)) for _ in range(20)]
    sun = DirectionalLight(direction=[0, -1, 0])
    binder = bound(*lamps, sun)

    def positions():
        binder.update()
        return binder.lights.positions

    np.testing.assert_allclose(positions(), [(1, 2, 0)] * 20 + [(0, 10, 0)])
    known = positions()
    lamps[3].material.base_color = [1, 0, 0]
    assert positions() is known, "nothing moved"
    lamps[19].transform = [5, 0, 0]
    sun.direction = [1, 0, 0]
    np.testing.assert_allclose(positions()[-2:], [(6, 2, 0), (-10, 0, 0)])
    binder.scene.remove(lamps[0])  # the last one takes its index
    np.testing.assert_allclose(positions()[0], (6, 2, 0))


def test_powers_follow_emission_area_and_suns(bound):
    mesh = triangle()
    lamp = Instance(mesh=mesh, material=Material(emissive=3.0), transform=np.diag([2, 2, 2, 1]))
    sun = DirectionalLight(direction=[0, -1, 0], illuminance=7.0)
    binder = bound(lamp, sun)

    def powers():
        binder.update()
        return binder.lights.powers

    def area():
        """That of a disk around the lamp's box, which is the scene."""
        half = np.abs(lamp.transform[:3, :3]) @ np.ptp(mesh.positions, axis=0) / 2
        return np.pi * np.square(half).sum()

    np.testing.assert_allclose(powers(), [np.pi * 3 * 4, 7.0 * area()])
    known = powers()
    turn = np.eye(4)
    turn[:3, :3] = 2 * np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    lamp.transform = turn
    assert powers() is known, "turning a lamp changes nothing"
    lamp.material.emissive = [6, 6, 6]
    sun.illuminance = 1.0
    np.testing.assert_allclose(powers(), [np.pi * 6 * 4, area()], rtol=1e-6)
    mesh.positions = triangle(width=4).positions
    np.testing.assert_allclose(powers(), [np.pi * 6 * 8, area()], rtol=1e-6)
    lamp.visible = False
    np.testing.assert_allclose(powers(), [area()], rtol=1e-6)


def test_ids_stay_with_their_light(bound):
    mesh = triangle()
    first, second = (Instance(mesh=mesh, material=Material(emissive=n)) for n in (1, 2))
    sun = DirectionalLight(direction=[0, -1, 0])
    binder = bound(first, second, sun)

    def ids():
        binder.update()
        lights = {lamp: binder.lights.index(lamp) for lamp in binder.scene.instances}
        return {light: int(binder.lights.ids[index]) for light, index in (lights | {sun: -1}).items()}

    before = ids()
    binder.scene.remove(first)
    assert ids() == {second: before[second], sun: before[sun]}
    binder.scene.add(first)
    assert ids()[first] not in before.values(), "a light that was removed and added again is a new light"
    known = ids()
    second.material.emissive = [9, 9, 9]
    second.transform = np.diag([2, 2, 2, 1])
    sun.illuminance = 5.0
    assert ids() == known
    second.mesh = triangle(width=3)
    assert ids()[second] not in known.values(), "the triangles of the old mesh no longer exist"
    known = ids()
    mesh.positions = triangle(width=3).positions
    assert ids()[first] != known[first]
    assert ids()[sun] == known[sun]
