"""Ids of lights and the translation between two frames' lists of them."""

import numpy as np
import pytest

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.index_translation import (
    CHANGE_DECAY,
    NAMES,
    IndexTranslation,
    share_changed,
    share_moved,
    translate,
)
from solari_vk.scene.model import DirectionalLight, Instance, Material, Mesh, Scene

POWERS = np.ones(199)


def search_each(ids, others):
    return np.array([list(others).index(n) if n in others else NO_INDEX for n in ids], np.uint32)


@pytest.mark.parametrize("seed", range(20))
def test_translate_agrees_with_a_linear_search(seed):
    rng = np.random.default_rng(seed)
    ids, others = (rng.permutation(12)[: rng.integers(0, 12)].astype(np.uint32) + 1 for _ in range(2))
    np.testing.assert_array_equal(translate(ids, others), search_each(ids, others))


def test_buffers_map_indices_of_two_frames_to_each_other(device):
    lights = IndexTranslation(device)

    def read(count):
        return [lights.buffers[name].read(np.uint32, count).tolist() for name in NAMES]

    first = np.array([1, 2, 3], np.uint32)
    lights.update(first, POWERS[:3])
    assert read(3)[1] == [NO_INDEX] * 3  # all are new
    lights.update(first, POWERS[:3])
    assert read(3) == [[0, 1, 2], [0, 1, 2]]
    second = np.array([3, 4, 1], np.uint32)
    assert not lights.update(second, POWERS[:3])
    assert read(3) == [[2, NO_INDEX, 0], [2, NO_INDEX, 0]]
    many = np.arange(1, 200, dtype=np.uint32)
    assert lights.update(many, POWERS), "a longer list needs new buffers"
    assert read(3)[0] == [2, 3, 0]
    lights.close()


def test_pixels_of_the_previous_frame_know_no_light_that_moved(device):
    """Where a light moves, only its samples of this frame count; indices of stored samples stay valid."""
    lights = IndexTranslation(device)
    ids, first = np.array([1, 2, 3], np.uint32), np.zeros((3, 3))
    moved = np.array([[0, 0, 0], [0, 1e-3, 0], [0, 0, 0]])
    known = []
    for order, places in (([0, 1, 2], first), ([0, 1, 2], moved), ([0, 1, 2], moved), ([2, 1, 0], first)):
        lights.update(ids if order == [0, 1, 2] else ids[order], POWERS[:3], places)
        known.append([lights.buffers[name].read(np.uint32, 3).tolist() for name in NAMES])
    assert known[1:] == [[[0, 1, 2], [0, NO_INDEX, 2]], [[0, 1, 2]] * 2, [[2, 1, 0], [2, NO_INDEX, 0]]]
    lights.close()


def test_share_of_power_that_was_added_or_removed():
    ids, powers = np.array([1, 2, 3], np.uint32), np.array([1.0, 2.0, 5.0])
    empty, dark = np.zeros(0, np.uint32), np.zeros(0)
    assert share_changed(ids, powers, ids, powers) == 0
    assert share_changed(ids, powers, ids[::-1], powers[::-1]) == 0, "the order of the lights doesn't matter"
    assert share_changed(ids, powers, empty, dark) == share_changed(empty, dark, ids, powers) == 1
    assert share_changed(empty, dark, empty, dark) == share_changed(ids, 0 * powers, ids, 0 * powers) == 0
    assert share_changed(ids, powers, ids[:2], powers[:2]) == 5 / 8
    assert share_changed(ids, powers, ids, np.array([1.0, 2.0, 6.0])) == 1 / 9
    assert share_changed(ids, powers, ids + 10, powers) == 1, "the share is at most 1"


def test_change_decays(device):
    lights = IndexTranslation(device)
    ids, powers = np.array([1, 2], np.uint32), np.array([3.0, 1.0])
    lights.update(ids, powers)
    assert lights.change == 0, "the first frame has nothing to compare with"
    lights.update(ids[:1], powers[:1])
    assert lights.change == 1 / 4
    dimmed = powers[:1]
    for frame in range(1, 40):
        lights.update(ids[:1], dimmed)
        assert lights.change in (0, pytest.approx(CHANGE_DECAY**frame / 4))
    assert lights.change == 0
    lights.close()


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


def test_positions_follow_lamps_and_suns(device):
    mesh = Mesh(positions=[[0, 0, 0], [2, 0, 0], [0, 4, 0]])
    lamps = [Instance(mesh=mesh, material=Material(emissive=[1, 1, 1])) for _ in range(20)]
    scene = Scene(*lamps, sun := DirectionalLight(direction=[0, -1, 0]))
    binder = SceneBinder(device, scene)

    def positions():
        binder.update()
        return binder.lights.positions

    np.testing.assert_allclose(positions(), [(1, 2, 0)] * 20 + [(0, 10, 0)])
    known = positions()
    lamps[3].material.base_color = [1, 0, 0]
    assert positions() is known, "nothing moved"
    moved = np.eye(4)
    moved[:3, 3] = 5, 0, 0
    lamps[19].transform = moved
    sun.direction = [1, 0, 0]
    np.testing.assert_allclose(positions()[-2:], [(6, 2, 0), (-10, 0, 0)])
    scene.remove(lamps[0])  # the last one takes its index
    np.testing.assert_allclose(positions()[0], (6, 2, 0))
    binder.destroy()


def test_powers_follow_emission_area_and_suns(device):
    mesh = Mesh(positions=[[0, 0, 0], [2, 0, 0], [0, 1, 0]])
    lamp = Instance(mesh=mesh, material=Material(emissive=[3, 3, 3]), transform=np.diag([2, 2, 2, 1]))
    sun = DirectionalLight(direction=[0, -1, 0], illuminance=7.0)
    scene = Scene(lamp, sun)
    binder = SceneBinder(device, scene)

    def powers():
        binder.update()
        return binder.lights.powers

    np.testing.assert_allclose(powers(), [np.pi * 3 * 4, 7.0])
    known = powers()
    turn = np.eye(4)
    turn[:3, :3] = 2 * np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    lamp.transform = turn
    assert powers() is known, "turning a lamp changes nothing"
    lamp.material.emissive = [6, 6, 6]
    sun.illuminance = 1.0
    np.testing.assert_allclose(powers(), [np.pi * 6 * 4, 1.0])
    mesh.positions = [[0, 0, 0], [4, 0, 0], [0, 1, 0]]
    np.testing.assert_allclose(powers(), [np.pi * 6 * 8, 1.0])
    lamp.visible = False
    np.testing.assert_allclose(powers(), [1.0])
    binder.destroy()


def test_ids_stay_with_their_light(device):
    mesh = Mesh(positions=[[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    lamps = [Instance(mesh=mesh, material=Material(emissive=[n, 1, 1])) for n in (1, 2, 3)]
    sun = DirectionalLight(direction=[0, -1, 0])
    scene = Scene(*lamps, sun)
    binder = SceneBinder(device, scene)

    def ids():
        binder.update()
        found = {lamp: int(binder.lights.ids[binder.lights.index(lamp)]) for lamp in lamps if lamp in scene.instances}
        return found | {sun: int(binder.lights.ids[-1])}

    before = ids()
    scene.remove(lamps[0])
    after = ids()
    assert after == {light: before[light] for light in after}
    scene.add(lamps[0])
    assert ids()[lamps[0]] not in before.values(), "a light that was removed and added again is a new light"
    known = ids()
    lamps[1].material.emissive = [9, 9, 9]
    lamps[1].transform = np.diag([2, 2, 2, 1])
    sun.illuminance = 5.0
    assert ids() == known
    lamps[1].mesh = Mesh(positions=[[0, 0, 0], [2, 0, 0], [0, 1, 0]])
    assert ids()[lamps[1]] not in known.values(), "the triangles of the old mesh no longer exist"
    known = ids()
    mesh.positions = [[0, 0, 0], [3, 0, 0], [0, 1, 0]]
    assert ids()[lamps[0]] != known[lamps[0]]
    assert ids()[sun] == known[sun]
    binder.destroy()
