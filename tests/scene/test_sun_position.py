"""The sun by place and time against published tables."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.lights.sun_position import _equatorial, sun_direction

GOLDEN = (39.742476, -105.1786)


def angles(direction):
    """Elevation, and azimuth from north over east, in degrees."""
    x, y, z = direction
    return math.degrees(math.asin(y)), math.degrees(math.atan2(x, -z)) % 360


def test_published_positions():
    # The example of the Solar Position Algorithm (NREL, 2003, table A5.1): zenith 50.11162, azimuth 194.34024 degrees.
    found = angles(sun_direction(GOLDEN, datetime.fromisoformat("2003-10-17 12:30:30-07:00")))
    np.testing.assert_allclose(found, (90 - 50.11162, 194.34024), atol=0.01)
    # Meeus, example 25.a: 1992 October 13, 0h: right ascension 198.38083, declination -7.78507 degrees.
    ascension, declination, _ = _equatorial(
        (datetime(1992, 10, 13, tzinfo=UTC) - datetime(2000, 1, 1, 12, tzinfo=UTC)).days + 0.5
    )
    np.testing.assert_allclose(np.degrees((ascension % math.tau, declination)), (198.38083, -7.78507), atol=0.01)
    # Meeus, example 12.a: 1987 April 10, 0h: apparent sidereal time 13h 10m 46.1351s.
    *_, sidereal = _equatorial(2446895.5 - 2451545.0)
    assert math.degrees(sidereal) % 360 == pytest.approx(15 * (13 + 10 / 60 + 46.1351 / 3600), abs=0.002)


def test_sunrise_and_the_southern_noon():
    # The center of a setting sun stands at -0.833 degrees without refraction, which lifts it by about 0.57 degrees.
    low = angles(sun_direction((0.0, 0.0), datetime(2026, 3, 20, 18, 10, 53, tzinfo=UTC)))[0]
    assert -0.9 < low < -0.1
    noon = angles(sun_direction((-33.9, 151.2), datetime(2026, 6, 21, 1, 57, tzinfo=UTC)))
    assert noon[0] == pytest.approx(90 - 33.9 - 23.43, abs=0.05)
    assert min(noon[1], 360 - noon[1]) < 0.5


def test_sky():
    sky = sv.Sky(place=(52.5, 13.4), time="2026-06-21 13:08+02:00")
    elevation, azimuth = angles(sky.sun_direction)
    assert elevation == pytest.approx(90 - 52.5 + 23.43, abs=0.05)
    assert azimuth == pytest.approx(180, abs=1)
    sky.time = datetime(2026, 6, 21, 18, tzinfo=UTC)
    assert angles(sky.sun_direction)[1] > 270
    np.testing.assert_allclose(sky.sun.direction, -sky.sun_direction)
    sky.sun_direction = (0, 1, 0)
    assert (sky.place, sky.time) == (None, None)
    for wrong, why in (
        ({"place": (52.5, 13.4)}, "place and time go together"),
        ({"place": (152.5, 13.4), "time": "2026-06-21 15:00Z"}, "latitude, longitude"),
        ({"place": (52.5, 13.4), "time": datetime(2026, 6, 21, 15)}, "has no zone"),
        ({"place": (52.5, 13.4), "time": "noon"}, "time must be as '2026-06-21 15:00"),
        ({"latitude": 52.5}, r"Sky\(place="),
        ({"place": (52.5, 13.4), "time": "2026-06-21 15:00Z", "sun_direction": (0, 1, 0)}, "or sun_direction"),
    ):
        with pytest.raises(sv.SolariError, match=why):
            sv.Sky(**wrong)
    with pytest.raises(sv.SolariError, match="or sun_direction"):
        sky.update(sun_direction=(1, 1, 0), place=(52.5, 13.4), time="2026-06-21 15:00Z")
    np.testing.assert_array_equal(sky.sun_direction, (0, 1, 0))
