"""The list of lights that changed in recent frames."""

import numpy as np
import pytest

from solari_vk.bound.lights.index_translation import CHANGE_DECAY, MIN_CHANGE
from solari_vk.bound.lights.recent_changes import MAX_CHANGED_LIGHTS, MIN_LISTED_CHANGE, STILL_CHANGING, RecentChanges

CELL = 0.5  # meters
IDS = np.array([4, 7, 9], np.uint32)
POWERS = np.array([10.0, 20.0, 30.0])
PLACES = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])


def update(lights, ids=IDS, powers=POWERS, places=PLACES, positions=None):
    lights.update(ids, np.array(powers, float), places, places if positions is None else positions, CELL)


def start(*lists):
    lights = RecentChanges()
    update(lights, *lists)
    assert lights.uniforms["changed_lights.count"] == 0, "the first lights are no change"
    return lights


def read(lights):
    """The records that count, as (place, power, recent)."""
    uniforms = lights.uniforms
    assert uniforms["changed_lights.at"].shape == (MAX_CHANGED_LIGHTS,)
    records = uniforms["changed_lights.at"][: uniforms["changed_lights.count"]]
    return [(record["place"].tolist(), float(record["power"]), float(record["recent"])) for record in records]


def test_what_stays_flickers_or_moves_slowly_is_not_listed():
    """Flicker of twice MIN_LISTED_CHANGE in all, but never of more than it from what a lamp had when it was listed."""
    lights = start()
    order = [2, 0, 1]
    drift = 0.9 * CELL * np.eye(1, 3)
    update(lights, IDS[order], POWERS[order], PLACES[order])
    for frame in range(20):
        update(lights, powers=POWERS * (1 + (-1) ** frame * 0.9 * MIN_LISTED_CHANGE), places=PLACES + frame * drift)
        assert read(lights) == []


def test_slow_changes_add_up():
    lights, frames = start(), 0
    while not read(lights):
        frames += 1
        update(lights, powers=POWERS * 0.97**frames)
    assert 0.97**frames < 1 - MIN_LISTED_CHANGE < 0.97 ** (frames - 1)
    update(lights, powers=POWERS * 0.97**frames)
    assert [recent for _, _, recent in read(lights)] == [pytest.approx(CHANGE_DECAY)] * 3


def test_powers_count_by_their_difference():
    for powers in ([10.0, 5.0, 30.0], [10.0, 35.0, 30.0]):
        lights = start()
        update(lights, powers=powers)
        assert read(lights) == [([3.0, 4.0, 5.0], 15.0, 1.0)]


def test_added_and_removed_lights_count_where_they_are_or_were():
    lights = start()
    update(lights, np.array([9, 11], np.uint32), [30.0, 5.0], np.array([PLACES[2], [1.0, 1.0, 1.0]]))
    assert read(lights) == [([3.0, 4.0, 5.0], 20.0, 1.0), ([0.0, 1.0, 2.0], 10.0, 1.0), ([1.0, 1.0, 1.0], 5.0, 1.0)]


def test_jumps_count_where_the_light_was_and_where_it_is():
    """A lamp that turns moves its position only: see SHADOW_DISTANCE."""
    moved = PLACES + np.array([[0.0], [40.0], [0.0]]) * [1, 0, 0]
    for places, positions in ((moved, None), (PLACES, moved)):
        lights = start()
        update(lights, places=places, positions=positions)
        assert read(lights) == [(places[1].tolist(), 20.0, 1.0), (PLACES[1].tolist(), 20.0, 1.0)]


def test_lights_at_infinity_have_no_place():
    """Lights behind those with places may change: the share of all light counts for them."""
    lights = start(IDS, POWERS, PLACES[:2], PLACES)
    update(lights, IDS[:2], POWERS[:2], PLACES[:2], PLACES)
    update(lights, IDS, [10.0, 20.0, 90.0], PLACES[:2], PLACES)
    assert read(lights) == []


def test_changes_fade():
    lights = start()
    update(lights, powers=0.5 * POWERS)
    frames, found = 0, read(lights)
    while found:
        for (place, power, recent), at, before in zip(found, PLACES[::-1], POWERS[::-1], strict=True):
            assert (place, power) == (at.tolist(), 0.5 * before)
            assert recent == pytest.approx(CHANGE_DECAY**frames, rel=1e-5)
        update(lights, powers=0.5 * POWERS)
        frames, found = frames + 1, read(lights)
    assert CHANGE_DECAY**frames <= MIN_CHANGE < CHANGE_DECAY ** (frames - 1)
    update(lights, powers=POWERS)
    lights.clear()
    assert read(lights) == []


def test_a_light_is_listed_once_by_its_largest_change():
    lights = start()
    update(lights, powers=[10.0, 20.0, 10.0])
    update(lights, powers=[10.0, 20.0, 8.0])
    assert read(lights) == [([6.0, 7.0, 8.0], 20.0, pytest.approx(CHANGE_DECAY))]
    update(lights, powers=[10.0, 20.0, 80.0])
    assert read(lights) == [([6.0, 7.0, 8.0], 72.0, pytest.approx(CHANGE_DECAY))], "it was changing already"


def test_a_light_that_changes_again_later_is_a_new_change():
    lights, frames = start(), 0
    update(lights, powers=[10.0, 20.0, 10.0])
    while CHANGE_DECAY**frames > STILL_CHANGING * CHANGE_DECAY:
        update(lights, powers=[10.0, 20.0, 10.0])
        frames += 1
    update(lights, powers=POWERS)
    assert read(lights) == [([6.0, 7.0, 8.0], 20.0, 1.0)]


def test_the_largest_changes_are_listed():
    count = 3 * MAX_CHANGED_LIGHTS
    ids, powers = np.arange(count, dtype=np.uint32), np.random.default_rng(2).permutation(count) + 1.0
    lights = start(ids, powers, np.zeros((count, 3)))
    update(lights, ids, 2.0 * powers, np.zeros((count, 3)))
    assert [power for _, power, _ in read(lights)] == list(range(count, count - MAX_CHANGED_LIGHTS, -1))
