"""The command line as a user meets it: pictures, messages and exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from solari_vk.cli import main

REFERENCE = ["--mode", "reference"]
SMALL = [*REFERENCE, "--size", "24x16", "--samples", "2"]


@pytest.fixture
def render(any_device, tmp_path, capsys):
    """Run `solari-vk render` in this process; gives the exit code and what it said on stderr."""

    def run(*arguments, output="picture.png"):
        path = tmp_path / output
        code = main(["render", *map(str, arguments), "-o", str(path)])
        return code, capsys.readouterr().err, path

    return run


def test_png_of_a_builtin_scene(render):
    code, said, path = render("builtin:cornell_box", *SMALL)
    assert code == 0, said
    picture = np.asarray(Image.open(path))
    assert picture.shape[:2] == (16, 24)
    assert picture.std() > 5
    assert "2 samples a pixel" in said


def test_exr_holds_radiance_and_aovs(render):
    import OpenEXR

    code, said, path = render("builtin:cornell_box", *SMALL, "--aov", "depth,albedo,instance_id", output="picture.exr")
    assert code == 0, said
    with OpenEXR.File(str(path)) as file:
        assert {"RGB", "depth", "albedo", "instance_id"} <= set(file.channels())


def test_npy_is_linear_radiance_and_aovs_are_files_beside_it(render):
    code, said, path = render("builtin:cornell_box", *SMALL, "--aov", "depth", output="picture.npy")
    assert code == 0, said
    radiance = np.load(path)
    assert radiance.shape == (16, 24, 3)
    assert radiance.dtype == np.float32
    assert np.isfinite(radiance).all()
    depth = np.load(path.with_suffix(".depth.npy"))
    assert depth.shape == (16, 24)
    assert (depth > 0).all()


def test_a_seed_makes_the_same_picture_and_another_seed_another(render):
    pictures = []
    for seed in (1, 1, 2):
        code, said, path = render("builtin:cornell_box", *SMALL, "--seed", seed, output="picture.npy")
        assert code == 0, said
        pictures.append(np.load(path))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any()


def test_camera_by_pose_and_exposure(render, tmp_path):
    pose = {"position": [0, 1, 3], "target": [0, 1, 0], "vertical_fov_degrees": 40, "ev100": 1}
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(pose))
    pictures = []
    for camera in (json.dumps(pose), str(file)):
        code, said, path = render("builtin:cornell_box", *SMALL, "--camera", camera, output="picture.npy")
        assert code == 0, said
        assert "EV100 1.00" in said
        pictures.append(np.load(path))
    np.testing.assert_array_equal(*pictures)
    code, said, _ = render("builtin:cornell_box", *SMALL, "--exposure", "auto")
    assert code == 0, said
    code, said, _ = render("builtin:cornell_box", *SMALL, "--exposure", "2.5")
    assert "EV100 2.50" in said


def test_a_time_limit_ends_early(render):
    code, said, path = render("builtin:cornell_box", *SMALL, "--samples", 10_000_000, "--time-limit", 0.5)
    assert code == 0, said
    assert path.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["builtin:nothing"], ["nothing", "cornell_box"]),
        (["missing.glb"], ["missing.glb"]),
        (["builtin:cornell_box", "--camera", "7"], ["camera"]),
        (["builtin:cornell_box", "--camera", "{broken"], ["camera"]),
        (["builtin:cornell_box", "--camera", '{"position": [0, 0, 0], "target": [0, 0, 0]}'], ["differ"]),
        (["builtin:cornell_box", "--exposure", "bright"], ["bright"]),
        (["builtin:cornell_box", "--exposure", "nan"], ["ev100", "finite"]),
        (["builtin:cornell_box", "--aov", "smell"], ["smell", "depth"]),
        (["builtin:cornell_box", "--time-limit", "-1"], ["time-limit"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(render, arguments, words):
    code, said, path = render(*arguments, *SMALL)
    assert code == 2
    lines = [line for line in said.splitlines() if line.startswith("solari-vk:")]
    assert len(lines) == 1
    assert "Traceback" not in said
    for word in words:
        assert word in said
    assert not path.exists()


@pytest.mark.parametrize(("output", "word"), [("picture.bmp", ".bmp"), ("no/such/folder/picture.png", "folder")])
def test_a_bad_output_is_refused_before_rendering(render, output, word):
    started = time.monotonic()
    code, said, path = render("builtin:cornell_box", *REFERENCE, "--samples", 100_000, output=output)
    assert code == 2
    assert word in said
    assert not path.exists()
    assert time.monotonic() - started < 5


@pytest.mark.parametrize(
    "arguments",
    [[], ["render"], ["render", "a.glb"], ["render", "a.glb", "-o", "b.png", "--size", "0x5"],
     ["render", "a.glb", "-o", "b.png", "--samples", "0"], ["render", "a.glb", "-o", "b.png", "--size", "big"]],
)  # fmt: skip
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_a_garbage_file_is_refused_by_name(render, tmp_path):
    file = tmp_path / "garbage.glb"
    file.write_bytes(os.urandom(500))
    code, said, _ = render(file, *SMALL)
    assert code == 2
    assert "garbage.glb" in said


def test_an_unknown_device_is_exit_code_3(render):
    code, said, path = render("builtin:cornell_box", *SMALL, "--device", "no such device")
    assert code == 3
    assert "no such device" in said
    assert not path.exists()


def test_no_driver_at_all_is_exit_code_3(tmp_path):
    none = str(tmp_path / "none.json")
    environment = os.environ | {"VK_DRIVER_FILES": none, "VK_ICD_FILENAMES": none, "SOLARI_VK_VALIDATION": "0"}
    ran = subprocess.run(
        [sys.executable, "-m", "solari_vk", "info"], env=environment, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 3, ran.stderr
    assert "Traceback" not in ran.stderr
    assert "driver" in ran.stderr


def test_info_names_devices_compiler_and_cache(any_device, capsys):
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    for word in ("device 0", "compiler", "cache", "usable"):
        assert word in said


def test_ctrl_c_keeps_what_there_is(any_device, tmp_path):
    path: Path = tmp_path / "picture.npy"
    command = [sys.executable, "-u", "-m", "solari_vk", "render", "builtin:cornell_box", "-o", str(path),
               *REFERENCE, "--size", "64x64", "--samples", "100000000"]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:  # "N of M samples" is said every few seconds
        if " of 100000000 samples" in line:
            break
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(timeout=30) == 0, rest
    assert "keeping" in rest
    assert np.isfinite(np.load(path)).all()
