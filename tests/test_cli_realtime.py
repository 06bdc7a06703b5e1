"""`solari-vk render` with the realtime renderer, as a user meets it: pictures, movies, messages and exit codes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.output.tone_mapping import decode_srgb
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import FIELDS

SIZE = 24, 16
SMALL = ["--size", "24x16", "--warm-up", "2"]


@pytest.fixture
def render(any_device, tmp_path, capsys):
    """Run `solari-vk render builtin:cornell_box`; gives the exit code, what it said on stderr, and the output."""

    def run(*arguments, output="picture.png"):
        path = tmp_path / output
        code = main(["render", "builtin:cornell_box", *map(str, arguments), "-o", str(path)])
        return code, capsys.readouterr().err, path

    return run


@pytest.fixture
def frames(device):
    """frames(count) -> each of the first frames of the same scene, rendered by hand."""
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE) as renderer:
        yield lambda count: (renderer.render(scene.camera) for _ in range(count))


def test_a_picture_is_the_mean_of_the_last_frames(render, frames):
    code, said, path = render(
        *SMALL, "--frames", 5, "--average", 3, "--aov", "di_diffuse,guides_depth", output="picture.npy"
    )
    assert code == 0, said
    taken = [(f["radiance"], f["di_diffuse"], f["guides_depth"]) for f in frames(7)]
    for name, index in (("npy", 0), ("di_diffuse.npy", 1)):
        mean = np.mean([values[index] for values in taken[4:]], axis=0, dtype=np.float64).astype(np.float32)
        np.testing.assert_array_equal(np.load(path.with_suffix(f".{name}")), mean)
    np.testing.assert_array_equal(np.load(path.with_suffix(".guides_depth.npy")), taken[-1][2])


def test_a_view_is_the_last_frame_s(render, frames):
    code, said, path = render(*SMALL, "--frames", 3, "--view", "shading_normal", "--settings", "jitter=on")
    assert code == 0, said
    *_, last = frames(5)
    there = last["depth"][..., 0] > 0
    picture = np.asarray(Image.open(path))
    expected = 255 * (0.5 + 0.5 * last["guides_normal_roughness"][..., :3])
    assert np.abs(picture[there] - expected[there]).max() <= 1


def test_exposure_by_what_is_seen(render):
    code, said, path = render(*SMALL, "--frames", 8, "--exposure", "auto")
    assert code == 0, said
    assert "EV100" in said
    linear = decode_srgb(np.asarray(Image.open(path)) / 255)
    assert 0.05 < np.median(linear) < 0.5


def test_a_time_limit_ends_early(render):
    code, said, path = render(*SMALL, "--frames", 10_000_000, "--time-limit", 2)
    assert code == 0, said
    assert "time limit" in said
    assert np.asarray(Image.open(path)).std() > 5


@pytest.mark.parametrize("output", ["turn.png", "turn.gif"])
def test_an_orbit(render, output):
    code, said, path = render(*SMALL, "--animate", "orbit:40", "--frames", 3, "--average", 2, output=output)
    assert code == 0, said
    if output == "turn.gif":
        with Image.open(path) as movie:
            assert movie.n_frames == 3
            pictures = []
            for index in range(3):
                movie.seek(index)
                pictures.append(np.asarray(movie.convert("RGB")))
    else:
        assert sorted(p.name for p in path.parent.iterdir()) == [f"turn.{index:04}.png" for index in range(3)]
        pictures = [np.asarray(Image.open(path.with_name(f"turn.{index:04}.png"))) for index in range(3)]
    assert all(picture.shape == (16, 24, 3) for picture in pictures)
    assert (pictures[0] != pictures[1]).any()


def test_a_path_of_poses_with_a_view(render, tmp_path):
    camera = sv.builtin("cornell_box").camera
    poses = [camera.pose(), {**camera.pose(), "vertical_fov_degrees": 20}]
    file = tmp_path / "path.json"
    file.write_text(json.dumps(poses))
    code, said, _ = render(*SMALL, "--animate", file, "--fps", 2, "--view", "depth")
    assert code == 0, said
    pictures = sorted(tmp_path.glob("picture.*.png"))
    assert len(pictures) == 3  # a second at two pictures a second, both ends included
    assert "picture 3 of 3" in said
    wide, _, narrow = (np.asarray(Image.open(picture)) for picture in pictures)
    assert (wide == 0).all(axis=2).sum() > (narrow == 0).all(axis=2).sum()


WRONG = [
    (["--samples", "4"], ["--samples", "--mode reference"]),
    (["--mode", "reference", "--warm-up", "4"], ["--warm-up", "--mode realtime"]),
    (["--mode", "reference", "--settings", "di=off"], ["--settings", "--mode realtime"]),
    (["--frames", "3", "--average", "4"], ["--average 4", "3 frames"]),
    (["--view", "smell"], ["smell", "base_color"]),
    (["--view", "depth", "--average", "3"], ["--average", "one frame"]),
    (["--view", "depth", "--aov", "di_diffuse"], ["--aov", "one frame"]),
    (["--aov", "albedo"], ["albedo", "guides_diffuse_albedo"]),
    (["--quality", "best"], ["best", "ultra"]),
    (["--settings", "fog=1"], ["fog", "di_candidates"]),
    (["--settings", "di_candidates"], ["name=value"]),
    (["--settings", "di_candidates=0"], ["di_candidates", "1 to 1024"]),
    (["--animate", "missing.json"], ["missing.json"]),
    (["--animate", "orbit:fast"], ["orbit:fast", "angle"]),
    (["--animate", "orbit:nan"], ["orbit:nan", "angle"]),
    (["--time-limit", "0"], ["time-limit"]),
    (["--seed", "99999999999"], ["seed"]),
]


@pytest.mark.parametrize(("arguments", "words"), WRONG, ids=lambda value: " ".join(value))
def test_wrong_options_are_one_line_and_exit_code_2(render, arguments, words):
    code, said, path = render(*arguments)
    assert code == 2
    assert len([line for line in said.splitlines() if line.startswith("solari-vk:")]) == 1
    assert "Traceback" not in said
    for word in words:
        assert word in said
    assert not path.exists()


@pytest.mark.parametrize(
    ("output", "arguments", "word"),
    [
        ("a.exr", ["--view", "depth"], ".png"),
        ("a.gif", [], "--animate"),
        ("a.gif", ["--animate", "orbit", "--aov", "emission"], "--aov"),
        ("no/folder/a.gif", ["--animate", "orbit"], "folder"),
        ("a.webm", ["--animate", "orbit"], ".webm"),
        ("a.mp4", ["--mode", "reference"], ".mp4"),
    ],
)
def test_outputs_that_do_not_fit(render, output, arguments, word):
    code, said, path = render(*arguments, output=output)
    assert code == 2
    assert word in said
    assert not path.exists()


def test_an_mp4_without_ffmpeg_says_so(render, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    code, said, path = render("--animate", "orbit", output="a.mp4")
    assert code == 2
    assert "pip install 'solari-vk[video]'" in said
    assert ".gif" in said
    assert not path.exists()


def test_ctrl_c_keeps_what_there_is(any_device, tmp_path):
    path: Path = tmp_path / "picture.npy"
    command = [sys.executable, "-u", "-m", "solari_vk", "render", "builtin:cornell_box", "-o", str(path),
               *SMALL, "--frames", "100000000"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:  # "N of M frames" is said every few seconds
        if " of 100000002 frames" in line:
            break
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(timeout=30) == 0, rest
    assert "keeping" in rest
    assert np.isfinite(np.load(path)).all()


def test_lists_name_every_setting_and_view(capsys):
    assert main(["settings"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name}=" in said for name in FIELDS)
    assert main(["views"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(DEBUG_VIEWS)
