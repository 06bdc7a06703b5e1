"""`denoise`: sequences of frames that other renderers made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.cli.progress import Progress
from solari_vk.output.sequences.layers import find_layers
from solari_vk.output.sequences.motion import Convention, inverted
from solari_vk.output.sequences.source import Frame, add_camera_motion, find_files

pytest.importorskip("pyoidn")

FRAMES, HEIGHT, WIDTH = 7, 40, 56
SPEED = np.array([1.5, -0.75])  # pixels a frame, x to the right and y down
Arrays = dict[str, NDArray[np.float32]]


def wall(light: float = 1.0) -> tuple[NDArray[np.float32], Arrays]:
    """A textured wall that passes by: the truth, and noisy frames with their layers."""
    random = np.random.default_rng(3)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    truth, layers = [], {"albedo": [], "position": []}
    for frame in range(FRAMES):
        x, y = columns - SPEED[0] * frame, rows - SPEED[1] * frame
        waves = [np.sin(0.35 * x + phase) * np.cos(0.3 * y - phase) for phase in (0, 1, 2)]
        albedo = 0.5 + 0.3 * np.stack(waves, axis=-1)
        truth.append(light * albedo)
        layers["albedo"].append(albedo)
        layers["position"].append(np.stack([x, -y, 0 * x], axis=-1))
    arrays = {name: np.array(values, np.float32) for name, values in layers.items()}
    colors = np.array(truth, np.float32)
    noise = random.gamma(0.5, 2, (FRAMES, HEIGHT, WIDTH, 1))
    arrays["color"] = np.asarray(colors * noise, np.float32)
    arrays["normal"] = np.broadcast_to(np.float32([0, 0, 1]), colors.shape)
    arrays["depth"] = np.full(colors.shape[:3], 5, np.float32)
    arrays["motion"] = np.broadcast_to(np.float32(-SPEED), (*colors.shape[:3], 2)).copy()
    return colors, arrays


def given(arrays: Arrays, *names: str) -> Arrays:
    """The layers of some names, those of `denoise` but for the colors."""
    return {name: arrays[name] for name in names or ("albedo", "normal", "depth", "motion")}


def write_blender(folder: Path, arrays: Arrays, count: int = FRAMES) -> Path:
    """The frames as Cycles writes them: names of passes, and the pass Vector with y up."""
    folder.mkdir()
    for frame in range(count):
        vector = arrays["motion"][frame] * (1, -1)
        planes = {
            "Noisy Image": ("RGB", "color"),
            "Denoising Albedo": ("RGB", "albedo"),
            "Position": ("XYZ", "position"),
        }
        channels = {
            f"ViewLayer.{layer}.{component}": arrays[name][frame, ..., index].copy()
            for layer, (components, name) in planes.items()
            for index, component in enumerate(components)
        }
        # The next frame's vectors lead from there to here.
        for index, component in enumerate("XYZW"):
            channels[f"ViewLayer.Vector.{component}"] = np.float32(vector[..., index % 2])
        channels["ViewLayer.Noisy Image.A"] = np.full((HEIGHT, WIDTH), 0.5, np.float32)
        channels["ViewLayer.Combined.R"] = np.zeros((HEIGHT, WIDTH), np.float32)
        OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(folder / f"f_{frame + 1:04}.exr"))
    return folder


def read(path: Path) -> dict[str, NDArray[np.float32]]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def test_error_and_flicker_fall_below_those_of_single_frames() -> None:
    """With motion both ways in time, and with what cameras say in its place."""
    truth, arrays = wall()
    alone = sv.denoise(arrays["color"], window=0, **given(arrays)).frames - truth
    found = sv.denoise(arrays["color"], maps=True, **given(arrays))
    error = found.frames - truth
    assert (error**2).mean() < 0.4 * (alone**2).mean()
    assert (np.diff(error, axis=0) ** 2).mean() < 0.2 * (np.diff(alone, axis=0) ** 2).mean()
    # The maps say how large both are.
    assert 0.5 < np.sqrt((found.error**2).mean() / (error**2).mean()) < 1.5
    assert found.flicker[0].max() == 0
    assert found.flicker[1:].mean() < 0.5 * np.abs(np.diff(alone, axis=0)).mean()
    # Orthographic cameras: column x and row -y, which move against the wall.
    cameras = np.array([[[1, 0, 0, SPEED[0] * i], [0, -1, 0, SPEED[1] * i], [0, 0, 0, 1]] for i in range(FRAMES)])
    by_cameras = sv.denoise(arrays["color"], cameras=cameras, **given(arrays, "albedo", "normal", "position")).frames
    assert np.abs(by_cameras - found.frames).mean() < 0.01


def test_light_that_changes_isnt_averaged() -> None:
    """The first frames are a tenth as bright: what follows doesn't darken, and they don't brighten."""
    truth, arrays = wall()
    for values in (truth, arrays["color"]):
        values[:3] *= 0.1
    found = sv.denoise(arrays["color"], **given(arrays)).frames
    ratio = found.mean(axis=(1, 2, 3)) / truth.mean(axis=(1, 2, 3))
    assert np.all(np.abs(ratio - 1) < 0.12), ratio


def test_lamps_leave_no_dark_rims() -> None:
    """Splines through a lamp of a thousand times the light swing below zero beside it."""
    truth, arrays = wall()
    lamp = np.all(np.abs(arrays["position"] - np.float32([28, -20, 0])) < 3, axis=-1)
    arrays["color"] = np.where(lamp[..., None], np.float32(1000), truth)
    found = sv.denoise(arrays["color"], **given(arrays)).frames
    assert found.min() > 0.5 * truth.min()


@pytest.mark.parametrize(
    ("flip", "meant"),
    [((-1, -1), "from-previous,y-down"), ((1, -1), "to-previous,y-up"), ((-1, 1), "from-previous,y-up")],
)
@pytest.mark.parametrize("compared", ["position", "albedo"])
def test_swapped_signs_of_motion_are_found(flip: tuple[int, int], meant: str, compared: str) -> None:
    """The error names the convention by which the vectors are right."""
    _, arrays = wall()
    right = sv.denoise(arrays["color"], **given(arrays, compared, "motion")).frames
    arrays["motion"] = arrays["motion"] * np.float32(flip)
    with pytest.raises(sv.SolariError, match=f"point the wrong way.*convention='{meant},pixels'"):
        sv.denoise(arrays["color"], **given(arrays, compared, "motion"))
    again = sv.denoise(arrays["color"], convention=meant, **given(arrays, compared, "motion")).frames
    np.testing.assert_array_equal(again, right)


def test_a_convention_is_that_of_the_first_pair(tmp_path: Path) -> None:
    """The second pair is about the other neighbor; Blender's has the other sign."""
    _, arrays = wall()
    motion = arrays.pop("motion")
    right = sv.denoise(arrays["color"], motion=np.concatenate([motion, -motion], -1), **given(arrays, "albedo")).frames
    swapped = np.concatenate([-motion, motion], -1)
    found = sv.denoise(arrays["color"], motion=swapped, convention="to-next", **given(arrays, "albedo")).frames
    np.testing.assert_array_equal(found, right)
    with pytest.raises(sv.SolariError, match="the first pair is right, only the second one"):
        sv.denoise(arrays["color"], motion=np.concatenate([motion, motion], -1), **given(arrays, "albedo"))
    folder = write_blender(tmp_path / "in", arrays | {"motion": motion}, 3)
    sv.denoise(folder, tmp_path / "out", convention="to-previous,y-up")
    with pytest.raises(sv.SolariError, match="convention='to-previous,y-up,pixels'"):
        sv.denoise(folder, tmp_path / "other", convention="to-previous")


def test_negative_light_isnt_an_error() -> None:
    assert np.isfinite(sv.denoise(np.full((1, 16, 16, 3), -0.5, np.float32)).frames).all()


def test_arguments_of_other_kinds_are_said() -> None:
    """Before the work; a list of arrays is a sequence."""
    color = np.ones((2, 16, 16, 3), np.float32)
    np.testing.assert_array_equal(sv.denoise(list(color)).frames, sv.denoise(color).frames)
    cases: list[tuple[object, dict[str, object], str]] = [
        (None, {}, "give frames"),
        ([color[0], color[1, :8]], {}, "of one shape"),
        (color, {"convention": 3}, "words with commas"),
        (color, {"layers": "albedo"}, "layers are names"),
        (color, {"progress": True}, "progress is a function"),
        (color, {"cameras": "c.npy"}, "must be matrices"),
        (color, {"cameras": np.zeros((2, 3, 4))}, "singular"),
    ]
    for frames, options, message in cases:
        with pytest.raises(sv.SolariError, match=message):
            sv.denoise(frames, **options)


def test_sky_moves_with_the_cameras() -> None:
    """Where depths are infinite, or 0, only the cameras' turns move the picture."""
    camera = np.array([[100, 0, 8, 0], [0, 100, 8, 0], [0, 0, 1, 0.0]])
    moved = camera + np.array([[0, 0, 0, 50], [0] * 4, [0] * 4])
    for depth, motion in ((np.inf, 0), (0, 0), (10, 5)):
        frame = Frame(np.ones((16, 16, 3), np.float32), depth=np.full((16, 16), depth, np.float32))
        add_camera_motion(frame, 1, np.array([moved, camera]))
        np.testing.assert_allclose(frame.motion, np.broadcast_to([motion, 0], (16, 16, 2)), atol=1e-4)


def test_numbers_of_files(tmp_path: Path) -> None:
    for name in ("shot_0001_v2", "shot_0002_v2", "shot_0003_v2", "shot_0003_old_v2"):
        (tmp_path / f"{name}.exr").touch()
    shots = ["shot_0001_v2.exr", "shot_0002_v2.exr", "shot_0003_v2.exr"]
    assert [path.name for path in find_files(tmp_path / "shot_####_v2.exr")] == shots
    assert [path.name for path in find_files(tmp_path / "shot_000?_v2.exr")] == shots
    (tmp_path / "still.exr").touch()
    assert [path.name for path in find_files(tmp_path / "still.exr")] == ["still.exr"]
    for number in (1, 3, 1690000000123456789):
        (tmp_path / f"t{number}.exr").touch()
    with pytest.raises(sv.SolariError, match=r"missing: 5, 7, 9, 11, 13, 15, 17, 19 \.\.\.:"):
        find_files(tmp_path / "t*.exr")


def test_own_motion_and_flicker_without_window(tmp_path: Path) -> None:
    """The layer guides_motion is in uv; of two layers `forward` alone serves too."""
    _, arrays = wall()
    options = {"window": 0, "maps": True}
    expected = sv.denoise(arrays["color"], **options, **given(arrays, "albedo", "motion"))
    assert expected.flicker[1:].mean() > 0
    for layer, vectors in (
        ("guides_motion", arrays["motion"] / np.float32([WIDTH, HEIGHT])),
        ("forward", arrays["motion"]),
    ):
        folder = tmp_path / layer
        folder.mkdir()
        for index in range(3):
            layers = {layer: vectors[index], "albedo": arrays["albedo"][index]}
            sv.save_image(folder / f"{index}.exr", arrays["color"][index], layers=layers)
        if layer == "forward":
            with pytest.raises(sv.SolariError, match="convention='from-next,y-down,pixels'"):
                sv.denoise(folder, tmp_path / f"{layer}_out", convention="to-previous", **options)
            options["convention"] = "from-next"
        files = sv.denoise(folder, tmp_path / f"{layer}_out", **options).files
        np.testing.assert_allclose(read(files[1])["flicker"], expected.flicker[1], atol=1e-2)


def test_conventions() -> None:
    vectors = np.float32([[[0.5, 0.25]] * 8] * 4)
    assert Convention.parse("uv").offsets(vectors)[0, 0].tolist() == [4, 1]
    assert Convention.parse("from-next,y-up,ndc").offsets(vectors)[0, 0].tolist() == [-2, 0.5]
    np.testing.assert_allclose(inverted(vectors), -vectors)
    with pytest.raises(sv.SolariError, match="at most one each"):
        Convention.parse("y-up,sideways")


# Channels that renderers write; XYZ stands for three of them.
CYCLES = "V.Combined.RGBA V.Depth.Z V.Normal.XYZ V.DiffCol.RGB V.Vector.XYZW"
MITSUBA = ".RGBA dd.y.T nn.XYZ albedo.RGB"
PBRT = ".RGB Albedo.RGB P.XYZ N.XYZ Ns.XYZ"
ARNOLD = ".RGBA N.XYZ P.XYZ .Z motionvector.XY denoise_albedo.RGB diffuse.RGB"
VRAY = ".RGBA bump_normals.XYZ diffuse_filter.RGB zdepth.Z velocity.XY"
RENDERMAN = "Ci.rgb .a albedo.rgb normal.rgb .z backward.rg forward.rg"


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        (CYCLES, {"color": "V.Combined.R", "albedo": "V.DiffCol.R", "motion": "V.Vector.X"}),
        (MITSUBA, {"color": "R", "albedo": "albedo.R", "normal": "nn.X", "depth": "dd.y.T"}),
        (PBRT, {"color": "R", "albedo": "Albedo.R", "normal": "Ns.X", "position": "P.X"}),
        (ARNOLD, {"albedo": "denoise_albedo.R", "normal": "N.X", "depth": "Z", "motion": "motionvector.X"}),
        (VRAY, {"albedo": "diffuse_filter.R", "normal": "bump_normals.X", "depth": "zdepth.Z", "motion": "velocity.X"}),
        (RENDERMAN, {"color": "Ci.r", "depth": "z", "motion": "backward.r", "motion_next": "forward.r"}),
    ],
)
def test_layers_are_found_by_the_names_of_renderers(channels: str, expected: dict[str, str]) -> None:
    words = [word.rpartition(".") for word in channels.split()]
    names = [f"{layer}.{component}".lstrip(".") for layer, _, every in words for component in every]
    found = find_layers(names, {}, "a.exr").channels
    assert {name: found[name][0] for name in expected} == expected


def test_files_resume_and_belong_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Blender's files give what their arrays give; frames that are there are kept, those of others refused."""
    _, arrays = wall()
    folder, out = write_blender(tmp_path / "in", arrays), tmp_path / "out"
    words = ["denoise", str(folder / "f_####.exr"), "-o", str(out), "--maps"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "color: ViewLayer.Noisy Image" in printed
    assert "no normal: edges" in printed
    assert "no motion" not in printed
    expected = sv.denoise(arrays["color"], maps=True, **given(arrays, "albedo", "position", "motion"))
    last = read(out / "f_0007.exr")
    np.testing.assert_allclose(np.stack([last[c] for c in "RGB"], axis=-1), expected.frames[6], atol=1e-5)
    np.testing.assert_allclose(last["error"], expected.error[6], atol=1e-4)
    np.testing.assert_allclose(last["flicker"], expected.flicker[6], atol=1e-4)
    assert np.all(last["A"] == 0.5)
    times = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    (out / "f_0003.exr").unlink()
    assert main(words) == 0
    same = [name for name, time in times.items() if (out / name).stat().st_mtime_ns == time]
    assert sorted(same) == [f"f_000{i}.exr" for i in (1, 2, 4, 5, 6, 7)]
    np.testing.assert_allclose(read(out / "f_0003.exr")["flicker"], expected.flicker[2], atol=1e-4)
    capsys.readouterr()
    assert main([*words, "--window", "2"]) == 2
    assert "made of other frames or with other settings" in capsys.readouterr().err
    assert main([*words, "--window", "2", "--overwrite"]) == 0
    # A file that was cut off is said to be that, and alone replaced.
    cut = out / "f_0002.exr"
    cut.write_bytes(cut.read_bytes()[:-100])
    times = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert main([*words, "--window", "2"]) == 2
    assert "isn't a whole EXR file" in capsys.readouterr().err
    assert main([*words, "--window", "2", "--overwrite"]) == 0
    assert [name for name, time in times.items() if (out / name).stat().st_mtime_ns != time] == [cut.name]


def test_ctrl_c_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is finished stays, and the same command goes on there."""
    _, arrays = wall()
    words = ["denoise", str(write_blender(tmp_path / "in", arrays, 3)), "-o", str(tmp_path / "out"), "--overwrite"]
    show = Progress.__call__

    def interrupted(self: Progress, done: int) -> None:
        self._interrupt()
        show(self, done)

    with monkeypatch.context() as context:
        context.setattr(Progress, "__call__", interrupted)
        assert main(words) == 1
    assert "1 of 3 frames" in capsys.readouterr().out
    first = tmp_path / "out" / "f_0001.exr"
    time = first.stat().st_mtime_ns
    assert main(words) == 0
    assert first.stat().st_mtime_ns == time


def test_what_cant_be_denoised_is_said(tmp_path: Path) -> None:
    _, arrays = wall()
    folder, out = write_blender(tmp_path / "in", arrays, 4), tmp_path / "out"
    gray = np.ones((8, 8), np.float32)
    cases = {
        "has 8x8 pixels": {"ViewLayer.Noisy Image.R": gray},
        "lacks ViewLayer.Denoising Albedo.R": {},
        "color has values that aren't finite in 1 pixels, the first at column 5, row 3": {},
    }
    for message, planes in cases.items():
        channels = read(folder / "f_0001.exr")
        if "8x8" in message:
            channels = dict.fromkeys(channels, planes["ViewLayer.Noisy Image.R"])
        elif "lacks" in message:
            del channels["ViewLayer.Denoising Albedo.R"]
        else:
            channels["ViewLayer.Noisy Image.G"][3, 5] = np.nan
        OpenEXR.File({}, channels).write(str(folder / "f_0003.exr"))
        with pytest.raises(sv.SolariError, match=message):
            sv.denoise(folder, out)
    (folder / "f_0003.exr").write_bytes(b"PNG")
    with pytest.raises(sv.SolariError, match="is no EXR file"):
        sv.denoise(folder, out)
    (folder / "f_0003.exr").unlink()
    with pytest.raises(sv.SolariError, match="frames are missing: 3:"):
        sv.denoise(folder, out)
    (folder / "f_0004.exr").unlink()
    for arguments, message in (
        ((folder, folder), {"match": "the sequence itself"}),
        ((folder, None), {"match": "give the folder"}),
        ((tmp_path / "none", out), {"match": "no EXR files"}),
    ):
        with pytest.raises(sv.SolariError, **message):
            sv.denoise(*arguments)
    with pytest.raises(sv.SolariError, match="there is no layer 'Albed'"):
        sv.denoise(folder, out, layers={"albedo": "Albed"})
    with pytest.raises(sv.SolariError, match="depth has the shape"):
        sv.denoise(arrays["color"], depth=arrays["normal"])
    with pytest.raises(sv.SolariError, match="not sRGB codes"):
        sv.denoise(np.zeros((2, 4, 4, 3), np.uint8))
    with pytest.raises(sv.SolariError, match="finite matrices"):
        sv.denoise(arrays["color"], cameras=np.zeros((2, 3, 4)))
