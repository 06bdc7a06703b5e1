"""Lights in lumens and kelvin, and the default sky."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.lights.light import _RGB_OF_XYZ


def test_lumens():
    bulb = sv.PointLight((0, 1, 0), lumens=800)
    assert bulb.intensity == pytest.approx(800 / (4 * math.pi))
    bulb.intensity = 1
    assert bulb.lumens == pytest.approx(4 * math.pi)
    spot = sv.SpotLight((0, 1, 0), (0, -1, 0), lumens=100, inner_cone_angle=0.5, outer_cone_angle=0.5001)
    assert spot.intensity == pytest.approx(100 / (2 * math.pi * (1 - math.cos(0.5))), rel=1e-2)
    spot.update(lumens=50, outer_cone_angle=1.0)
    scale, offset = spot.falloff
    cosines = (np.arange(100_000) + 0.5) / 100_000
    share = np.clip(scale * cosines + offset, 0, 1) ** 2
    assert spot.intensity * 2 * math.pi * share.mean() == pytest.approx(50, rel=1e-4)


@pytest.mark.parametrize(
    ("temperature", "x", "y"),
    [(2000, 0.5267, 0.4133), (2856, 0.4476, 0.4074), (5000, 0.3451, 0.3516), (10_000, 0.2807, 0.2884)],
)
def test_kelvin(temperature, x, y):
    """Chromaticities of black bodies: Wyszecki and Stiles, "Color Science" (1982); 2856 K is CIE's illuminant A."""
    color = sv.kelvin(temperature)
    xyz = np.linalg.solve(_RGB_OF_XYZ, color)
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), (x, y), atol=1e-3)
    assert color @ (0.2126, 0.7152, 0.0722) == pytest.approx(1)
    for light in (sv.PointLight((0, 1, 0), kelvin=temperature), sv.DirectionalLight((0, -1, 0), kelvin=temperature)):
        np.testing.assert_array_equal(light.color, color)
        light.kelvin = 4000
        np.testing.assert_array_equal(light.color, sv.kelvin(4000))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"lumens": 1, "intensity": 1}, "SpotLight: lumens makes intensity: give one"),
        ({"lumens": -1}, "between 0 and .* lm"),
        ({"kelvin": 1, "color": 1}, "kelvin makes color"),
        ({"kelvin": 100}, "from 1667 to 25000 K, not 100"),
        ({"lumens": 1, "outer_cone_angle": "wide"}, "outer_cone_angle"),
    ],
)
def test_refused_units(fields, message):
    with pytest.raises(sv.SolariError, match=message):
        sv.SpotLight((0, 1, 0), (0, -1, 0), **fields)


def test_a_sky_has_a_sun_by_default():
    assert np.degrees(np.arcsin(sv.Sky().sun_direction[1])) == pytest.approx(40, abs=0.1)


def test_unknown_attributes_name_fields_without_a_default():
    with pytest.raises(AttributeError, match="did you mean 'position'"):
        _ = sv.PointLight((0, 1, 0), intensity=1).postion
