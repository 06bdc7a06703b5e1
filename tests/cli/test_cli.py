"""The command line as a user meets it: pictures, movies, messages and exit codes."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.files import GltfWriter

import solari_vk as sv
from solari_vk.base import disk_cache
from solari_vk.base.color import decode_srgb
from solari_vk.cli import info, main, realtime
from solari_vk.cli.commands import COMMANDS
from solari_vk.cli.loading import load_scene
from solari_vk.cli.options import parse
from solari_vk.cli.render import make_job
from solari_vk.gpu.device.physical import DeviceReport
from solari_vk.output import oidn
from solari_vk.output.compare import relative_mse
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import FIELDS

BOX = "builtin:cornell_box"
SIZE = 24, 16
SMALL = ["--size", "24x16"]
REFERENCE = ["--mode", "reference"]
SAMPLES = [*REFERENCE, *SMALL, "--samples", "2"]
FRAMES = [*SMALL, "--warm-up", "2"]


@pytest.fixture
def render(lent_device, tmp_path, capsys):
    """Run `solari-vk render`, which must end with a code; returns its stderr and the path of the output."""

    def run(*arguments, source=BOX, output="picture.png", code=0):
        path = tmp_path / output
        ended = main(["render", str(source), *map(str, arguments), "-o", str(path)])
        said = capsys.readouterr().err
        assert ended == code, said
        assert code == 0 or not path.exists()
        return said, path

    return run


def pixels(path):
    return np.asarray(Image.open(path))


# ---- the reference ----------------------------------------------------------------------------------


def test_a_picture_and_its_aovs(render):
    import OpenEXR

    said, path = render(*SAMPLES, "--aov", "depth")
    assert pixels(path).shape[:2] == (16, 24)
    assert pixels(path).std() > 5
    assert "2 samples a pixel" in said
    depth = np.load(path.with_suffix(".depth.npy"))
    assert depth.shape == (16, 24)
    assert (depth > 0).all()
    _, path = render(*SAMPLES, "--aov", "depth,albedo,instance_id", output="picture.exr")
    with OpenEXR.File(str(path)) as file:
        assert {"RGB", "depth", "albedo", "instance_id"} <= set(file.channels())


def test_seeds_poses_and_exposures(render, tmp_path):
    """A seed makes the same picture, by a pose in words and in a file, and another seed another."""
    pose = json.dumps({"position": [0, 1, 3], "target": [0, 1, 0], "vertical_fov_degrees": 40, "ev100": 1})
    (tmp_path / "pose.json").write_text(pose)
    pictures = []
    for seed, camera in ((1, pose), (1, tmp_path / "pose.json"), (2, pose)):
        said, path = render(*SAMPLES, "--seed", seed, "--camera", camera, output="picture.npy")
        assert "EV100 1.00" in said
        pictures.append(np.load(path))
    assert (pictures[0].shape, pictures[0].dtype) == ((16, 24, 3), np.float32)
    np.testing.assert_array_equal(*pictures[:2])
    assert (pictures[0] != pictures[2]).any()
    assert "EV100 2.50" in render(*SAMPLES, "--exposure", "2.5")[0]


# ---- realtime ---------------------------------------------------------------------------------------


@pytest.fixture
def frames(lent_device):
    """frames(count) yields each of the first frames of the same scene, rendered without the command line."""
    scene = sv.builtin("cornell_box")
    with sv.Renderer(lent_device, scene, SIZE) as renderer:
        yield lambda count: (renderer.render(scene.camera) for _ in range(count))


def test_a_picture_is_the_mean_of_the_last_frames(render, frames):
    names = "diffuse_radiance,guides_depth,albedo"
    _, path = render(*FRAMES, "--frames", 5, "--average", 3, "--aov", names, output="picture.npy")
    taken = [(f["radiance"], f["diffuse_radiance"], f["guides_depth"], f["albedo"]) for f in frames(7)]
    for index, name in enumerate(("npy", "diffuse_radiance.npy", "guides_depth.npy", "albedo.npy")):
        values = [frame[index] for frame in taken]
        mean = np.mean(values[4:], axis=0, dtype=np.float64).astype(np.float32)
        np.testing.assert_array_equal(np.load(path.with_suffix(f".{name}")), mean if index < 2 else values[-1])


def test_a_view_is_the_last_frame_s(render, frames):
    _, path = render(*FRAMES, "--frames", 3, "--view", "shading_normal", "--settings", "jitter=on")
    *_, last = frames(5)
    there = last["gbuffer_depth"][..., 0] > 0
    expected = 255 * (0.5 + 0.5 * last["guides_normal_roughness"][..., :3])
    assert np.abs(pixels(path)[there] - expected[there]).max() <= 1


def test_exposure_by_what_is_seen(render):
    said, path = render(*FRAMES, "--frames", 8, "--exposure", "auto")
    assert "EV100" in said
    assert 0.05 < np.median(decode_srgb(pixels(path) / 255)) < 0.5


def test_options_of_files_and_environments_become_words_again():
    words = ["--scene=1", "--variant=red shoe", "--up=z", "--unit=0.001", "--strict"]
    words += ["--environment=sky", "--environment-rotation=30", "--environment-intensity=0.5"]
    _, job = parse(COMMANDS, ["view", "x.obj", *words])
    assert (job.unit, job.strict, job.environment_rotation) == (0.001, True, 30)
    assert parse(COMMANDS, ["view", "x.obj", *job.words()])[1] == job


@pytest.fixture
def model(tmp_path):
    """Write a file of a mesh without lights."""

    def write(mesh, **material):
        file = GltfWriter(tmp_path / "model.glb")
        if "black" in material:
            material = {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": file.image(np.zeros((1, 1, 3)))}}
        number = file.add("materials", **material)
        attributes = {"POSITION": mesh.positions, "TEXCOORD_0": mesh.positions[:, :2]}
        file.node(mesh=file.mesh(attributes, mesh.triangles.ravel(), material=number))
        return file.save(file.path)

    return write


def test_light_of_files_without_lights(model, capsys):
    """A closed room gets a lamp; weak emission and black emissive textures don't stand for light, nor does a sign that
    lights nothing, which is told."""

    def lit(mesh, *more, **material):
        return load_scene(parse(COMMANDS, ["view", str(model(mesh, **material)), *more])[1]).scene

    box = sv.shapes.box((-3, 0, -2), (3, 3, 2))
    room = sv.Mesh(box.positions, box.triangles[:, ::-1])
    (lamp,) = lit(room).lights
    assert "a room, and gets a lamp" in capsys.readouterr().err
    assert isinstance(lamp, sv.PointLight)
    assert 2.5 < lamp.position[1] + lamp.radius < 3
    assert lit(room, "--environment", "none").lights.names == []
    for factor, names in ((1e-5, ["lamp"]), (0.01, []), (0.1, [])):
        assert lit(room, emissiveFactor=[factor] * 3).lights.names == names
    few = sv.Mesh(np.concatenate([room.positions[room.triangles[0]], [(3, 3, 2)] * 3]))
    assert lit(few, emissiveFactor=[0.25] * 3).lights.names == [], "all that is seen shines"
    assert lit(box, black=True).lights.names == ["studio"]
    pose = json.dumps({"position": [-30, 1, 0], "target": [0, 0, 0]})
    for kind in ("studio", "sky"):
        turns = [lit(box, "--environment", kind, *words).environment.rotation for words in ((), ("--camera", pose))]
        np.testing.assert_array_equal(*turns)


def test_environments_of_files(render, model, tmp_path):
    """A file without lights stands in a studio; a picture of one color, half as bright, fills what is not covered."""
    file = model(sv.shapes.box())
    said, path = render(*SAMPLES, source=file)
    assert "it is shown in a studio" in said
    assert "EV100 0.00" in said
    assert np.median(pixels(path)) > 100
    sv.save_image(tmp_path / "map.exr", np.full((2, 4, 3), 0.8))
    words = [tmp_path / "map.exr", "--environment-intensity", 0.5, "--environment-rotation", 30]
    lit, sky, dark = (
        np.load(render(*SAMPLES, "--environment", *more, source=file, output="lit.npy")[1])
        for more in (words, ["sky"], ["none"])
    )
    np.testing.assert_allclose(lit[0, 0], 0.4, rtol=2e-3)
    assert 1000 < sky[0, 0, 2] < 50_000
    assert not dark.any()
    for more, text in (
        (["none", "--environment-rotation", "9"], "there is no environment"),
        (["x.hdr"], "no such file"),
        (["x"], "not ''"),
    ):
        assert text in render(*SAMPLES, "--environment", *more, source=file, output="refused.png", code=2)[0]


def test_an_orbit(render):
    _, path = render(*FRAMES, "--animate", "orbit:40", "--frames", 3, "--average", 2, output="turn.gif")
    with Image.open(path) as movie:
        assert (movie.n_frames, movie.size) == (3, SIZE)
        first, second = (np.asarray((movie.seek(index), movie.convert("RGB"))[1]) for index in range(2))
    assert (first != second).any()


def test_an_orbit_by_the_path_tracer(render, tmp_path):
    """Numbered pictures go on where they stopped; --samples alone chooses the mode."""
    said, _ = render(*SMALL, "--samples", 2, "--animate", "orbit", "--frames", 3, output="turn.npy")
    files = sorted(tmp_path.glob("turn.*.npy"))
    assert [file.name for file in files] == [f"turn.{index:04}.npy" for index in range(3)]
    assert "3 of 3 pictures" in said
    first, second = map(np.load, files[:2])
    assert first.any()
    assert (first != second).any()
    files[1].unlink()
    again, _ = render(*SMALL, "--samples", 2, "--animate", "orbit", "--frames", 3, output="turn.npy")
    assert "3 of 3 pictures" in again
    assert (np.load(files[1]) == second).all()
    _, path = render(*SAMPLES, "--animate", "orbit:20", "--frames", 2, output="turn.gif")
    with Image.open(path) as movie:
        assert (movie.n_frames, movie.size) == (2, SIZE)
    assert not path.with_name("turn.frames").exists()


def test_a_path_of_poses_with_a_view(render, tmp_path):
    camera = sv.builtin("cornell_box").camera
    poses = [camera.pose(), {**camera.pose(), "vertical_fov_degrees": 20}]
    file = tmp_path / "path.json"
    file.write_text(json.dumps(poses))
    said, _ = render(*FRAMES, "--animate", file, "--fps", 2, "--view", "depth")
    paths = sorted(tmp_path.glob("picture*"))
    assert [path.name for path in paths] == [f"picture.{index:04}.png" for index in range(3)]  # both ends of a second
    wide, _, narrow = map(pixels, paths)
    assert "picture 3 of 3" in said
    assert (wide == 0).all(axis=2).sum() > (narrow == 0).all(axis=2).sum()


# ---- both -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [[*SAMPLES, "--samples", 10_000_000], [*FRAMES, "--frames", 10_000_000]])
def test_a_time_limit_ends_early(render, arguments):
    said, path = render(*arguments, "--time-limit", 1)
    assert "time limit" in said
    assert pixels(path).std() > 5


@pytest.mark.parametrize(
    ("arguments", "unit"),
    [
        pytest.param([*SAMPLES, "--samples", "100000000"], "100000000 samples", marks=pytest.mark.slow),
        ([*FRAMES, "--frames", "100000000"], "100000002 frames"),
    ],
)
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


@pytest.mark.parametrize("arguments", [REFERENCE, pytest.param(FRAMES, marks=pytest.mark.slow)])
def test_a_target_ends_early(render, lent_device, arguments):
    """The estimated error is printed; it is that of the picture, which is smooth enough then."""
    said, path = render(*arguments, "--size", "48x48", "--target-error", "0.3", output="picture.npy")
    (error,) = re.findall(r"estimated error ([\d.]+) %, in", said)
    assert float(error) <= 30
    count = int(re.findall(r"(\d+) (?:samples|frames)", said)[-1])
    assert 4 <= count < 200
    picture = np.load(path)
    with sv.PathTracer(lent_device, sv.builtin("cornell_box"), (48, 48), seed=99) as tracer:
        reference = tracer.render(samples=300)["radiance"]
    assert relative_mse(picture, reference) ** 0.5 < 0.4


def test_upscaled_pictures_have_an_estimate_too(render):
    """Raw frames have light in some pixels alone, which counts for all."""
    said, path = render(*FRAMES, "--frames", "9", "--settings", "upscale=2", output="picture.npy")
    assert "estimated error" in said
    assert np.load(path).shape == (16, 24, 3)


@pytest.fixture
def oidn_that(monkeypatch):
    """Let OIDN be installed or not, and fail with an error when it is loaded."""

    def be(installed, error=None):
        def load():
            if error:
                raise sv.SolariError(error)

        monkeypatch.setattr(oidn, "is_installed", lambda: installed)
        monkeypatch.setattr(oidn, "check_installed", load)
        monkeypatch.setattr(oidn, "denoise", lambda radiance, albedo, normal: radiance)

    return be


def job_of(*words):
    return make_job(parse(COMMANDS, ["render", BOX, "-o", "picture.png", *words])[1])


@pytest.mark.parametrize(
    ("words", "mode", "denoises"),
    [
        (["--samples", "2"], "reference", True),
        (["--samples", "2", "--no-denoise"], "reference", False),
        (["--aov", "variance"], "reference", True),
        (["--aov", "guides_depth"], "realtime", False),
        (["--frames", "3"], "realtime", False),
        ([], None, True),
    ],
)
@pytest.mark.parametrize("installed", [True, False])
def test_the_mode_follows_from_options_and_oidn(oidn_that, words, mode, denoises, installed):
    """On the processor, without options of a mode, it is the denoised reference if OIDN is installed, else realtime."""
    oidn_that(installed)
    job = job_of(*words)
    assert (job.mode, job.denoise) == (mode or ("reference" if installed else "realtime"), denoises and installed)


def test_graphics_cards_render_in_realtime(oidn_that, monkeypatch):
    oidn_that(True)
    monkeypatch.setattr("solari_vk.gpu.device.device.kind_of_device", lambda select, rays: f"{select} gpu, {rays}")
    jobs = [job_of(*words.split()) for words in ("--device 1 --rays pipeline", "--frames 3", "--view depth")]
    assert [job.mode for job in (*jobs, job_of("--samples", "2"))] == [*["realtime"] * 3, "reference"]
    assert [realtime.frames_of(job, "discrete gpu") for job in jobs] == [(192, 192), (3, 3), (48, 1)]


def test_oidn_that_does_not_load_is_done_without(oidn_that, capsys):
    """The plain command then renders in realtime, and one line says why."""
    oidn_that(True, "libOpenImageDenoise.so: no such file")
    assert job_of().mode == "realtime"
    said = capsys.readouterr().err
    assert said == "the picture isn't denoised by OIDN: libOpenImageDenoise.so: no such file\n"


def test_the_plain_command_denoises(render, oidn_that):
    oidn_that(True)
    assert ", denoised" in render(*SMALL, "--samples", "2")[0]


# ---- what is refused --------------------------------------------------------------------------------

WRONG = [
    ("builtin:nothing", SAMPLES, ["nothing", "cornell_box"]),
    (__file__, SAMPLES, ["test_cli.py"]),
    (BOX, [*SAMPLES, "--camera", "7"], ["camera"]),
    (BOX, [*SAMPLES, "--camera", "{broken"], ["camera"]),
    (BOX, [*SAMPLES, "--camera", '{"position": [0, 0, 0], "target": [0, 0, 0]}'], ["--camera", "differ"]),
    (BOX, [*SAMPLES, "--exposure", "bright"], ["bright"]),
    (BOX, [*SAMPLES, "--aov", "smell"], ["smell", "depth"]),
    (BOX, [*SAMPLES, "--mode", "realtime", "--aov", "Depth"], ["--aov Depth", "distance", "guides_depth"]),
    (BOX, [*SAMPLES, "--aov", "normal"], ["--aov normal", "shading_normal"]),
    (BOX, [*SAMPLES, "--scene", "1"], ["--scene 1", "built-in"]),
    (BOX, ["--time-limit", "0"], ["time-limit"]),
    (BOX, ["--frames", "3", "--samples", "4"], ["--samples", "--mode reference"]),
    (BOX, ["--mode", "reference", "--warm-up", "16"], ["--warm-up", "--mode realtime"]),
    (BOX, ["--target-error", "0"], ["--target-error 0", "0.02"]),
    (BOX, ["--target-error", "0.1", "--average", "3"], ["--target-error", "--average"]),
    (BOX, ["--target-error", "0.1", "--view", "depth"], ["--target-error", "--view"]),
    (BOX, ["--target-error", "0.1", "--animate", "orbit"], ["--target-error", "--animate"]),
    (BOX, [*SAMPLES, "--target-error", "0.1", "--animate", "orbit"], ["--target-error", "--samples"]),
    (BOX, [*SAMPLES, "--animate", "orbit", "--warm-up", "2"], ["--warm-up", "--mode realtime"]),
    (BOX, ["--frames", "3", "--average", "4"], ["--average 4", "3 frames"]),
    (BOX, ["--view", "depth", "--average", "3"], ["--average", "one frame"]),
    (BOX, ["--view", "depth", "--aov", "di_diffuse"], ["--aov", "one frame"]),
    (BOX, ["--aov", "di_diffuse"], ["--aov di_diffuse", "--settings lighting=split"]),
    (
        BOX,
        ["--frames", "3", "--aov", "raw_radiance", "--settings", "upscale=2", "--settings", "restir=on"],
        ["raw_radiance", "smaller"],
    ),
    (BOX, ["--aov", "error", "--settings", "denoise=off"], ["--aov error", "denoise=on"]),
    (BOX, ["--view", "di_light"], ["view 'di_light'", "lighting=split"]),
    (BOX, ["--mode", "realtime", "--aov", "variance"], ["variance", "guides_diffuse_albedo"]),
    (BOX, ["--quality", "best"], ["best", "ultra"]),
    (BOX, ["--settings", "di_candidates=0"], ["di_candidates", "1 to 1024"]),
    (BOX, ["--animate", "missing.json"], ["missing.json"]),
    (BOX, ["--animate", "orbit:fast"], ["orbit:fast", "angle"]),
    (BOX, ["--animate", "orbit:nan"], ["orbit:nan", "angle"]),
    (BOX, ["--seed", "99999999999"], ["seed"]),
    (BOX, [*SAMPLES, "--camera", "9" * 5000], ["--camera 999", "999...999"]),
    (BOX, [*SAMPLES, "--camera", "{" + " 1" * 5000], ["--camera { 1 1"]),
    (BOX, ["--animate", "orbit", "--frames", "1000000000000"], ["--frames 1000000000000", "100,000"]),
    (BOX, ["--animate", "orbit", "--duration", "1e9"], ["--fps 24 for 1e+09 s", "100,000"]),
    (BOX, ["--animate", "orbit", "--duration", "nan"], ["--duration nan", "above 0"]),
    (BOX, ["--animate", "orbit", "--duration", "1", "--frames", "2"], ["--duration", "leave one"]),
    (BOX, ["--duration", "1"], ["--duration", "give --animate"]),
    (BOX, ["--workers", "2", "--cluster", "tcp://a:1"], ["--workers", "--cluster", "one of the two"]),
    (BOX, ["--shared-folder"], ["--shared-folder", "--cluster"]),
]


@pytest.mark.parametrize(("source", "arguments", "words"), WRONG, ids=lambda value: " ".join(value)[-40:])
def test_bad_input_is_one_line_and_exit_code_2(render, source, arguments, words):
    said, _ = render(*arguments, source=source, code=2)
    assert len([line for line in said.splitlines() if line.startswith("solari-vk:")]) == 1
    assert len(said) < 2100
    assert "Traceback" not in said
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("output", "arguments", "word"),
    [
        ("picture.bmp", REFERENCE, ".bmp"),
        ("no/such/folder/picture.png", REFERENCE, "folder"),
        ("a.mp4", REFERENCE, ".mp4"),
        ("a.exr", ["--view", "depth"], ".png"),
        ("a.gif", [], "--animate"),
        ("a.gif", ["--animate", "orbit", "--aov", "emission"], "--aov"),
        ("no/folder/a.gif", ["--animate", "orbit"], "folder"),
        ("a.webm", ["--animate", "orbit"], ".webm"),
        ("a_%03d.png", ["--animate", "orbit"], "give a.png for a.0000.png"),
    ],
)
def test_a_bad_output_is_refused_before_a_device_is_asked_for(render, output, arguments, word):
    assert word in render(*arguments, "--device", "no such device", output=output, code=2)[0]


def test_an_mp4_without_ffmpeg_says_so(render, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said, _ = render("--animate", "orbit", output="a.mp4", code=2)
    assert "pip install 'solari-vk[video]'" in said
    assert ".gif" in said


PICTURE = ["render", "a.glb", "-o", "b.png"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["COMMAND"]),
        (["render", "a.glb"], ["--output"]),
        (["renderr", "a.glb"], ["did you mean 'render'?"]),
        ([*PICTURE, "--size", "0x5"], ["1x1"]),
        ([*PICTURE, "--size", "big"], ["big"]),
        ([*PICTURE, "--samples", "0"], ["at least 1"]),
        ([*PICTURE, "--samples", "9" * 5000], ["999...999"]),
        ([*PICTURE, "--mode", "9" * 5000], ["999...999", "choose from"]),
        (["9" * 5000], ["999...999", "there are render, view"]),
        (["bench", "lod"], ["did you mean 'load'?"]),
        (["dataset", "a.glb", "-o", "b", "--coco"], ["--annotations coco"]),
        ([*PICTURE, "--environment-intensity", "-1"], ["not be negative"]),
        (["compare", "a.png", "b.png", "--heatmap=--"], ["./--"]),
        ([*PICTURE, "--tonemap", "sepia"], ["sepia", "agx"]),
        (["view", "a.glb", "--view", "smell"], ["smell", "base_color"]),
    ],
    ids=str,
)
def test_wrong_usage_is_exit_code_2(arguments, words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("usage", *words))
    assert len(said.partition("error: ")[2]) < 1000


def test_what_a_part_of_bench_is_given_is_what_its_function_takes():
    (bench,) = (command for command in COMMANDS if command.name == "bench")
    for part in (bench, *bench.parts):
        run = importlib.import_module(f"solari_vk.lab.measure.{part.job_type.MODULE}").run
        inspect.signature(run).bind(None, **{field.name: None for field in dataclasses.fields(part.job_type)[1:]})


def test_an_unknown_device_is_exit_code_3(render):
    assert "'no such device' (--device, Device(" in render(*SAMPLES, "--device", "no such device", code=3)[0]


def ended(*words, **options):
    """A command that another process has run."""
    command = [sys.executable, "-m", "solari_vk", *words]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, **options)


def test_no_driver_at_all_is_exit_code_3(tmp_path):
    none = str(tmp_path / "none.json")
    environment = os.environ | {"VK_DRIVER_FILES": none, "VK_ICD_FILENAMES": none, "SOLARI_VK_VALIDATION": "0"}
    ran = ended("info", env=environment, stdout=subprocess.DEVNULL)
    assert ran.returncode == 3, ran.stderr
    assert "Traceback" not in ran.stderr
    assert "driver" in ran.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_output():
    with open("/dev/full", "w") as full:
        ran = ended("settings", stdout=full)
    assert ran.returncode == 2
    assert ran.stderr == "solari-vk: the output can't be written: No space left on device\n"


@pytest.mark.parametrize("lens", ['{"camera_angle_x": Infinity}', '{"h": 1%s, "w": 5, "fl_x": 1}' % ("0" * 400)])
def test_numbers_that_are_no_lens(tmp_path, capsys, lens):
    (tmp_path / "cameras.json").write_text(json.dumps({**json.loads(lens), "frames": [{"transform_matrix": []}]}))
    assert main(["dataset", BOX, "-o", str(tmp_path / "views"), "--cameras", str(tmp_path / "cameras.json")]) == 2
    assert re.fullmatch(r"solari-vk: --cameras .*json: it lacks a field .*\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("render", "nothing.glb", "-o", "x.png"), "nothing.glb: there is no such file: check the path"),
        (("view", "nothing.glb"), "nothing.glb: there is no such file: check the path"),
        (
            ("render", BOX, "-o", "x.foo"),
            "x.foo: pictures are written as .png, .jpg, .jpeg, .exr, .npz, .npy, not '.foo'",
        ),
    ],
)
def test_wrong_paths_are_answered_before_anything_large_is_imported(words, said):
    program = (
        f"import sys; from solari_vk.cli import main; code = main({list(words)!r}); "
        "sys.exit(code + 10 * ('vulkan' in sys.modules or 'solari_vk.scene.model' in sys.modules))"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (2, f"solari-vk: {said}\n")


def test_the_version_and_a_pose_in_the_help(capsys):
    for words in (["--version"], ["render", "--help"]):
        with pytest.raises(SystemExit, match="0"):
            main(words)
    said = capsys.readouterr().out
    assert said.startswith(f"solari_vk {sv.__version__}\n")
    pose = re.search(r'\{"position".*?\}', said, re.DOTALL)
    assert sv.Camera.from_pose(json.loads(pose[0])).transform[2, 3] == 3


def test_ctrl_c_during_imports(monkeypatch, capsys):
    class Interrupts:
        def find_spec(self, name, *_):
            if name == "solari_vk.cli.commands":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "solari_vk.cli.commands")
    monkeypatch.setattr(sys, "meta_path", [Interrupts(), *sys.meta_path])
    assert main(["views"]) == 130
    assert capsys.readouterr() == ("", "solari-vk: interrupted, nothing more was written\n")


@pytest.mark.posix
def test_a_user_without_a_home_has_no_cache(monkeypatch):
    for name in ("HOME", "XDG_CACHE_HOME", "SOLARI_VK_CACHE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: 4_242_424)
    with pytest.warns(UserWarning, match="no home folder: set SOLARI_VK_CACHE"):
        assert disk_cache.folder() is None


# ---- lists ------------------------------------------------------------------------------------------


def test_info_names_what_there_is_what_is_missing_and_the_command(any_device, monkeypatch, capsys, tmp_path):
    """Of what is installed, a library fails, and one ends the process that tries it."""
    absent = {"pyoidn", "imageio_ffmpeg", "distributed"}
    (tmp_path / "DracoPy.so").write_bytes(b"no library")
    (tmp_path / "meshopt").mkdir()
    for name in ("__init__.py", "_core.so"):
        (tmp_path / "meshopt" / name).write_text("")
    dies = "import os, sys; any('meshopt' in path for path in sys.argv) and os._exit(9)\n"
    monkeypatch.setattr(info, "_LOAD", dies + info._LOAD)  # as a library may that is damaged
    for name in ("a.spv", "b.spv", "c.pipelines", "d.txt"):
        (tmp_path / name).write_bytes(bytes(500_000))
    monkeypatch.setenv("SOLARI_VK_CACHE", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("DracoPy", "meshopt"):  # other tests have imported the real ones
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr("solari_vk.cli.info.find_spec", lambda name: None if name in absent else find_spec(name))
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr("solari_vk.studio.viewer.window.glfw.init", lambda: 0)
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    for words in (
        "device 0",
        "compiler",
        "usable",
        "--rays query: ",
        "--rays pipeline: ",
        "--rays compute: ",
        "gbuffer=auto: ",
        f"cache: {tmp_path}, shaders: 2, pipeline caches: 1, 1.5 MB\n",
        f"meshes of Draco: installed, but it doesn't work: OSError: {tmp_path}/DracoPy.so: ",
        "meshes of meshopt: installed, but it doesn't work: it ends Python with code 9\n",
        "\nwindows: GLFW does not start (without a display: xvfb-run",
        *(f": missing: pip install 'solari-vk[{extra}]'\n" for extra in ("oidn", "video", "cluster")),
    ):
        assert words in said
    assert said.count(": missing: ") == 3
    project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text())["project"]
    assert {part.extra for part in info.PARTS} <= set(project["optional-dependencies"])


def test_render_names_the_way_to_trace(render):
    for rays, words in (("query", "ray queries"), ("pipeline", "ray pipelines"), ("compute", "compute shaders")):
        said, _ = render(*SAMPLES, "--rays", rays)
        assert f", by {words}\n" in said


def test_info_says_what_each_way_to_trace_lacks(monkeypatch, capsys):
    def info_of(card, code):
        monkeypatch.setattr("solari_vk.gpu.device.device.list_devices", lambda: [card])
        assert main(["info"]) == code
        return capsys.readouterr()

    lacks = {"query": ["VK_KHR_ray_query"], "pipeline": [], "compute": ["feature x"]}
    card = DeviceReport(0, "Card", "discrete gpu", "0", "driver 1", (1, 3, 0), [], lacks)
    said = info_of(card, 0).out
    assert "  usable\n  --rays query: lacks VK_KHR_ray_query\n  --rays pipeline: yes\n" in said
    assert "  --rays compute: lacks feature x\n" in said
    assert "  without --rays: by ray pipelines, because the device has no ray queries\n" in said
    faster = dataclasses.replace(card, missing_rays={**lacks, "compute": []})
    assert "  without --rays: by compute shaders, because it is the fastest way on cards w" in info_of(faster, 0).out
    monkeypatch.setenv("SOLARI_VK_RAYS", "query")
    assert "  without --rays: none, because SOLARI_VK_RAYS is 'query'\n" in info_of(card, 0).out
    monkeypatch.setenv("SOLARI_VK_RAYS", "pipeline")
    assert "  without --rays: by ray pipelines, because SOLARI_VK_RAYS is 'pipeline'\n" in info_of(card, 0).out
    said = info_of(dataclasses.replace(card, missing=["VK_KHR_ray_query or VK_KHR_ray_tracing_pipeline"]), 3)
    assert "  lacks: VK_KHR_ray_query or VK_KHR_ray_tracing_pipeline\n" in said.out
    assert "install a driver with Vulkan 1.3 and scalar block layouts: " in said.err


def test_lists_name_every_setting_and_view(capsys):
    assert main(["settings"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name}=" in said for name in FIELDS)
    assert main(["views"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(DEBUG_VIEWS)


@pytest.mark.parametrize("option", ["--camera", "--environment", "--animate", "--cameras", ""])
@pytest.mark.parametrize("kind", ["a pipe that nobody writes", "a device without an end"])
def test_inputs_that_are_no_regular_files_are_refused_at_once(any_device, tmp_path, capsys, option, kind):
    path, endless = tmp_path / "input.hdr", kind != "a pipe that nobody writes"
    path.symlink_to("/dev/zero") if endless else os.mkfifo(path)
    command = "dataset" if option == "--cameras" else "render"
    out = tmp_path / ("movie.mp4" if option == "--animate" else "x.png")
    arguments = [BOX, option, str(path)] if option else [str(path)]
    assert main([command, *arguments, "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert str(path) in said
    assert len(said.splitlines()) == 1
