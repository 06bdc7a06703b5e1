"""Texts and folders of strangers: within their budget, without a wait for what never ends, and by one error."""

from __future__ import annotations

import json
import os
import signal
import tracemalloc

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.budget import load_budget, string_bytes
from solari_vk.data.datasets.journal import Journal
from solari_vk.data.randomize import strict_yaml
from solari_vk.gpu.shaders import compiler, shaderc
from solari_vk.gpu.shaders.shader_cache import Sources

LAUGH = "a: &a [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join(['*' + last] * 10)}]\n" for last, name in zip("abcdefghi", "bcdefghij", strict=True)
)
RECIPES = {
    "aliases": LAUGH,
    "aliases as a key": LAUGH + "? *j\n: 1\n",
    "merged aliases": LAUGH.replace("[x,x,x,x,x,x,x,x,x,x]", "{<<: {}}").replace("[", "{<<: [").replace("]", "]}"),
    "an alias of itself": "a: &a [*a]\n",
    "values": "- [" + "1," * 400_000 + "]",
    "brackets": "[" * 50_000,
    "a long number": "a: 1" + ":10" * 100_000,
    "more than it may have": "#" * (2 << 20),
}
CAMERA, IMAGE = "1 PINHOLE 10 10 5 5 5 5\n", "1 {} 0 0 0 0 0 0 1 a.png\n\n"


@pytest.fixture(autouse=True)
def limited():
    """What waits for a pipe waits for ever."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it takes too long"))
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("name", RECIPES)
def test_recipes_do_not_explode(tmp_path, name):
    (tmp_path / "a.yaml").write_text(RECIPES[name])
    with pytest.raises(sv.SolariError, match=r"a\.yaml"):
        sv.Randomizer.load(tmp_path / "a.yaml")


def test_aliases_are_read():
    assert strict_yaml.read_yaml("a: &a [1, 2]\nb: [*a, *a]\n", "x")["b"] == [[1, 2], [1, 2]]


@pytest.mark.parametrize("w", ["1e-320", "0", "nan", "inf"])
def test_colmap_s_quaternions(tmp_path, w):
    (tmp_path / "cameras.txt").write_text(CAMERA)
    (tmp_path / "images.txt").write_text(IMAGE.format(w))
    with pytest.raises(sv.SolariError, match=r"images\.txt, line 1: "):
        sv.load_colmap(tmp_path)


def test_colmap_s_lines_take_no_memory(tmp_path):
    (tmp_path / "cameras.txt").write_text(CAMERA)
    (tmp_path / "images.txt").write_text("\n" * 300_000 + IMAGE.format(1))
    tracemalloc.start()
    try:
        assert [image.name for image in sv.load_colmap(tmp_path)] == ["a.png"]
        assert tracemalloc.get_traced_memory()[1] < 3_000_000
    finally:
        tracemalloc.stop()
    (tmp_path / "images.txt").write_text(IMAGE.format(1) * 3000)
    with load_budget(4 << 20), pytest.raises(sv.SolariError, match=r"images\.txt: its images would take"):
        sv.load_colmap(tmp_path)


@pytest.mark.parametrize("text", ["a" * 999, "é" * 999, "ü€" * 99, "x" * 999 + "\U0001f600"])
@pytest.mark.parametrize("escaped", [False, True])
def test_strings_are_charged_at_what_they_take(text, escaped):
    """One character above U+FFFF makes all of a string take four bytes each."""
    file = json.dumps(text, ensure_ascii=escaped).encode()
    taken = len(text) * {True: 1, False: 2 if max(text) <= "\uffff" else 4}[max(text) <= "\xff"]
    assert taken <= string_bytes(file)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "link to a device"])
def test_what_never_ends_is_not_read(tmp_path, kind):
    made = tmp_path / "made"
    make = {
        "pipe": lambda: os.mkfifo(made),
        "device": lambda: os.mknod(made, 0o20600, os.makedev(1, 5)),  # as /dev/zero
        "folder": made.mkdir,
        "link to a device": lambda: made.symlink_to("/dev/zero"),
    }
    try:
        make[kind]()
    except PermissionError:
        pytest.skip("only root makes devices")
    folder = tmp_path / "views"
    folder.mkdir()
    (folder / "transforms.json").write_text(
        json.dumps(
            {
                "w": 1,
                "h": 1,
                "camera_angle_x": 1,
                "layers": ["a"],
                "frames": [
                    {"file_path": "b.png", "layer_paths": {"a": "a.npy"}, "transform_matrix": np.eye(4).tolist()}
                ],
            }
        )
    )
    for name in ("a.npy", "b.png", "a.yaml", "images.txt", "labels.json", "x.comp"):
        (folder / name).symlink_to(made)
    (folder / "cameras.txt").write_text(CAMERA)
    views = sv.Views(folder)
    for attempt in (
        lambda: sv.Views(folder, ["a"])[0],
        lambda: sv.Views(folder, ["rgb"])[0],
        lambda: Journal(made, {}),
        lambda: sv.Randomizer.load(folder / "a.yaml"),
        lambda: sv.load_colmap(folder),
        lambda: compiler.compile_file_into_spirv(folder / "x.comp", "comp"),
        lambda: compiler.compile_into_spirv(f'#version 460\n#line 7 "{made}"\nwrong', "comp", "x.comp"),
    ):
        with pytest.raises(sv.SolariError):
            attempt()
    assert views.names == ("rgb", "a")


@pytest.mark.parametrize(
    ("header", "size"),
    [
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (1099511627776,), }", 8),
        ("{'descr': '<U0', 'fortran_order': False, 'shape': (1099511627776,), }", 0),
        ("{'descr': '|O', 'fortran_order': False, 'shape': (), }", 8),
        ("{", 8),
    ],
)
def test_arrays_take_what_they_hold(tmp_path, header, size):
    (tmp_path / "a.npy").write_bytes(
        b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(size)
    )
    with pytest.raises(sv.SolariError, match=r"a\.npy: can't be read as an array"):
        sv.Views.__dict__["_read"](None, tmp_path / "a.npy")


def test_names_that_no_file_can_have(tmp_path):
    long = "x" * 100_000
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes" / "x.comp").write_text(
        f'#version 460\n#include "{long}"\nvoid main() {{}}\n', encoding="latin-1"
    )
    with pytest.raises(sv.SolariError, match="passes"):
        compiler.compile_shader("passes/x.comp", root=tmp_path)
    assert Sources([tmp_path]).find(long) is None


def test_includes_end(tmp_path, monkeypatch):
    monkeypatch.setattr(shaderc, "LONGEST", 5.0)
    (tmp_path / "passes").mkdir()
    for number in range(30):
        (tmp_path / f"passes/{number}.glsl").write_text(f'#include "passes/{number + 1}.glsl"\n' * 2)
    (tmp_path / "passes/30.glsl").touch()
    (tmp_path / "passes/self.glsl").write_text('#include "passes/self.glsl"\n')
    for name in ("self", "0"):
        (tmp_path / "passes/x.comp").write_text(f'#version 460\n#include "passes/{name}.glsl"\nvoid main() {{}}\n')
        with pytest.raises(sv.SolariError, match="too many includes, or a file includes itself"):
            compiler.compile_shader("passes/x.comp", root=tmp_path)
