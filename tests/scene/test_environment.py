"""Environments without a device: what a map holds, files of pictures, errors, and the sky."""

from __future__ import annotations

import re

import numpy as np
import OpenEXR
import pytest
from oracles.encodings import decode_rgb9e5, rgb9e5_step
from oracles.light import environment_irradiance, environment_radiance
from PIL import Image
from support.files import hdr_file, rgbe_codes

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.lights.environment_buffers import encode_texels
from solari_vk.output.tone_mapping import auto_exposure
from solari_vk.scene.lights import atmosphere as air
from solari_vk.scene.lights.environment import directions, solid_angles
from solari_vk.scene.lights.sky import SUN_ILLUMINANCE


@pytest.fixture
def colors():
    """Colors (16, 32, 3) from 1e-6 to 1e6, with runs of the same ones and black ones."""
    generator = np.random.default_rng(1)
    found = np.exp(generator.uniform(-13, 13, (16, 32, 1)) + generator.uniform(-1, 0, (16, 32, 3)))
    found[3:6, 4:20] = found[0, 0]
    found[8, 3:5] = 0
    return found


@pytest.mark.parametrize("runs", [True, False])
def test_radiance_pictures(tmp_path, colors, runs):
    file = tmp_path / "map.hdr"
    file.write_bytes(hdr_file(rgbe_codes(colors), runs))
    found = sv.Environment(file).image
    assert (np.abs(found - colors).max(axis=-1) <= colors.max(axis=-1) / 128).all()
    file.write_bytes(hdr_file(rgbe_codes(colors), runs, b"#?RGBE\nEXPOSURE=2.0\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=4\n"))
    np.testing.assert_allclose(sv.Environment(str(file)).image, found / 8)
    header, runs_of_rows = hdr_file(rgbe_codes(colors), runs, b"#?RGBE\nEXPOSURE=2\n").split(b"+X 32\n")
    file.write_bytes(header.replace(b"\n", b"\r\n") + b"+X 32\r\n" + runs_of_rows)
    np.testing.assert_allclose(sv.Environment(file).image, found / 2)


def test_exr_pictures_with_damaged_pixels_are_refused(tmp_path, colors, capsys):
    """The only chunk says that it has other lines."""
    path = tmp_path / "map.exr"
    sv.save_image(path, colors[:16])
    data = bytearray(path.read_bytes())
    [start] = [at + 8 for at in range(len(data) - 8) if int.from_bytes(data[at : at + 8], "little") == at + 8]
    data[start : start + 4] = (5).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(SolariError, match=r"map\.exr is a damaged EXR picture"):
        sv.Environment(path)
    assert capsys.readouterr().out == ""


def test_exr_and_png_pictures(tmp_path, colors):
    sv.save_image(tmp_path / "map.exr", colors)
    np.testing.assert_allclose(sv.Environment(tmp_path / "map.exr").image, colors, rtol=1e-6)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    gray = colors[..., 0].clip(0, 1e4).astype(np.float16).astype(np.float32)
    OpenEXR.File(header, {"Y": gray}).write(str(tmp_path / "gray.exr"))
    np.testing.assert_allclose(sv.Environment(tmp_path / "gray.exr").image, np.stack([gray] * 3, axis=-1))
    Image.fromarray(np.full((2, 4, 3), 188, np.uint8)).save(tmp_path / "map.png")
    np.testing.assert_allclose(sv.Environment(tmp_path / "map.png").image, 0.5028865, rtol=1e-5)


def test_broken_files_are_refused(tmp_path, colors):
    good = hdr_file(rgbe_codes(colors))
    body = good.index(b"+X 32\n") + 6
    for data, text in (
        (good[:-7], "cut off"),
        (good[: body + 9], "cut off"),
        (good[:body], "cut off"),
        (b"", "header is missing"),
        (good.replace(b"-Y", b"+Y"), "orientation"),
        (good.replace(b"-Y 16", b"-Y 99999"), "pixels; from 1"),
        (good.replace(b"-Y 16", b"-Y 0"), "pixels; from 1"),
        (good.replace(b"rgbe", b"xyze"), "XYZ"),
        (good[:body] + bytes((2, 2, 0, 32)) + bytes(400), "cut off"),
        (hdr_file(rgbe_codes(colors), False)[:-1], "cut off"),
        (good[:body] + bytes((1, 1, 1, 9)) * 512, "old kind"),
        (good.replace(b"\nFORMAT", b"\nEXPOSURE=1e999\nFORMAT"), "the EXPOSURE inf"),
    ):
        (tmp_path / "map.hdr").write_bytes(data)
        with pytest.raises(SolariError, match=text):
            sv.Environment(tmp_path / "map.hdr")
    (tmp_path / "map.exr").write_bytes(b"\x76\x2f\x31\x01nothing")
    (tmp_path / "map.png").write_bytes(b"\x89PNGnothing")
    (tmp_path / "map.tif").write_bytes(b"")
    for name, text in (
        ("map.exr", "damaged EXR"),
        ("map.png", "PNG"),
        ("map.tif", "not '.tif'"),
        ("none.hdr", "no such file"),
        ("none.exr", "no such file"),
    ):
        with pytest.raises(SolariError, match=re.escape(text)):
            sv.Environment(tmp_path / name)


def test_exr_pictures_with_channel_names_that_are_no_text_are_refused(tmp_path, colors):
    """Asked for all channels, OpenEXR's InputFile would crash Python."""
    path = tmp_path / "map.exr"
    sv.save_image(path, colors[:16])
    data = path.read_bytes()
    place = data.index(b"chlist\0") + len("chlist\0") + 4
    path.write_bytes(data[:place] + b"\xcd" + data[place + 1 :])
    with pytest.raises(SolariError, match=r"map\.exr is a damaged EXR picture"):
        sv.Environment(path)


COMPRESSIONS = [name for name in dir(OpenEXR) if name.endswith("_COMPRESSION") and name != "NUM_COMPRESSION"]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("kind", [OpenEXR.scanlineimage, OpenEXR.tiledimage])
def test_exr_pictures_that_are_cut_off_are_refused(tmp_path, kind, compression):
    """OpenEXR reads them, and prints a warning. A black picture has small chunks, which many cuts leave away."""
    header = {"compression": getattr(OpenEXR, compression), "type": kind, "tiles": OpenEXR.TileDescription()}
    if kind == OpenEXR.scanlineimage:
        del header["tiles"]
    OpenEXR.File(header, {"RGB": np.zeros((100, 200, 3), np.float32)}).write(str(tmp_path / "map.exr"))
    whole = (tmp_path / "map.exr").read_bytes()
    assert not sv.Environment(tmp_path / "map.exr").image.any()
    for length in range(1, len(whole), len(whole) // 20):
        (tmp_path / "map.exr").write_bytes(whole[:length])
        with pytest.raises(SolariError, match=r"map\.exr is a damaged EXR picture"):
            sv.Environment(tmp_path / "map.exr")


def test_files_with_wrong_values_are_refused_and_other_shapes_reported(tmp_path, colors):
    for value, text in ((np.nan, "NaN"), (np.inf, "infinite"), (-1e6, "negative"), (1e30, r"map\.exr holds light")):
        wrong = colors.astype(np.float32)
        wrong[2, 3, 1] = value
        sv.save_image(tmp_path / "map.exr", wrong)
        with pytest.raises(SolariError, match=text):
            sv.Environment(tmp_path / "map.exr")
    sv.save_image(tmp_path / "map.exr", colors[:, :16])
    with pytest.warns(UserWarning, match="twice as wide as high") as told:
        sv.Environment(tmp_path / "map.exr")
    assert told[0].filename == __file__
    wrong = colors.astype(np.float32)
    wrong[8, 3] = -1e-3 * colors.sum()
    sv.save_image(tmp_path / "map.exr", wrong)
    with pytest.warns(UserWarning, match="a little negative light"):
        np.testing.assert_array_equal(sv.Environment(tmp_path / "map.exr").image, colors.astype(np.float32))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"image": np.zeros((2, 2, 2))}, "shape"),
        ({"image": np.zeros((0, 2, 3))}, "at least one pixel"),
        ({"image": -1.0}, "negative"),
        ({"image": 1e30}, "1e+18"),
        ({"image": 1.0, "rotation": 2 * np.eye(3)}, "neither scales nor mirrors"),
        ({"image": 1.0, "rotation": np.diag((1, 1, -1))}, "neither scales nor mirrors"),
    ],
)
def test_wrong_fields_are_refused(fields, text):
    with pytest.raises(SolariError, match=re.escape(text)):
        sv.Environment(**fields)


def test_scenes_take_environments_only():
    scene = sv.Scene()
    with pytest.raises(SolariError, match="must be an Environment, Sky, path or None, not float"):
        scene.environment = 1.0
    scene.environment = sv.Environment(0.0)
    assert not scene.environment.emits
    scene.environment = sky = sv.Sky((1, 1, 0))
    assert list(scene.lights) == [sky, sky.sun]
    scene.remove(sky)
    assert len(scene.lights) == 0
    scene.environment = sky
    scene.lights.remove(sky)
    scene.environment = sky
    assert set(scene.lights) == {sky, sky.sun}
    scene.environment = sv.Environment(1.0)
    assert len(scene.lights) == 1


def test_large_pictures_are_averaged_down(monkeypatch):
    image = np.random.default_rng(2).random((7, 15, 3)).astype(np.float32)
    monkeypatch.setattr("solari_vk.scene.lights.environment.MOST_TEXELS", 40)
    small = sv.Environment(image).image
    assert small.shape == (4, 8, 3)
    np.testing.assert_allclose(small[:3, :7], image[:6, :14].reshape(3, 2, 7, 2, 3).mean(axis=(1, 3)), rtol=1e-6)
    np.testing.assert_allclose(small[3, 7], image[6, 14])


def test_texels_are_stored_to_half_a_step(colors):
    codes, scale = encode_texels(colors.astype(np.float32))
    found = decode_rgb9e5(codes).reshape(colors.shape) * scale
    steps = rgb9e5_step(codes).reshape((*colors.shape[:2], 1)) * scale
    assert (np.abs(found - colors) <= 0.5000001 * steps + 1e-6 * colors).all()
    fine = np.maximum(colors.max(axis=-1) / 255, scale * 2.0**-24)
    assert (steps[..., 0] <= fine)[colors.any(axis=-1)].all()
    assert scale * 2.0**14 <= colors.max() < scale * 2.0**15


def test_solid_angles_and_flux():
    assert solid_angles(7, 13).sum() * 13 == pytest.approx(4 * np.pi)
    assert sv.Environment((1.0, 1.0, 1.0), intensity=3).flux == pytest.approx(12 * np.pi)
    image = np.zeros((64, 128, 3), np.float32)
    image[10, 90] = 1
    expected = directions(64, 128)[10, 90]
    np.testing.assert_allclose(sv.Environment(image).brightest, expected, atol=1e-6)
    turned = sv.Environment(image, rotation=np.pi / 2).brightest
    np.testing.assert_allclose(turned, (expected[2], expected[1], -expected[0]), atol=1e-6)
    with pytest.warns(UserWarning, match="rotation is in radians"):
        sv.Environment(image, rotation=90)


# ---- the sky ----------------------------------------------------------------------------------------


def test_sunlight_through_the_zenith_has_its_closed_form():
    """Air and haze of exponential density, and a triangle of ozone."""
    hazy = air.atmosphere(3.0, (0.3, 0.3, 0.3))
    dust = air.RAYLEIGH * air.RAYLEIGH_HEIGHT + hazy.haze * air.HAZE_HEIGHT
    found = hazy.transmittance(np.array([air.EYE]), np.array([1.0]))[0]
    np.testing.assert_allclose(found, np.exp(-dust - air.OZONE * air.OZONE_HALF_WIDTH), rtol=5e-3)
    assert dust[1] == pytest.approx(3.0 * air.RAYLEIGH[1] * air.RAYLEIGH_HEIGHT), "turbidity"


@pytest.mark.parametrize("turbidity", [1.0, 8.0])
def test_the_ground_gets_no_more_than_the_sun_sends(turbidity):
    """The lit ground has the light of sky and sun, which together are less than the sun's above the atmosphere."""
    sky = sv.Sky((0, 1, 1), turbidity=turbidity, ground_albedo=0.5)
    from_sky = environment_irradiance(sky, (0, 1, 0), rows=128)
    from_sun = sky.sun.illuminance * sky.sun.color * np.sqrt(0.5)
    np.testing.assert_allclose(sky.image[-1, 0], 0.5 / np.pi * (from_sky + from_sun), rtol=0.01)
    share = (from_sky + from_sun) / (SUN_ILLUMINANCE * np.sqrt(0.5))
    assert (share < 1).all()
    assert (share > 0.5).all()


def test_a_clear_sky_is_blue_and_bright_around_the_sun_and_haze_whitens_it():
    clear, hazy = sv.Sky((1, 0.6, 0)), sv.Sky((1, 0.6, 0), turbidity=8)
    away = [(-1, 1, 0)]
    blue, white = (environment_radiance(sky, away)[0] for sky in (clear, hazy))
    assert blue[2] > 1.8 * blue[0]
    assert white[2] / white[0] < 0.8 * blue[2] / blue[0]
    np.testing.assert_allclose(clear.brightest, clear.sun_direction, atol=0.1)
    low = sv.Sky((1, 0.05, 0)).sun
    assert low.color[0] > 3 * low.color[2], "the setting sun is red"
    assert not sv.Sky((1, -0.1, 0)).sun.emits


def test_edits_of_a_sky_move_its_sun():
    sky = sv.Sky((1, 1, 0))
    image, sun = sky.image, sky.sun
    sky.turn(-np.pi / 2)
    np.testing.assert_allclose(sky.sun.direction, (0, -np.sqrt(0.5), -np.sqrt(0.5)), atol=1e-6)
    assert sky.sun is sun
    assert sky.image is image, "a turn about the zenith keeps the map"
    sky.intensity = 0.5
    assert sky.image is image
    assert sun.illuminance == pytest.approx(sv.Sky((1, 1, 0)).sun.illuminance / 2)
    sky.turbidity = 5
    assert sky.image is not image
    assert sun.illuminance < 0.5 * sv.Sky((1, 1, 0)).sun.illuminance
    with pytest.raises(SolariError, match="turbidity"):
        sky.turbidity = 0.5
    assert sky.turbidity == 5


def test_auto_exposure_counts_surfaces():
    picture = np.full((10, 10, 3), 1000.0)
    picture[4:6, 4:6] = 1.0
    assert auto_exposure(picture, picture[..., 0] == 1) == pytest.approx(auto_exposure(np.ones((1, 3))))
    assert auto_exposure(picture, np.zeros((10, 10), bool)) == auto_exposure(picture)
