"""The list of lights that changed in recent frames."""

import numpy as np
import pytest

from solari_vk.scene.changed_lights import MOST, ChangedLights
from solari_vk.scene.light_translation import CHANGE_DECAY, MIN_CHANGE

CELL = 0.5  # meters
IDS = np.array([4, 7, 9], np.uint32)
POWERS = np.array([10.0, 20.0, 30.0])
PLACES = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])


def start(ids=IDS, powers=POWERS, places=PLACES):
    lights = ChangedLights()
    lights.update(ids, powers, places, CELL)
    assert lights.uniforms["changed_lights.count"] == 0, "the first lights are no change"
    return lights


def read(lights):
    """The records that count, as (place, power, recent)."""
    uniforms = lights.uniforms
    assert uniforms["changed_lights.at"].shape == (MOST,)
    records = uniforms["changed_lights.at"][: uniforms["changed_lights.count"]]
    return [(record["place"].tolist(), float(record["power"]), float(record["recent"])) for record in records]


def test_what_stays_is_not_listed():
    lights = start()
    lights.update(IDS, POWERS.copy(), PLACES.copy(), CELL)
    lights.update(IDS[[2, 0, 1]], POWERS[[2, 0, 1]], PLACES[[2, 0, 1]], CELL)
    lights.update(IDS[[2, 0, 1]], POWERS[[2, 0, 1]] * (1 + 0.5 * MIN_CHANGE), PLACES[[2, 0, 1]], CELL)
    assert read(lights) == []


def test_powers_count_by_their_difference():
    for powers in ([10.0, 5.0, 30.0], [10.0, 35.0, 30.0]):
        lights = start()
        lights.update(IDS, np.array(powers), PLACES, CELL)
        assert read(lights) == [([3.0, 4.0, 5.0], 15.0, 1.0)]


def test_added_and_removed_lights_count_where_they_are_or_were():
    lights = start()
    lights.update(np.array([9, 11], np.uint32), np.array([30.0, 5.0]), np.array([PLACES[2], [1.0, 1.0, 1.0]]), CELL)
    assert read(lights) == [([3.0, 4.0, 5.0], 20.0, 1.0), ([0.0, 1.0, 2.0], 10.0, 1.0), ([1.0, 1.0, 1.0], 5.0, 1.0)]


@pytest.mark.parametrize(("distance", "power"), [(0.125, 5.0), (0.5, 20.0), (40.0, 20.0)])
def test_moves_count_by_their_distance(distance, power):
    lights, places = start(), PLACES.copy()
    places[1, 0] += distance
    lights.update(IDS, POWERS, places, CELL)
    assert read(lights) == [(places[1].tolist(), power, 1.0)]


def test_lights_at_infinity_have_no_place():
    """Lights behind those with places may change: the share of all light counts for them."""
    lights = start(places=PLACES[:2])
    lights.update(IDS[:2], POWERS[:2], PLACES[:2], CELL)
    lights.update(IDS, np.array([10.0, 20.0, 90.0]), PLACES[:2], CELL)
    assert read(lights) == []


def test_changes_fade():
    lights = start()
    lights.update(IDS, 0.5 * POWERS, PLACES, CELL)
    frames, found = 0, read(lights)
    while found:
        for (place, power, recent), at, before in zip(found, PLACES[::-1], POWERS[::-1], strict=True):
            assert (place, power) == (at.tolist(), 0.5 * before)
            assert recent == pytest.approx(CHANGE_DECAY**frames, rel=1e-5)
        lights.update(lights._seen[0], lights._seen[1], PLACES, CELL)
        frames, found = frames + 1, read(lights)
    assert CHANGE_DECAY**frames <= MIN_CHANGE < CHANGE_DECAY ** (frames - 1)
    lights.update(IDS, POWERS, PLACES, CELL)
    lights.clear()
    assert read(lights) == []


def test_a_light_is_listed_once_by_its_largest_change():
    lights = start()
    lights.update(IDS, np.array([10.0, 20.0, 10.0]), PLACES, CELL)
    lights.update(IDS, np.array([10.0, 20.0, 9.0]), PLACES, CELL)
    assert read(lights) == [([6.0, 7.0, 8.0], 20.0, pytest.approx(CHANGE_DECAY))]
    lights.update(IDS, np.array([10.0, 20.0, 80.0]), PLACES, CELL)
    assert read(lights) == [([6.0, 7.0, 8.0], 71.0, pytest.approx(CHANGE_DECAY))], "it was changing already"


def test_the_largest_changes_are_listed():
    count = 3 * MOST
    ids, powers = np.arange(count, dtype=np.uint32), np.random.default_rng(2).permutation(count) + 1.0
    lights = start(ids, powers, np.zeros((count, 3)))
    lights.update(ids, 2.0 * powers, lights._seen[2], CELL)
    assert [power for _, power, _ in read(lights)] == list(range(count, count - MOST, -1))
