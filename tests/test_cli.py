"""The command line as a user meets it: pictures, movies, messages and exit codes."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.gltf_writer import GltfWriter

import solari_vk as sv
from solari_vk.cli import info, main
from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.options import parse
from solari_vk.cli.subject import load
from solari_vk.gpu.device.physical import DeviceReport
from solari_vk.measure.statistics import relative_mse
from solari_vk.output import oidn
from solari_vk.output.tone_mapping import decode_srgb
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import FIELDS

SIZE = 24, 16
SMALL = ["--size", "24x16"]
REFERENCE = ["--mode", "reference"]
SAMPLES = [*REFERENCE, *SMALL, "--samples", "2"]
FRAMES = [*SMALL, "--warm-up", "2"]


@pytest.fixture
def render(any_device, tmp_path, capsys):
    """Run `solari-vk render`; returns the exit code, its stderr and the path of the output."""

    def run(*arguments, source="builtin:cornell_box", output="picture.png"):
        path = tmp_path / output
        code = main(["render", str(source), *map(str, arguments), "-o", str(path)])
        return code, capsys.readouterr().err, path

    return run


@pytest.fixture
def done(render):
    """Run a `solari-vk render` that must succeed; returns its stderr and the path of the output."""

    def run(*arguments, **options):
        code, said, path = render(*arguments, **options)
        assert code == 0, said
        return said, path

    return run


def pixels(path):
    return np.asarray(Image.open(path))


# ---- the reference ----------------------------------------------------------------------------------


def test_a_picture_and_its_aovs_in_every_format(done):
    import OpenEXR

    said, path = done(*SAMPLES, "--aov", "depth")
    assert pixels(path).shape[:2] == (16, 24)
    assert pixels(path).std() > 5
    assert "2 samples a pixel" in said
    depth = np.load(path.with_suffix(".depth.npy"))
    assert depth.shape == (16, 24)
    assert (depth > 0).all()
    _, path = done(*SAMPLES, "--aov", "depth,albedo,instance_id", output="picture.exr")
    with OpenEXR.File(str(path)) as file:
        assert {"RGB", "depth", "albedo", "instance_id"} <= set(file.channels())


def test_a_seed_makes_the_same_picture_and_another_seed_another(done):
    pictures = [np.load(done(*SAMPLES, "--seed", seed, output="picture.npy")[1]) for seed in (1, 1, 2)]
    assert (pictures[0].shape, pictures[0].dtype) == ((16, 24, 3), np.float32)
    assert np.isfinite(pictures[0]).all()
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0] != pictures[2]).any()


def test_camera_by_pose_and_exposure(done, tmp_path):
    pose = {"position": [0, 1, 3], "target": [0, 1, 0], "vertical_fov_degrees": 40, "ev100": 1}
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(pose))
    pictures = []
    for camera in (json.dumps(pose), str(file)):
        said, path = done(*SAMPLES, "--camera", camera, output="picture.npy")
        assert "EV100 1.00" in said
        pictures.append(np.load(path))
    np.testing.assert_array_equal(*pictures)
    done(*SAMPLES, "--exposure", "auto")
    assert "EV100 2.50" in done(*SAMPLES, "--exposure", "2.5")[0]


# ---- realtime ---------------------------------------------------------------------------------------


@pytest.fixture
def frames(device):
    """frames(count) yields each of the first frames of the same scene, rendered without the command line."""
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE) as renderer:
        yield lambda count: (renderer.render(scene.camera) for _ in range(count))


def test_a_picture_is_the_mean_of_the_last_frames(done, frames):
    names = "diffuse_radiance,guides_depth,albedo"
    _, path = done(*FRAMES, "--frames", 5, "--average", 3, "--aov", names, output="picture.npy")
    taken = [(f["radiance"], f["diffuse_radiance"], f["guides_depth"], f["albedo"]) for f in frames(7)]
    for name, index in (("npy", 0), ("diffuse_radiance.npy", 1)):
        mean = np.mean([values[index] for values in taken[4:]], axis=0, dtype=np.float64).astype(np.float32)
        np.testing.assert_array_equal(np.load(path.with_suffix(f".{name}")), mean)
    for name, index in (("guides_depth", 2), ("albedo", 3)):
        np.testing.assert_array_equal(np.load(path.with_suffix(f".{name}.npy")), taken[-1][index])


def test_a_view_is_the_last_frame_s(done, frames):
    _, path = done(*FRAMES, "--frames", 3, "--view", "shading_normal", "--settings", "jitter=on")
    *_, last = frames(5)
    there = last["gbuffer_depth"][..., 0] > 0
    expected = 255 * (0.5 + 0.5 * last["guides_normal_roughness"][..., :3])
    assert np.abs(pixels(path)[there] - expected[there]).max() <= 1


def test_exposure_by_what_is_seen(done):
    said, path = done(*FRAMES, "--frames", 8, "--exposure", "auto")
    assert "EV100" in said
    assert 0.05 < np.median(decode_srgb(pixels(path) / 255)) < 0.5


def test_options_of_files_and_environments_become_words_again():
    words = ["--scene=1", "--variant=red shoe", "--up=z", "--unit=0.001", "--strict"]
    words += ["--environment=sky", "--environment-rotation=30", "--environment-intensity=0.5"]
    _, job = parse(COMMANDS, ["view", "x.obj", *words])
    assert (job.unit, job.strict, job.environment_rotation) == (0.001, True, 30)
    assert parse(COMMANDS, ["view", "x.obj", *job.words()])[1] == job


def test_light_of_files_without_lights(tmp_path, capsys):
    """A closed room gets a lamp; weak emission and black emissive textures don't stand for light."""

    def lit(mesh, *more, **material):
        file = GltfWriter(tmp_path / "model.glb")
        if "black" in material:
            material = {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": file.image(np.zeros((1, 1, 3)))}}
        number = file.add("materials", **material)
        attributes = {"POSITION": mesh.positions, "TEXCOORD_0": mesh.positions[:, :2]}
        file.node(mesh=file.mesh(attributes, mesh.triangles.ravel(), material=number))
        file.save(file.path)
        return load(parse(COMMANDS, ["view", str(file.path), *more])[1]).scene

    box = sv.shapes.box((-3, 0, -2), (3, 3, 2))
    room = sv.Mesh(box.positions, box.triangles[:, ::-1])
    (lamp,) = lit(room).lights
    assert "a room, and gets a lamp" in capsys.readouterr().err
    assert isinstance(lamp, sv.PointLight)
    assert 2.5 < lamp.position[1] + lamp.radius < 3
    assert lit(room, "--environment", "none").lights.names == []
    for factor, names in ((0.01, ["lamp"]), (0.1, [])):
        assert lit(room, emissiveFactor=[factor] * 3).lights.names == names
    assert lit(box, black=True).lights.names == ["studio"]
    pose = json.dumps({"position": [-30, 1, 0], "target": [0, 0, 0]})
    for kind in ("studio", "sky"):
        turns = [lit(box, "--environment", kind, *words).environment.rotation for words in ((), ("--camera", pose))]
        np.testing.assert_array_equal(*turns)


def test_environments_of_files(done, render, tmp_path):
    """A file without lights stands in a studio; a picture of one color, half as bright, fills what is not covered."""
    box = sv.shapes.box()
    file = GltfWriter(tmp_path / "box.glb")
    file.node(mesh=file.mesh({"POSITION": box.positions}, box.triangles.ravel()))
    file.save(file.path)
    said, path = done(*SAMPLES, source=file.path)
    assert "it is shown in a studio" in said
    assert "EV100 0.00" in said
    assert np.median(pixels(path)) > 100
    sv.save_image(tmp_path / "map.exr", np.full((2, 4, 3), 0.8))
    words = ["--environment", tmp_path / "map.exr", "--environment-intensity", 0.5, "--environment-rotation", 30]
    _, path = done(*SAMPLES, *words, source=file.path, output="lit.npy")
    np.testing.assert_allclose(np.load(path)[0, 0], 0.4, rtol=2e-3)
    _, path = done(*SAMPLES, "--environment", "sky", source=file.path, output="sky.npy")
    assert 1000 < np.load(path)[0, 0, 2] < 50_000
    _, path = done(*SAMPLES, "--environment", "none", source=file.path, output="dark.npy")
    assert not np.load(path).any()
    for words, text in ((["--environment", "none", "--environment-rotation", "9"], "there is no environment"),
                        (["--environment", "x.hdr"], "can't be read"), (["--environment", "x"], "not ''")):  # fmt: skip
        code, said, _ = render(*SAMPLES, *words, source=file.path)
        assert (code, text in said) == (2, True), said


@pytest.mark.parametrize("output", ["turn.png", "turn.gif"])
def test_an_orbit(done, output):
    _, path = done(*FRAMES, "--animate", "orbit:40", "--frames", 3, "--average", 2, output=output)
    if output == "turn.gif":
        with Image.open(path) as movie:
            assert movie.n_frames == 3
            pictures = []
            for index in range(3):
                movie.seek(index)
                pictures.append(np.asarray(movie.convert("RGB")))
    else:
        assert sorted(p.name for p in path.parent.iterdir()) == [f"turn.{index:04}.png" for index in range(3)]
        pictures = [pixels(path.with_name(f"turn.{index:04}.png")) for index in range(3)]
    assert all(picture.shape == (16, 24, 3) for picture in pictures)
    assert (pictures[0] != pictures[1]).any()


def test_a_path_of_poses_with_a_view(done, tmp_path):
    camera = sv.builtin("cornell_box").camera
    poses = [camera.pose(), {**camera.pose(), "vertical_fov_degrees": 20}]
    file = tmp_path / "path.json"
    file.write_text(json.dumps(poses))
    said, _ = done(*FRAMES, "--animate", file, "--fps", 2, "--view", "depth")
    pictures = sorted(tmp_path.glob("picture.*.png"))
    assert len(pictures) == 3  # a second at two pictures a second, both ends included
    assert "picture 3 of 3" in said
    wide, _, narrow = map(pixels, pictures)
    assert (wide == 0).all(axis=2).sum() > (narrow == 0).all(axis=2).sum()


# ---- both -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [[*SAMPLES, "--samples", 10_000_000], [*FRAMES, "--frames", 10_000_000]])
def test_a_time_limit_ends_early(done, arguments):
    said, path = done(*arguments, "--time-limit", 1)
    assert "time limit" in said
    assert pixels(path).std() > 5


@pytest.mark.parametrize(
    ("arguments", "unit"),
    [([*REFERENCE, "--size", "64x64", "--samples", "100000000"], "100000000 samples"),
     ([*FRAMES, "--frames", "100000000"], "100000002 frames")],
)  # fmt: skip
def test_ctrl_c_keeps_what_there_is(any_device, tmp_path, arguments, unit):
    path: Path = tmp_path / "picture.npy"
    command = [sys.executable, "-u", "-m", "solari_vk", "render", "builtin:cornell_box", "-o", str(path), *arguments]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:  # progress is printed every few seconds
        if f" of {unit}" in line:
            break
    process.send_signal(signal.SIGINT)
    rest = process.stderr.read()
    assert process.wait(timeout=30) == 0, rest
    assert "keeping" in rest
    assert np.isfinite(np.load(path)).all()


@pytest.mark.parametrize("arguments", [REFERENCE, ["--mode", "realtime", "--warm-up", "2"]])
def test_a_target_ends_early(done, arguments):
    """The estimated error is printed; it is that of the picture, which is smooth enough then."""
    said, path = done(*arguments, "--size", "48x48", "--target-error", "0.3", output="picture.npy")
    (error,) = re.findall(r"estimated error ([\d.]+) %, in", said)
    assert float(error) <= 30
    count = int(re.findall(r"(\d+) (?:samples|frames)", said)[-1])
    assert 4 <= count < 200
    picture = np.load(path)
    with sv.Device() as device, sv.PathTracer(device, sv.builtin("cornell_box"), (48, 48), seed=99) as tracer:
        reference = tracer.render(samples=300)["radiance"]
    assert relative_mse(picture, reference) ** 0.5 < 0.4


def test_upscaled_pictures_have_an_estimate_too(done):
    """At the size that is rendered, the only one that raw frames have."""
    said, path = done(*FRAMES, "--frames", "9", "--settings", "upscale=2", output="picture.npy")
    assert "estimated error" in said
    assert np.load(path).shape == (16, 24, 3)


@pytest.mark.parametrize(("arguments", "unit", "denoises"), [
    (["--samples", "2"], "samples", True),
    (["--samples", "2", "--no-denoise"], "samples", False),
    (["--mode", "reference", "--samples", "2"], "samples", False),
    (["--samples", "2", "--aov", "variance"], "samples", True),
    (["--aov", "guides_depth", "--time-limit", "0.001"], "frames", False),
    (["--frames", "3"], "frames", False),
    (["--mode", "realtime", "--time-limit", "0.001"], "frames", False),
    (["--time-limit", "0.001"], None, True),
])  # fmt: skip
@pytest.mark.parametrize("installed", [True, False])
def test_the_mode_follows_from_options_and_oidn(done, monkeypatch, arguments, unit, denoises, installed):
    """Without options of a mode, it is the denoised reference if OIDN is installed, else realtime."""
    monkeypatch.setattr(oidn, "is_installed", lambda: installed)
    monkeypatch.setattr(oidn, "check_installed", lambda: None)
    monkeypatch.setattr(oidn, "denoise", lambda radiance, albedo, normal: radiance)
    said = done(*SMALL, *arguments)[0].splitlines()[-1]
    assert f" {unit or ('samples' if installed else 'frames')}" in said
    assert (", denoised" in said) == (denoises and installed)


def test_oidn_that_does_not_load_is_done_without(done, monkeypatch):
    """The plain command then renders in realtime, and one line says why."""

    def load():
        raise sv.SolariError("denoise: libOpenImageDenoise.so: no such file")

    monkeypatch.setattr(oidn, "is_installed", lambda: True)
    monkeypatch.setattr(oidn, "check_installed", load)
    said = done(*SMALL, "--time-limit", "0.001")[0]
    assert said.count("isn't denoised by OIDN: denoise: libOpenImageDenoise.so: no such file") == 1
    assert " frames" in said.splitlines()[-1]


# ---- what is refused --------------------------------------------------------------------------------

BOX = "builtin:cornell_box"
WRONG = [
    ("builtin:nothing", SAMPLES, ["nothing", "cornell_box"]),
    ("missing.glb", SAMPLES, ["missing.glb"]),
    (__file__, SAMPLES, ["test_cli.py"]),
    (BOX, [*SAMPLES, "--camera", "7"], ["camera"]),
    (BOX, [*SAMPLES, "--camera", "{broken"], ["camera"]),
    (BOX, [*SAMPLES, "--camera", '{"position": [0, 0, 0], "target": [0, 0, 0]}'], ["--camera", "differ"]),
    (BOX, [*SAMPLES, "--exposure", "bright"], ["bright"]),
    (BOX, [*SAMPLES, "--exposure", "nan"], ["ev100", "finite"]),
    (BOX, [*SAMPLES, "--aov", "smell"], ["smell", "depth"]),
    (BOX, [*SAMPLES, "--time-limit", "-1"], ["time-limit"]),
    (BOX, ["--mode", "realtime", "--samples", "4"], ["--samples", "--mode reference"]),
    (BOX, ["--frames", "3", "--samples", "4"], ["--samples", "--mode reference"]),
    (BOX, ["--mode", "realtime", "--denoise"], ["--denoise", "--mode reference"]),
    (BOX, ["--target-error", "0"], ["--target-error 0", "0.02"]),
    (BOX, ["--target-error", "0.1", "--average", "3"], ["--target-error", "--average"]),
    (BOX, ["--target-error", "0.1", "--view", "depth"], ["--target-error", "--view"]),
    (BOX, ["--target-error", "0.1", "--animate", "orbit"], ["--target-error", "--animate"]),
    (BOX, ["--mode", "reference", "--warm-up", "4"], ["--warm-up", "--mode realtime"]),
    (BOX, ["--mode", "reference", "--settings", "di=off"], ["--settings", "--mode realtime"]),
    (BOX, ["--frames", "3", "--average", "4"], ["--average 4", "3 frames"]),
    (BOX, ["--view", "depth", "--average", "3"], ["--average", "one frame"]),
    (BOX, ["--view", "depth", "--aov", "di_diffuse"], ["--aov", "one frame"]),
    (BOX, ["--aov", "di_diffuse"], ["--aov di_diffuse", "--settings lighting=split"]),
    (BOX, ["--frames", "3", "--aov", "raw_radiance", "--settings", "upscale=2"], ["--aov raw_radiance", "smaller"]),
    (BOX, ["--aov", "error", "--settings", "denoise=off"], ["--aov error", "denoise=on"]),
    (BOX, ["--view", "di_light"], ["view 'di_light'", "lighting=split"]),
    (BOX, ["--mode", "realtime", "--aov", "variance"], ["variance", "guides_diffuse_albedo"]),
    (BOX, ["--quality", "best"], ["best", "ultra"]),
    (BOX, ["--settings", "fog=1"], ["fog", "lighting"]),
    (BOX, ["--settings", "di_candidates"], ["name=value"]),
    (BOX, ["--settings", "di_candidates=0"], ["di_candidates", "1 to 1024"]),
    (BOX, ["--animate", "missing.json"], ["missing.json"]),
    (BOX, ["--animate", "orbit:fast"], ["orbit:fast", "angle"]),
    (BOX, ["--animate", "orbit:nan"], ["orbit:nan", "angle"]),
    (BOX, ["--time-limit", "0"], ["time-limit"]),
    (BOX, ["--seed", "99999999999"], ["seed"]),
]


@pytest.mark.parametrize(("source", "arguments", "words"), WRONG, ids=lambda value: " ".join(value)[-40:])
def test_bad_input_is_one_line_and_exit_code_2(render, source, arguments, words):
    code, said, path = render(*arguments, source=source)
    assert code == 2
    assert len([line for line in said.splitlines() if line.startswith("solari-vk:")]) == 1
    assert "Traceback" not in said
    for word in words:
        assert word in said
    assert not path.exists()


@pytest.mark.parametrize(
    ("output", "arguments", "word"),
    [
        ("picture.bmp", [*REFERENCE, "--samples", "100000"], ".bmp"),
        ("no/such/folder/picture.png", [*REFERENCE, "--samples", "100000"], "folder"),
        ("a.mp4", REFERENCE, ".mp4"),
        ("a.exr", ["--view", "depth"], ".png"),
        ("a.gif", [], "--animate"),
        ("a.gif", ["--animate", "orbit", "--aov", "emission"], "--aov"),
        ("no/folder/a.gif", ["--animate", "orbit"], "folder"),
        ("a.webm", ["--animate", "orbit"], ".webm"),
    ],
)
def test_a_bad_output_is_refused_before_rendering(render, output, arguments, word):
    started = time.monotonic()
    code, said, path = render(*arguments, output=output)
    assert code == 2
    assert word in said
    assert not path.exists()
    assert time.monotonic() - started < 5


def test_an_mp4_without_ffmpeg_says_so(render, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    code, said, path = render("--animate", "orbit", output="a.mp4")
    assert code == 2
    assert "pip install 'solari-vk[video]'" in said
    assert ".gif" in said
    assert not path.exists()


PICTURE = ["render", "a.glb", "-o", "b.png"]


@pytest.mark.parametrize(("arguments", "words"), [
    ([], ["COMMAND"]),
    (["render"], ["FILE"]),
    (["render", "a.glb"], ["--output"]),
    ([*PICTURE, "--size", "0x5"], ["1x1"]),
    ([*PICTURE, "--size", "big"], ["big"]),
    ([*PICTURE, "--samples", "0"], ["at least 1"]),
    ([*PICTURE, "--tonemap", "sepia"], ["sepia", "agx"]),
    ([*PICTURE, "--view", "smell"], ["smell", "base_color"]),
    (["view", "a.glb", "--view", "smell"], ["smell", "base_color"]),
], ids=str)  # fmt: skip
def test_wrong_usage_is_exit_code_2(arguments, words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("usage", *words))


def test_an_unknown_device_is_exit_code_3(render):
    code, said, path = render(*SAMPLES, "--device", "no such device")
    assert code == 3
    assert "no such device" in said
    assert not path.exists()


def test_no_driver_at_all_is_exit_code_3(tmp_path):
    none = str(tmp_path / "none.json")
    environment = os.environ | {"VK_DRIVER_FILES": none, "VK_ICD_FILENAMES": none, "SOLARI_VK_VALIDATION": "0"}
    command = [sys.executable, "-m", "solari_vk", "info"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 3, ran.stderr
    assert "Traceback" not in ran.stderr
    assert "driver" in ran.stderr


# ---- lists ------------------------------------------------------------------------------------------


def test_info_names_devices_compiler_and_cache(any_device, capsys):
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    for word in ("device 0", "compiler", "cache", "usable", "--rays query: ", "--rays pipeline: ", "gbuffer=auto: "):
        assert word in said


def test_info_names_what_is_missing_and_the_command(any_device, monkeypatch, capsys):
    absent = {"pyoidn", "imageio_ffmpeg", "distributed"}
    monkeypatch.setattr("solari_vk.cli.info.find_spec", lambda name: None if name in absent else name)
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr("solari_vk.viewer.window.glfw.init", lambda: 0)
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for extra in ("oidn", "video", "cluster"):
        assert said.count(f": missing: pip install 'solari-vk[{extra}]'\n") == 1
    assert said.count(": missing: ") == 3
    assert "\nwindows: GLFW does not start (without a display: xvfb-run" in said
    project = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text())["project"]
    assert {part.extra for part in info.PARTS} <= set(project["optional-dependencies"])


def test_info_names_what_is_installed_and_does_not_work(any_device, monkeypatch, tmp_path, capsys):
    """A library that fails, and one that ends the process."""
    (tmp_path / "DracoPy.py").write_text("raise ImportError('no libdraco.so')")
    (tmp_path / "meshopt.py").write_text("import os; os._exit(9)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr("solari_vk.cli.info.find_spec", lambda name: name)
    info._why_not.cache_clear()
    assert main(["info"]) == 0
    info._why_not.cache_clear()
    said = capsys.readouterr().out
    assert "meshes of Draco: installed, but it doesn't work: ImportError: no libdraco.so\n" in said
    assert "meshes of meshopt: installed, but it doesn't work: it ends Python with code 9\n" in said


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_output():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "solari_vk", "settings"]
        ran = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ran.returncode == 2
    assert ran.stderr == "solari-vk: the output can't be written: No space left on device\n"


def test_info_counts_all_files_of_the_cache(any_device, monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path))
    for name in ("a.spv", "b.spv", "c.pipelines", "d.txt"):
        (tmp_path / name).write_bytes(bytes(500_000))
    assert main(["info"]) == 0
    assert f"cache: {tmp_path}, shaders: 2, pipeline caches: 1, 1.5 MB\n" in capsys.readouterr().out


def test_render_names_the_way_to_trace(done):
    for rays, words in (("query", "ray queries"), ("pipeline", "ray pipelines")):
        said, _ = done(*SAMPLES, "--rays", rays)
        assert f", by {words}\n" in said


def test_info_says_what_each_way_to_trace_lacks(monkeypatch, capsys):
    lacks = {"query": ["VK_KHR_ray_query"], "pipeline": []}
    card = DeviceReport(0, "Card", "discrete gpu", "0", "driver 1", (1, 3, 0), [], lacks)
    monkeypatch.setattr("solari_vk.gpu.device.device.list_devices", lambda: [card])
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    assert "  usable\n  --rays query: lacks VK_KHR_ray_query\n  --rays pipeline: yes\n" in said
    assert "  without --rays: by ray pipelines\n" in said
    monkeypatch.setenv("SOLARI_VK_RAYS", "query")
    assert main(["info"]) == 0
    assert "  without --rays: none, because SOLARI_VK_RAYS is 'query'\n" in capsys.readouterr().out
    neither = dataclasses.replace(card, missing=["VK_KHR_ray_query or VK_KHR_ray_tracing_pipeline"])
    monkeypatch.setattr("solari_vk.gpu.device.device.list_devices", lambda: [neither])
    assert main(["info"]) == 3
    captured = capsys.readouterr()
    assert "  lacks: VK_KHR_ray_query or VK_KHR_ray_tracing_pipeline\n" in captured.out
    assert "install a driver with VK_KHR_ray_query or VK_KHR_ray_tracing_pipeline" in captured.err


def test_lists_name_every_setting_and_view(capsys):
    assert main(["settings"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name}=" in said for name in FIELDS)
    assert main(["views"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(DEBUG_VIEWS)
