"""Ids of lights and the translation between two frames' lists of them."""

import numpy as np
import pytest

from solari_vk.light_translation import GONE, NAMES, LightTranslation, translate
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import DirectionalLight, Instance, Material, Mesh, Scene


def slow_translate(of, to):
    return np.array([list(to).index(n) if n in to else GONE for n in of], np.uint32)


@pytest.mark.parametrize("seed", range(20))
def test_translates_as_a_search_does(seed):
    rng = np.random.default_rng(seed)
    of, to = (rng.permutation(12)[: rng.integers(0, 12)].astype(np.uint32) + 1 for _ in range(2))
    np.testing.assert_array_equal(translate(of, to), slow_translate(of, to))


def test_buffers_follow_the_list_and_settle(device):
    lights = LightTranslation(device)

    def read(count):
        return [lights.buffers[name].read(np.uint32, count).tolist() for name in NAMES]

    first = np.array([1, 2, 3], np.uint32)
    lights.update(first)
    assert read(3)[1] == [GONE] * 3  # all are new
    lights.update(first)
    assert read(3) == [[0, 1, 2], [0, 1, 2]]
    second = np.array([3, 4, 1], np.uint32)
    assert not lights.update(second)
    assert read(3) == [[2, GONE, 0], [2, GONE, 0]]
    many = np.arange(1, 200, dtype=np.uint32)
    assert lights.update(many), "larger buffers are other buffers"
    assert read(3)[0] == [2, 3, 0]
    lights.destroy()


def test_ids_stay_with_their_light(device):
    mesh = Mesh(positions=[[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    lamps = [Instance(mesh=mesh, material=Material(emissive=[n, 1, 1])) for n in (1, 2, 3)]
    sun = DirectionalLight(direction=[0, -1, 0])
    scene = Scene(*lamps, sun)
    binder = SceneBinder(device, scene)

    def ids():
        binder.update()
        found = {lamp: int(binder.light_ids[binder._lights.index(lamp)]) for lamp in lamps if lamp in scene.instances}
        return found | {sun: int(binder.light_ids[-1])}

    before = ids()
    scene.remove(lamps[0])
    after = ids()
    assert after == {light: before[light] for light in after}
    scene.add(lamps[0])
    assert ids()[lamps[0]] not in before.values(), "a light that was away is another one"
    known = ids()
    lamps[1].material.emissive = [9, 9, 9]
    lamps[1].transform = np.diag([2, 2, 2, 1])
    sun.illuminance = 5.0
    assert ids() == known
    lamps[1].mesh = Mesh(positions=[[0, 0, 0], [2, 0, 0], [0, 1, 0]])
    assert ids()[lamps[1]] not in known.values(), "its triangles are others now"
    known = ids()
    mesh.positions = [[0, 0, 0], [3, 0, 0], [0, 1, 0]]
    assert ids()[lamps[0]] != known[lamps[0]]
    assert ids()[sun] == known[sun]
    binder.destroy()
