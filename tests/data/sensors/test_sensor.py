"""Image sensors against the closed forms of EMVA 1288 and ISO 12232, and OpenCV's mosaic."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import SolariError

SIZE = (64, 96)  # rows, columns
QUIET = sv.Sensor(shot_noise=False, read_noise=0.0)


def even(level, shape=SIZE):
    return np.full((*shape, 3), float(level))


def test_the_photon_transfer_curve():
    """Means, and the variance K² read noise² + K (mean - black) + 1/12, at five levels of light."""
    sensor = sv.Sensor(read_noise=4.0, full_well=12_000, dark_current=300.0, exposure_time=0.02)
    gain, counts = sensor.dn_per_electron, []
    for share in (0.0, 0.05, 0.2, 0.5, 0.85):
        light = even(share * sensor.saturation_radiance, (256, 256))
        raw = sensor.expose(light, seed=3)[..., 1].astype(np.float64)
        electrons = 300.0 * 0.02 + share * (12_000 - 6)
        assert raw.mean() == pytest.approx(64 + gain * electrons, abs=4 * raw.std() / 256)
        counts.append((raw.mean(), raw.var(), gain**2 * 16 + gain**2 * electrons + 1 / 12))
    mean, variance, expected = np.array(counts).T
    np.testing.assert_allclose(variance, expected, rtol=0.03)
    slope = np.polyfit(mean[1:], variance[1:], 1)[0]
    assert slope == pytest.approx(gain, rel=0.03)


def test_light_becomes_electrons_by_the_units_named():
    """1,000 cd/m² at f/4 and 1/60 s are 0.65 * 1000 / 60 / 16 lx s, each of which is a number of photons of 555 nm."""
    energy = 6.62607015e-34 * 299792458 / 555e-9
    exposure = 0.65 * 1000 / 60 / 16
    expected = exposure * 3.45e-6**2 / 683.002 / energy * 0.6
    one = sv.Sensor(exposure_time=1 / 60).mean_electrons(even(1000))[0, 0]
    assert one[1] == pytest.approx(expected, rel=1e-4)
    three = sv.Sensor(exposure_time=1 / 60, quantum_efficiency=(0.3, 0.6, 0.5)).mean_electrons(even(1000))[0, 0]
    np.testing.assert_allclose(three / expected, (0.5, 1, 5 / 6), rtol=1e-4)


@pytest.mark.parametrize("fields", [{}, {"iso": 800}, {"gain": 0.7}, {"iso": 1600, "bit_depth": 8, "black_level": 4}])
def test_speed_and_saturation(fields):
    """A camera's exposure value makes 1.2 * 2^EV100 white, and no number is larger."""
    sensor = sv.Sensor(shot_noise=False, read_noise=0.0, **fields).for_ev100(5.0)
    white = 1.2 * 2**5
    assert sensor.saturation_radiance == pytest.approx(white, rel=1e-3)
    assert sensor.expose(even(0.5 * white)).max() < sensor.white_level
    half = 64 if "black_level" not in fields else 4
    middle = half + (sensor.white_level - half) / 2
    assert sensor.expose(even(0.5 * white)).mean() == pytest.approx(middle, abs=1)
    assert (sensor.expose(even(50 * white)) == sensor.white_level).all()
    assert (sensor.expose(even(0)) == half).all()
    by_camera = sv.Sensor(shot_noise=False, read_noise=0.0, **fields)
    light = even(0.3 * white)
    np.testing.assert_array_equal(by_camera.expose(light, sv.Camera(ev100=5.0)), sensor.expose(light))
    np.testing.assert_allclose(by_camera.develop(sensor.expose(light), sv.Camera(ev100=5.0)), light, rtol=0.05)


def test_more_gain_than_the_well_needs_and_less():
    """Above the base speed the numbers end first, below it the well does."""
    base = sv.Sensor(exposure_time=0.01)
    fast = sv.Sensor(exposure_time=0.01, iso=4 * base.base_iso)
    assert fast.saturation_radiance == pytest.approx(base.saturation_radiance / 4)
    slow = sv.Sensor(gain=base.dn_per_electron / 2, shot_noise=False, read_noise=0.0)
    full = slow.expose(even(1e6))
    assert full.max() == pytest.approx(64 + (4095 - 64) / 2, abs=1)


def test_numbers_are_numpys_by_the_seed():
    sensor = sv.Sensor(bayer="GRBG", iso=500)
    light = np.random.default_rng(1).uniform(0, 1.2 * sensor.saturation_radiance, (*SIZE, 3))
    rng = np.random.default_rng(7)
    mean = sensor.mean_electrons(light)
    electrons = np.minimum(rng.poisson(mean), sensor.full_well) + sensor.read_noise * rng.standard_normal(SIZE)
    expected = np.clip(np.floor(64 + sensor.dn_per_electron * electrons + 0.5), 0, 4095)
    np.testing.assert_array_equal(sensor.expose(light, seed=7), expected)
    assert (sensor.expose(light, seed=8) != expected).mean() > 0.5
    assert sensor.expose(light).dtype == np.uint16


def test_fixed_patterns_stay():
    sensor = sv.Sensor(prnu=0.02, dsnu=5.0, shot_noise=False, read_noise=0.0)
    light = even(0.5 * sensor.saturation_radiance, (256, 256))
    one, other = (sensor.expose(light, seed=seed).astype(float) for seed in (1, 2))
    np.testing.assert_array_equal(one, other)
    expected = sensor.dn_per_electron * math.hypot(0.02 * 5000, 5)
    assert one.std() == pytest.approx(expected, rel=0.02)
    moved = sv.Sensor(prnu=0.02, dsnu=5.0, shot_noise=False, read_noise=0.0, pattern_seed=1)
    assert (moved.expose(light) != one).mean() > 0.9


def test_nonuniformity_without_light():
    """The dark signal's pattern goes below the black level, and the response's isn't in the dark current."""
    sensor = sv.Sensor(
        dsnu=20.0,
        prnu=0.5,
        dark_current=1000.0,
        exposure_time=0.1,
        read_noise=0.5,
        shot_noise=False,
        black_level=200,
        bit_depth=14,
    )
    found = sensor.expose(even(0, (256, 256))).astype(float)
    expected = sensor.dn_per_electron * math.hypot(20, 0.5)
    assert found.std() == pytest.approx(expected, rel=0.02)
    assert found.mean() == pytest.approx(200 + sensor.dn_per_electron * 100, abs=4 * expected / math.sqrt(3 * 256**2))
    dark = sv.Sensor(dsnu=20.0, read_noise=0.5, black_level=200).expose(even(0, (256, 256))).astype(float)
    assert dark.mean() == pytest.approx(200, abs=0.1)
    assert dark.std() == pytest.approx(sv.Sensor(black_level=200).dn_per_electron * math.hypot(20, 0.5), rel=0.02)


def test_the_line_of_emva_1288():
    sensor = sv.Sensor(gain=0.4, read_noise=3.0, dark_current=500.0, exposure_time=0.02, full_well=8000)
    threshold = math.sqrt(9 + 10 + 1 / 12 / 0.4**2) + 0.5
    assert sensor.describe() == (
        f"0.4 DN/e-, saturation 7990 e-, absolute threshold {threshold:.4g} e-, "
        f"dynamic range {20 * math.log10(7990 / threshold):.1f} dB, SNR {10 * math.log10(7990):.1f} dB"
    )
    assert "dynamic range -inf dB" in sv.Sensor(dark_current=1e9, exposure_time=1).describe()


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaics(pattern):
    """Each pixel has its filter's color, and the picture developed is OpenCV's bilinear one."""
    cv2 = pytest.importorskip("cv2")
    sensor = sv.Sensor(bayer=pattern, shot_noise=False, read_noise=0.0, black_level=0)
    light = np.random.default_rng(2).uniform(0.1, 0.9, (32, 48, 3)) * sensor.saturation_radiance
    raw, whole = sensor.expose(light), sv.Sensor(shot_noise=False, read_noise=0.0, black_level=0).expose(light)
    for row in range(2):
        for column in range(2):
            color = "RGB".index(pattern[2 * row + column])
            np.testing.assert_array_equal(raw[row::2, column::2], whole[row::2, column::2, color])
    code = getattr(cv2, f"COLOR_Bayer{pattern}2RGB")
    found = sensor.develop(raw) * sensor.electrons_per_radiance * sensor.dn_per_electron
    expected = cv2.cvtColor(raw, code)[2:-2, 2:-2]
    np.testing.assert_allclose(found[2:-2, 2:-2], expected, atol=1)


def test_develop_inverts_the_mean():
    sensor = sv.Sensor(shot_noise=False, read_noise=0.0, bit_depth=16, dark_current=1000, iso=600, exposure_time=0.02)
    light = np.random.default_rng(2).uniform(0, sensor.saturation_radiance, (16, 16, 3))
    np.testing.assert_allclose(sensor.develop(sensor.expose(light)), light, atol=1e-3 * sensor.saturation_radiance)


def test_vignetting():
    camera = sv.Camera(vertical_fov=1.2, principal_point=(0.4, 0.6))
    level = 0.8 * QUIET.saturation_radiance
    found = sv.Sensor(vignetting="cos4").mean_electrons(even(level), camera)[..., 1]
    x, y = np.meshgrid((np.arange(96) + 0.5) - 0.4 * 96, (np.arange(64) + 0.5) - 0.6 * 64)
    focal = 32 / math.tan(0.6)
    expected = (focal**2 / (x**2 + y**2 + focal**2)) ** 2
    np.testing.assert_allclose(found / found.max(), expected / expected.max(), rtol=1e-6)
    curve = sv.Sensor(vignetting=(-0.3, 0.05)).mean_electrons(even(level))[..., 1]
    corner = math.hypot(31.5, 47.5) / math.hypot(32, 48)
    share = 1 - 0.3 * corner**2 + 0.05 * corner**4
    assert curve[0, 0] / QUIET.mean_electrons(even(level))[0, 0, 1] == pytest.approx(share, rel=1e-9)
    with pytest.raises(SolariError, match="needs a perspective camera"):
        sv.Sensor(vignetting="cos4").expose(even(1))
    with pytest.raises(SolariError, match="is negative in a picture of 96x64"):
        sv.Sensor(vignetting=(-2.0,)).expose(even(1))


def test_chromatic_aberration_moves_edges():
    """An edge 40 pixels from the middle is 0.4 pixels further out in red, and nearer in blue."""
    light = even(0, (65, 129))
    light[:, 104:] = 100.0
    found = sv.Sensor(chromatic_aberration=(0.01, -0.01)).mean_electrons(light)
    edge = 129 - found.sum(axis=1)[32] / found[32, -1]
    np.testing.assert_allclose(edge - edge[1], (0.4, 0, -0.4), atol=0.02)


def test_files_of_sensors(tmp_path):
    path = tmp_path / "sensor.json"
    path.write_text(json.dumps({"iso": 400, "bayer": "RGGB", "quantum_efficiency": [0.4, 0.6, 0.5]}))
    assert sv.Sensor.load(path) == sv.Sensor(iso=400, bayer="RGGB", quantum_efficiency=(0.4, 0.6, 0.5))
    assert sv.Sensor.load('{"gain": 0.5}') == sv.Sensor(gain=0.5)
    path.write_text('{"isso": 400}')
    with pytest.raises(SolariError, match=r"sensor.json: a sensor has no 'isso'; did you mean 'iso'"):
        sv.Sensor.load(path)
    path.write_text('{"iso": "fast"}')
    with pytest.raises(SolariError, match=r"sensor.json: iso is a number between"):
        sv.Sensor.load(path)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"iso": 100, "gain": 1}, "iso and gain say the same"),
        ({"iso": 100}, r"iso, 100, is below base_iso, 227.*give base_iso or more, a full_well of 227"),
        ({"bit_depth": 8.5}, "bit_depth must be a whole number from 1 to 16, not 8.5"),
        ({"pattern_seed": -1}, "pattern_seed must be a whole number from 0 on, not -1"),
        ({"bayer": "RGBG"}, "there is no Bayer pattern 'RGBG'"),
        ({"black_level": 5000}, "black_level, 5000 DN, must be below the largest number of 12 bits"),
        ({"quantum_efficiency": 1.2}, "lies between 0 and 1"),
        ({"full_well": math.nan}, "full_well is a number between"),
        ({"vignetting": "cos3"}, 'vignetting is "none", "cos4" or coefficients'),
        ({"chromatic_aberration": 0.5}, "lies within 0.1"),
    ],
)
def test_what_is_no_sensor(fields, message):
    with pytest.raises(SolariError, match=message):
        sv.Sensor(**fields)


def test_what_is_no_picture():
    with pytest.raises(SolariError, match=r"radiance has the shape \(height, width, 3\)"):
        QUIET.expose(np.zeros((4, 4)))
    with pytest.raises(SolariError, match=r"expose: seed must be a whole number from 0 on, not 1.5"):
        QUIET.expose(even(1), seed=1.5)
    with pytest.raises(SolariError, match="must be finite"):
        QUIET.expose(even(np.inf))
    with pytest.raises(SolariError, match=r"raw numbers have the shape \(height, width, 3\)"):
        QUIET.develop(np.zeros((4, 4)))
