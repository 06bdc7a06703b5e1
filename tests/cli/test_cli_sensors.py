"""`solari-vk render` and `dataset` with sensors, shutters and optical flow: files are what Python makes."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.data.datasets.dataset import cameras_for
from solari_vk.output.animation import orbit
from solari_vk.passes.reference import numbered_seed
from solari_vk.scene.shutter import between

SIZE = (24, 16)
BOX = ["builtin:cornell_box", "--size", "24x16", "--seed", "3"]
SENSOR = '{"iso": 400, "bayer": "GRBG", "vignetting": "cos4"}'


@pytest.fixture
def run(lent_device, tmp_path, capsys):
    """run(command, words, output): the exit code and stderr."""

    def execute(command, *words, output="picture.npy"):
        code = main([command, *map(str, words), "-o", str(tmp_path / output)])
        return code, capsys.readouterr().err

    return execute


@pytest.mark.parametrize("mode", [["reference", "--samples", 4], ["realtime", "--frames", 2, "--warm-up", 0]])
def test_a_picture_with_raw_numbers(run, tmp_path, mode):
    code, said = run("render", *BOX, "--mode", *mode, "--sensor", SENSOR)
    assert code == 0, said
    radiance, raw = np.load(tmp_path / "picture.npy"), np.load(tmp_path / "picture.raw.npy")
    expected = sv.Sensor.load(SENSOR).expose(radiance, sv.builtin("cornell_box").camera_for(1.5), seed=3)
    np.testing.assert_array_equal(raw, expected)
    assert raw.dtype == np.uint16


def test_a_data_set_with_raw_numbers_and_flow(run, lent_device, tmp_path):
    (tmp_path / "sensor.json").write_text(SENSOR)
    code, said = run(
        "dataset",
        *BOX,
        "--samples",
        2,
        "--views",
        3,
        "--format",
        "npy",
        "--exposure",
        2,
        "--sensor",
        tmp_path / "sensor.json",
        "--aov",
        "optical_flow,optical_flow_back",
        output="views",
    )
    assert code == 0, said
    scene = sv.builtin("cornell_box")
    cameras = cameras_for("orbit", scene, scene.camera_for(1.5), 3, 1.5, 3)
    for camera in cameras:
        camera.ev100 = 2.0
    for number in range(3):
        radiance = np.load(tmp_path / "views" / f"{number:05}.npy")
        expected = sv.Sensor.load(SENSOR).expose(radiance, cameras[number], seed=numbered_seed(3, number))
        np.testing.assert_array_equal(np.load(tmp_path / "views" / f"{number:05}.raw.npy"), expected)
    with sv.RayTracer(lent_device, scene) as tracer:
        there, back = sv.optical_flow(tracer, cameras[:2], SIZE)
    for name, flow in (("00000.optical_flow", there), ("00001.optical_flow_back", back)):
        found = np.load(tmp_path / "views" / f"{name}.npy")
        np.testing.assert_allclose(found[..., :2], flow.flow, rtol=1e-5)
        np.testing.assert_array_equal(found[..., 2], flow.state)
    for name in ("00002.optical_flow", "00000.optical_flow_back"):
        nothing = np.load(tmp_path / "views" / f"{name}.npy")
        assert np.isnan(nothing[..., :2]).all()
        assert (nothing[..., 2] == 2).all()


REALTIME = ["realtime", "--average", 3, "--warm-up", 2]


@pytest.mark.parametrize(
    ("mode", "exposed"),
    [
        (["reference", "--samples", 8], 0.05),
        (["reference", "--samples", 8], 0.0),
        pytest.param(REALTIME, 0.05, marks=pytest.mark.slow),
    ],
)
def test_an_orbit_with_a_shutter(run, lent_device, tmp_path, mode, exposed):
    """Each picture is exposed from its time on, while the camera goes on along its way."""
    code, said = run(
        "render",
        *BOX,
        "--mode",
        *mode,
        "--animate",
        "orbit:60",
        "--frames",
        3,
        "--fps",
        10,
        "--shutter",
        f"{exposed},0.03",
        "--exposure",
        2,
    )
    assert code == 0, said
    scene = sv.builtin("cornell_box")
    first, second, _ = orbit(scene.camera_for(1.5), scene.bounds.center, 3, 60.0)
    first.ev100 = second.ev100 = 2.0
    exposure = {
        "shutter": sv.Shutter(close=exposed, readout=0.03),
        "pose": lambda time: between(first, second, time / 0.1),
    }
    kind = sv.PathTracer if mode[0] == "reference" else sv.Renderer
    with kind(lent_device, scene, SIZE, seed=3) as renderer:
        if kind is sv.Renderer:
            for number in range(2 + 3):
                expected = renderer.render(first, **(exposure if number >= 2 else {}))
        else:
            expected = renderer.render(first, 8, **exposure)
        np.testing.assert_allclose(np.load(tmp_path / "picture.0000.npy"), expected["radiance"], rtol=1e-5)
    assert np.load(tmp_path / "picture.0001.npy").shape == (16, 24, 3)


@pytest.mark.parametrize(
    "mode", [["reference", "--samples", 32], pytest.param(["realtime", "--frames", 32], marks=pytest.mark.slow)]
)
def test_a_moment_with_a_shutter(run, tmp_path, moving, mode):
    """The triangle's edges are less steep the longer it is exposed."""
    slopes = []
    given = [moving, "--size", "48x32", "--environment", "studio", "--time", 0.3, "--exposure", 0, "--mode", *mode]
    for words in ((), ("--shutter", 0.4)):
        code, said = run("render", *given, *words)
        assert code == 0, said
        light = np.load(tmp_path / "picture.npy")[..., 0].astype(np.float64)
        slopes.append(np.abs(np.diff(light, axis=1)).max(axis=1))
    assert (slopes[1] < 0.7 * slopes[0]).sum() > 4, "of rows that the triangle's upright edge crosses"


def test_an_exposure_that_ends_early_is_written(run, tmp_path, moving):
    code, said = run(
        "render",
        moving,
        "--size",
        "24x16",
        "--mode",
        "reference",
        "--time",
        0.3,
        "--samples",
        32,
        "--shutter",
        "0.4,0.1",
        "--time-limit",
        1e-9,
    )
    assert code == 0, said
    assert "the time limit is over" in said
    assert np.isfinite(np.load(tmp_path / "picture.npy")).all()


def test_a_large_picture_has_no_shutter(run, moving, monkeypatch):
    monkeypatch.setattr("solari_vk.renderers.large_pictures.band_rows", lambda device, size: 8)
    code, said = run("render", moving, "--size", "24x16", "--mode", "reference", "--time", 0.3, "--shutter", 0.4)
    assert code == 2
    assert "--shutter: a picture in bands" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensor", '{"isso": 1}'], "a sensor has no 'isso'"),
        (["--sensor", "none.json"], "none.json: there is no such file"),
        (["--mode", "reference", "--shutter", "0.1"], "nothing moves in a still picture: give --time"),
        (["--mode", "reference", "--shutter", "a"], "'a' is not a number"),
        (["--mode", "reference", "--animate", "orbit", "--shutter", "0.5"], "longer than a picture at --fps 24"),
        (["--mode", "realtime", "--shutter", "0.1"], "nothing moves in a still picture: give --time"),
        (
            ["--mode", "reference", "--shutter", "0.1", "--target-error", "0.1"],
            "a picture with --shutter has --samples",
        ),
        (["--mode", "realtime", "--shutter", "0.1", "--target-error", "0.1"], "a picture with --shutter has --frames"),
        (["--mode", "realtime", "--shutter", "0.1", "--average", "3"], "a picture with --shutter is the mean of its"),
        (["--mode", "realtime", "--shutter", "0.1", "--view", "depth"], "--shutter: a debug view shows one moment"),
    ],
)
def test_wrong_options(run, words, message, capsys):
    try:
        code, said = run("render", *BOX, *words)
    except SystemExit as ended:
        code, said = ended.code, capsys.readouterr().err
    assert code == 2
    assert message in said


def test_flow_of_what_changes_is_refused(run, tmp_path):
    (tmp_path / "random.yaml").write_text("cameras: {fov: [35, 50]}\n")
    code, said = run(
        "dataset", *BOX, "--views", 2, "--aov", "optical_flow", "--randomize", tmp_path / "random.yaml", output="views"
    )
    assert code == 2
    assert "--aov optical_flow: leads from one view to the next of one scene" in said
