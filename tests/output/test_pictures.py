"""Tone curves, exposure, and the files that pictures are written to."""

from __future__ import annotations

import os

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.base.color import decode_srgb
from solari_vk.base.errors import SolariError
from solari_vk.output.picture import check_output, save_image
from solari_vk.output.tone_mapping import CURVES, auto_exposure, encode_picture, encode_srgb, misexposed, tonemap
from solari_vk.scene.camera import exposure_of

RADIANCE = np.exp(np.random.default_rng(1).normal(0, 2, (6, 9, 3))).astype(np.float32)


# ---- curves -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(CURVES))
def test_curves_rise_from_black_to_white(name):
    gray = np.geomspace(1e-6, 1e6, 400, dtype=np.float32)[:, None].repeat(3, axis=1)
    mapped = tonemap(gray, curve=name)
    assert mapped.dtype == np.float32
    assert (np.diff(mapped, axis=0) >= -1e-6).all()
    assert mapped.min() >= 0
    assert mapped.max() <= 1
    assert mapped[0].max() < 0.01
    assert mapped[-1].min() > 0.93
    np.testing.assert_allclose(mapped, mapped[:, :1].repeat(3, axis=1), atol=2e-3)
    broken = tonemap([[np.nan, np.inf, -np.inf], [-1, 0, 1e38]], exposure=1e3, curve=name)
    assert np.isfinite(broken).all()


def test_known_values():
    for name, value, expected in (
        ("none", 0.25, 0.25),
        ("reinhard", 1, 0.5),
        ("agx", 0.18, 0.2145),
        ("aces", 1 / 0.6, (2.51 + 0.03) / (2.43 + 0.59 + 0.14)),
    ):
        assert tonemap(np.full(3, value), curve=name)[1] == pytest.approx(expected, abs=2e-3 if name == "agx" else 1e-6)
    with pytest.raises(SolariError, match="there is no tone mapping 'film'; there are none, reinhard, aces, agx"):
        tonemap(RADIANCE, curve="film")


def test_srgb_round_trip():
    codes = np.arange(256) / 255
    np.testing.assert_allclose(encode_srgb(decode_srgb(codes)), codes, atol=1e-6)
    assert encode_srgb(0.5) == pytest.approx(0.7353569)
    assert encode_srgb([-1.0, 2.0]).tolist() == [0, pytest.approx(1)]


# ---- exposure ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("luminance", [1e-3, 1.0, 5e8])
def test_auto_exposure_shows_the_average_as_middle_gray(luminance):
    ev100 = auto_exposure(np.full((4, 4, 3), luminance))
    assert luminance / (1.2 * 2**ev100) == pytest.approx(0.18)


def test_a_dark_night_stays_dark():
    """Of 5e-6 cd/m^2, as the sky has without a moon; and a picture of which all codes are 0 is called dark."""
    night = np.full((4, 4, 3), 5e-6)
    codes = encode_picture(night, exposure=exposure_of(auto_exposure(night)))
    assert 0 < np.median(codes) < 40
    assert misexposed(np.zeros((4, 4, 3), np.uint8)) == "dark"


def test_auto_exposure_leaves_black_and_broken_pixels_out():
    picture = np.zeros((10, 10, 3))
    picture[0] = 7
    expected = auto_exposure(np.full((1, 1, 3), 7.0))
    assert auto_exposure(picture) == pytest.approx(expected)
    picture[1, 0] = np.nan
    picture[1, 1] = np.inf
    picture[1, 2] = 1e-30
    assert auto_exposure(picture) == pytest.approx(expected)
    assert auto_exposure(np.zeros((4, 4, 3))) == 0


# ---- files ------------------------------------------------------------------------------------------


def test_png(tmp_path):
    save_image(tmp_path / "a.png", RADIANCE, exposure=0.3, tonemap="aces")
    expected = encode_srgb(tonemap(RADIANCE, exposure=0.3, curve="aces")) * 255
    codes = sv.encode_picture(RADIANCE, exposure=0.3, curve="aces")
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), codes)
    np.testing.assert_allclose(np.asarray(Image.open(tmp_path / "a.png")), expected, atol=0.501)


def test_npy_and_layers_beside_it(tmp_path):
    layers = {"depth": RADIANCE[..., 0], "normal": RADIANCE}
    for name in ("a.npy", "b.png"):
        save_image(tmp_path / name, RADIANCE, layers=layers)
    assert sorted(os.listdir(tmp_path)) == [
        "a.depth.npy",
        "a.normal.npy",
        "a.npy",
        "b.depth.npy",
        "b.normal.npy",
        "b.png",
    ]
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), RADIANCE)
    np.testing.assert_array_equal(np.load(tmp_path / "a.depth.npy"), RADIANCE[..., 0])


def test_layers_have_any_name_but_the_pictures(tmp_path):
    layers = {"file": RADIANCE[..., 0], "allow_pickle": RADIANCE}
    save_image(tmp_path / "a.npz", RADIANCE, layers=layers)
    with np.load(tmp_path / "a.npz") as found:
        for name, expected in (layers | {"radiance": RADIANCE}).items():
            np.testing.assert_array_equal(found[name], expected)
    for path, name in ((tmp_path / "b.npz", "radiance"), (tmp_path / "b.exr", "G")):
        with pytest.raises(SolariError, match=f"{path.name}: the picture itself has the name '{name}' there"):
            save_image(path, RADIANCE, layers={name: RADIANCE[..., 0]})
        assert not path.exists()


def test_exr_holds_everything_exactly(tmp_path):
    ids = np.linspace(0, 2**32 - 1, 54).astype(np.uint32).reshape(6, 9)
    layers = {
        "depth": RADIANCE[..., 0].astype(np.float64),
        "geometric_normal": RADIANCE,
        "albedo": RADIANCE,
        "roughness_metallic": RADIANCE[..., :2],
        "instance_id": ids,
        "variance": RADIANCE[..., :1],
        "hit": RADIANCE[..., 0] > 1,
    }
    save_image(tmp_path / "a.exr", RADIANCE, exposure=0.25, layers=layers, metadata={"scene": "test"})
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert sorted(channels) == sorted(
        [
            "R",
            "G",
            "B",
            "depth",
            *(f"geometric_normal.{c}" for c in "XYZ"),
            *(f"albedo.{c}" for c in "RGB"),
            "roughness_metallic.X",
            "roughness_metallic.Y",
            "instance_id",
            "variance",
            "hit",
        ]
    )
    np.testing.assert_array_equal(channels["G"], RADIANCE[..., 1])
    np.testing.assert_array_equal(channels["geometric_normal.Z"], RADIANCE[..., 2])
    np.testing.assert_array_equal(channels["instance_id"], ids)
    assert channels["instance_id"].dtype == np.uint32
    assert (file.header()["exposure"], file.header()["scene"]) == ("0.25", "test")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.gif", "written as .png, .jpg, .jpeg, .exr, .npz, .npy, not '.gif'"),
        ("a", "not ''"),
        ("no/a.png", "no folder"),
        ("folder.png", "is a folder"),
    ],
)
def test_paths_that_can_not_be_written(tmp_path, name, message):
    (tmp_path / "folder.png").mkdir()
    for attempt in (check_output, lambda path: save_image(path, RADIANCE)):
        with pytest.raises(SolariError, match=message):
            attempt(tmp_path / name)
    check_output(tmp_path / "A.PNG")


def test_shapes_that_do_not_fit(tmp_path):
    for picture, layers in (
        (RADIANCE[..., 0], {}),
        (RADIANCE[:0], {}),
        (RADIANCE, {"depth": RADIANCE[:2]}),
        (RADIANCE, {"x": np.zeros((6, 9, 5))}),
    ):
        with pytest.raises(SolariError, match="shape"):
            save_image(tmp_path / "a.exr", picture, layers=layers)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_videos(tmp_path, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    images = [np.full((8, 16, 3), value, np.uint8) for value in (0, 128, 255)]
    sv.save_video(tmp_path / f"a{suffix}", images, fps=10)
    assert (tmp_path / f"a{suffix}").stat().st_size > 100
    if suffix == ".gif":
        with Image.open(tmp_path / "a.gif") as movie:
            assert (movie.n_frames, movie.info["duration"]) == (3, 100)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a.gif", []), "at least one picture"),
        (("a.avi", []), ".gif, .mp4, not '.avi'"),
        (("a.gif", [], 0), "fps is 0"),
        (("a.gif", [], "24"), "fps is '24'"),
        (("a.gif", [np.zeros((2, 2, 3))]), r"picture 0 is float64 \(2, 2, 3\): give arrays"),
        (("a.gif", [np.zeros((n, 2, 3), np.uint8) for n in (2, 3)]), "picture 1 is uint8 .*all of one size"),
    ],
)
def test_refused_videos(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SolariError, match=message):
        sv.save_video(*arguments)
    assert not list(tmp_path.iterdir())


def test_records_are_no_channels(tmp_path):
    layer = np.zeros((2, 3), [("id", "u4"), ("depth", "f4")])
    with pytest.raises(SolariError, match=r"a\.exr: layer 'found' has records, of id, depth: .npz and .npy files take"):
        save_image(tmp_path / "a.exr", np.zeros((2, 3, 3), np.float32), layers={"found": layer})
    save_image(tmp_path / "a.npz", np.zeros((2, 3, 3), np.float32), layers={"found": layer})
    assert np.load(tmp_path / "a.npz")["found"].dtype == layer.dtype
