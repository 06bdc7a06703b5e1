"""Where the sun stands at a place and time.

Source: Meeus, "Astronomical Algorithms", 2nd edition (1998), chapters 12, 16, 22 and 25, with the low accuracy of 0.01
degrees, as the solar calculator of the NOAA has it. Refraction is that of Reda and Andreas, "Solar Position Algorithm
for Solar Radiation Applications" (NREL, 2003), at 1010 mbar and 10 degrees Celsius.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import quoted
from solari_vk.scene import checks

J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
LOWEST_REFRACTED = -0.8333  # degrees: below it the whole sun has set, and tables have no refraction
EXAMPLE = "'2026-06-21 15:00+02:00', or datetime(2026, 6, 21, 15, tzinfo=ZoneInfo('Europe/Berlin'))"


def checked_place(value: Any) -> tuple[float, float] | None:
    """Latitude and longitude in degrees, north and east positive, or None."""
    if value is None:
        return None
    latitude, longitude = (float(number) for number in checks.array(2, dtype=np.float64)(value))
    if not (-90 <= latitude <= 90 and -180 <= longitude <= 360):
        raise ValueError(f"is (latitude, longitude) in degrees, such as (52.5, 13.4) for Berlin, not {quoted(value)}")
    return latitude, longitude


def checked_time(value: Any) -> datetime | None:
    """A time with its zone, of such a time or a text, or None."""
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value)
        except ValueError:
            raise ValueError(f"must be as {EXAMPLE}, not {quoted(value)}") from None
    if value is not None and not isinstance(value, datetime):
        raise ValueError(f"must be as {EXAMPLE}, not {quoted(value)}")
    # A time without a zone could mean that of the place, of the computer, or UTC, which are hours apart.
    if value is not None and value.utcoffset() is None:
        raise ValueError(f"has no zone, and so no place in the day: give it, as in {EXAMPLE}")
    return value


def sun_direction(place: tuple[float, float], time: datetime) -> NDArray[np.float64]:
    """The direction (3,) towards the sun, where +x is east, +y up and -z north. place: (latitude, longitude)."""
    ascension, declination, sidereal = _equatorial((time - J2000).total_seconds() / 86400)
    latitude, longitude = map(math.radians, place)
    hour_angle = sidereal + longitude - ascension
    east = -math.cos(declination) * math.sin(hour_angle)
    # Meeus 13.5 and 13.6, as components in place of angles.
    along = math.cos(declination) * math.cos(hour_angle)
    north = math.cos(latitude) * math.sin(declination) - math.sin(latitude) * along
    up = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * along
    elevation = math.degrees(math.asin(max(-1.0, min(up, 1.0))))
    if elevation >= LOWEST_REFRACTED:
        # Reda and Andreas, equation 42; Meeus 16.4.
        elevation += 1.02 / (60 * math.tan(math.radians(elevation + 10.3 / (elevation + 5.11))))
    heading = math.atan2(east, north)
    level = math.cos(math.radians(elevation))
    return np.array((math.sin(heading) * level, math.sin(math.radians(elevation)), -math.cos(heading) * level))


def _equatorial(days: float) -> tuple[float, float, float]:
    """The sun's apparent right ascension and declination, and the apparent sidereal time of Greenwich, in radians.
    days: since J2000, in universal time: that of the dynamical one differs by less than 0.001 degrees of the sun."""
    t = days / 36525
    # Meeus, chapter 25: mean longitude, mean anomaly, equation of the center, longitude of the Moon's node.
    mean_longitude = 280.46646 + t * (36000.76983 + t * 0.0003032)
    anomaly = math.radians(357.52911 + t * (35999.05029 - t * 0.0001537))
    center = (1.914602 - t * (0.004817 + t * 0.000014)) * math.sin(anomaly)
    center += (0.019993 - t * 0.000101) * math.sin(2 * anomaly) + 0.000289 * math.sin(3 * anomaly)
    node = math.radians(125.04 - 1934.136 * t)
    nutation = -0.00478 * math.sin(node)
    longitude = math.radians(mean_longitude + center - 0.00569 + nutation)
    # Meeus 22.2, with the correction of chapter 25.
    obliquity = math.radians(23.4392911 - t * (0.0130042 + t * (1.6e-7 - t * 5.04e-7)) + 0.00256 * math.cos(node))
    ascension = math.atan2(math.cos(obliquity) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(obliquity) * math.sin(longitude))
    # Meeus 12.4, and nutation for the apparent sidereal time.
    sidereal = 280.46061837 + 360.98564736629 * days + t * t * (0.000387933 - t / 38710000)
    return ascension, declination, math.radians(sidereal % 360 + nutation * math.cos(obliquity))
