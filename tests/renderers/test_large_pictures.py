"""Pictures in bands of rows: the same surfaces and the same light as in one piece."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.renderers import large_pictures

SIZE = (24, 20)
BAND = 24 * 7  # pixels: bands of 7, 7 and 6 rows


@pytest.mark.parametrize("fields", [{}, {"orthographic_height": 2.5}, {"jitter": (3.0, -2.0)}])
def test_bands_show_what_the_whole_shows(device, fields):
    scene = sv.builtin("cornell_box")
    scene.camera.update(**fields)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        whole = tracer.render(samples=64)
        names = ("depth", "albedo", "instance_id")
        picture = sv.render_large(device, scene, SIZE, samples=64, layers=names, band_pixels=BAND)
        assert list(picture) == ["radiance", *names]
        for name in names:
            np.testing.assert_allclose(picture[name], whole[name], rtol=1e-5)
        light = whole["radiance"].mean(axis=(1, 2))
        np.testing.assert_allclose(picture["radiance"].mean(axis=(1, 2)), light, rtol=0.4)
        assert picture["radiance"].mean() == pytest.approx(light.mean(), rel=0.1)


def test_the_exposure_is_that_of_the_whole(device):
    scene = sv.builtin("cornell_box")
    scene.camera.auto_exposure = True
    picture = sv.render_large(device, scene, SIZE, samples=8, band_pixels=BAND)
    assert scene.camera.ev100 == pytest.approx(sv.auto_exposure(picture["radiance"]))
    assert not scene.camera.auto_exposure


def test_progress_counts_all_bands(device):
    seen = []
    sv.render_large(
        device, sv.builtin("cornell_box"), SIZE, samples=2, band_pixels=BAND, progress=lambda *done: seen.append(done)
    )
    assert seen[-1] == (6, 6)
    assert seen == sorted(seen)


def test_bands_are_even_and_sizes_are_checked(device):
    assert large_pictures.band_rows(device, SIZE) == 20
    assert large_pictures.band_rows(device, SIZE, BAND) == 7
    assert large_pictures.band_rows(device, SIZE, 24 * 19) == 10, "not one band of 19 rows and one of 1"
    for size, most, message in (((0, 9), None, "two whole numbers"), ((9,), None, "two whole"), (SIZE, 23, "of a row")):
        with pytest.raises(sv.SolariError, match=message):
            large_pictures.band_rows(device, size, most)
    with pytest.raises(sv.SolariError, match="did you mean 'depth'"):
        sv.render_large(device, sv.Scene(), SIZE, layers=["depht"])


def test_larger_sizes_are_pointed_to_bands(device):
    for kind in (sv.PathTracer, sv.Renderer):
        with pytest.raises(sv.SolariError, match="render_large renders larger pictures"):
            kind(device, sv.builtin("cornell_box"), (1 << 16, 1 << 16))


def test_the_command_renders_bands(device, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(large_pictures, "LARGEST_BAND", BAND)
    command = [
        "render",
        "builtin:cornell_box",
        "-o",
        str(tmp_path / "a.png"),
        "--size",
        "24x20",
        "--mode",
        "reference",
        "--samples",
        "4",
        "--aov",
        "depth",
    ]
    assert main(command) == 0
    assert "3 bands" in capsys.readouterr().err
    assert np.load(tmp_path / "a.depth.npy").shape == (20, 24)
    assert main([*command, "--target-error", "0.1"]) == 2
    assert "--target-error: a picture in bands" in capsys.readouterr().err
