"""`compare`: relMSE, means and FLIP of two pictures."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.output import compare


def test_known_differences():
    reference = np.full((8, 6, 3), (1.0, 2.0, 4.0))
    found = sv.compare(1.1 * reference, reference)
    scale = reference**2 + 0.01 * reference.mean() ** 2
    assert found.relative_mse == pytest.approx(((0.1 * reference) ** 2 / scale).mean())
    np.testing.assert_allclose(found.mean_ratio, 1.1)
    assert np.isnan(found.flip) or 0 < found.flip < 0.5
    same = sv.compare(reference, reference)
    assert same.relative_mse == 0
    assert same.flip == 0 or np.isnan(same.flip)


def test_flip_looks_at_what_the_reference_is_shown_with(device):
    pytest.importorskip("flip_evaluator")
    dim = np.linspace(0.1, 0.3, 8 * 6 * 3).reshape(8, 6, 3)
    by_hand = sv.compare(1.5 * dim, dim, exposure=sv.Camera(ev100=sv.auto_exposure(dim)).exposure).flip
    assert by_hand > 0.05
    assert sv.compare(1.5e5 * dim, 1e5 * dim).flip == pytest.approx(by_hand, rel=1e-3)  # clipped at an exposure of 1
    scene = sv.Scene(sv.Instance(sv.shapes.sphere()))
    scene.environment = sv.Environment(1e4)
    with sv.PathTracer(device, scene, (16, 12)) as tracer:
        for ev100, suits in ((12.0, True), (-20.0, False)):
            frame = tracer.render(sv.Camera.look_at((0, 0, 4), (0, 0, 0), ev100=ev100), samples=2)
            other = 1.2 * frame["radiance"]
            for pair in ((other, frame), (frame, other)):
                factor = sv.Camera(ev100=ev100 if suits else sv.auto_exposure(np.asarray(pair[1]))).exposure
                assert 0 < sv.compare(*pair).flip == sv.compare(*pair, exposure=factor).flip


def test_frames_and_what_is_refused(device):
    scene = sv.Scene(sv.Instance(sv.shapes.sphere()))
    scene.environment = sv.Environment(1.0)
    with sv.PathTracer(device, scene, (16, 12)) as tracer:
        frame = tracer.render(samples=2)
        assert sv.compare(frame, frame["radiance"]).relative_mse == 0
        assert tracer.error == np.inf
        tracer.render(samples=8, target_error=0)
        assert (tracer.samples, tracer.error < 0.1) == (8, True)
        with pytest.warns(UserWarning, match="has 8 samples of earlier calls, more than 1: call reset"):
            tracer.render(samples=1)
    with pytest.raises(sv.SolariError, match="exposure is a factor above 0"):
        sv.compare(np.ones((2, 2, 3)), np.ones((2, 2, 3)), exposure=0)
    nan = np.full((12, 16, 3), np.nan)
    with pytest.raises(sv.SolariError, match="one is of 8 bits here"):
        sv.compare(np.ones((12, 16, 3), np.uint8), np.ones((12, 16, 3)))
    for wrong in (3, np.ones((4, 4)), np.ones((0, 0, 3)), nan, np.ones((4, 4, 3))):
        with pytest.raises(sv.SolariError, match=r"compare: (takes frames|pictures have one size)"):
            sv.compare(wrong, np.ones((12, 16, 3)))


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_files_are_compared(tmp_path, suffix, capsys):
    flip_evaluator = pytest.importorskip("flip_evaluator")
    light = np.random.default_rng(1).random((24, 32, 3)).astype(np.float32)
    paths = [str(tmp_path / f"{name}{suffix}") for name in ("picture", "reference")]
    for path, factor in zip(paths, (0.5, 1.0), strict=True):
        sv.save_image(path, factor * light, tonemap="none")
    found = sv.compare(*paths)
    np.testing.assert_allclose(found.mean_ratio, 0.5, atol=0.01)
    if suffix == ".png":
        assert found.flip == pytest.approx(flip_evaluator.evaluate(*paths[::-1], "LDR")[1], rel=1e-3)
        codes = [np.asarray(Image.open(path)) for path in paths]
        assert sv.compare(*codes).flip == pytest.approx(found.flip)
    heat = tmp_path / "heat.png"
    assert main(["compare", *paths, "--heatmap", str(heat)]) == 0
    assert f"FLIP    {found.flip:.4g}" in capsys.readouterr().out
    assert np.asarray(Image.open(heat)).shape == (24, 32, 3)
    assert np.ptp(np.asarray(Image.open(heat))) > 50


def test_missing_flip_is_told_of(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(compare, "has_flip", lambda: False)
    with pytest.warns(UserWarning, match="FLIP is left out, as nan: pip install flip-evaluator"):
        assert np.isnan(sv.compare(np.ones((4, 4, 3)), np.ones((4, 4, 3))).flip)
    with pytest.raises(sv.SolariError, match="heatmap is made by FLIP: pip install flip-evaluator"):
        sv.compare(np.ones((4, 4, 3)), np.ones((4, 4, 3)), heatmap=tmp_path / "x.png")
    assert main(["compare", "no.png", "no.png"]) == 2
    assert "no.png: there is no such file" in capsys.readouterr().err
