"""The disk is full at each write of a command, in turn: one error that names the file and the remedy, nothing is left
half written, what was there stays, what was rendered is kept, and the next call works.

A file that is being written may get no larger than a limit (RLIMIT_FSIZE), whoever writes it: Python or a library.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.files import files_limited_to

import solari_vk as sv
from solari_vk.base import files
from solari_vk.cli import main
from solari_vk.data.datasets.journal import Journal
from solari_vk.lab.measure.report import Report
from solari_vk.output.fallback import frames_folder, write_with_fallback

SMALL = ["builtin:cornell_box", "--size", "8x8"]
REFERENCE = [*SMALL, "--mode", "reference", "--samples", "1"]
ANIMATION = [*SMALL, "--mode", "realtime", "--animate", "orbit", "--frames", "2", "--warm-up", "0", "--average", "1"]
RENAMING = -1  # in place of the number of bytes that fit


class Disk:
    """Notes which files are written, with their sizes, and has no room for one of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.written: list[tuple[Path, int]] = []
        self.begin()
        beside = files._beside
        remove = files._remove
        replace = os.replace
        append = Journal._append

        def start(path: Path) -> Path:
            self.written.append((path, 0))
            if self._number == len(self.written) - 1 and self._fitting != RENAMING:
                self._full = files_limited_to(self._fitting)
                self._full.__enter__()
            return beside(path)

        def end(temporary: Path) -> None:
            if self._full is not None:
                self._full.__exit__(None, None, None)
                self._full = None
            if temporary.exists():
                self.written[-1] = self.written[-1][0], temporary.stat().st_size
            remove(temporary)

        def rename(temporary: Path, path: Path) -> None:
            if self._number == len(self.written) - 1 and self._fitting == RENAMING:
                raise OSError(28, "No space left on device")
            self.written[-1] = path, temporary.stat().st_size
            replace(temporary, path)

        def note(journal: Journal, text: str) -> None:
            path = journal._path
            self.written.append((path, len(text)))
            before = path.stat().st_size if path.exists() else 0
            full = self._number == len(self.written) - 1
            with files_limited_to(before + max(self._fitting, 0) if full else before + len(text)):
                append(journal, text)

        for owner, name, patch in (
            (files, "_beside", start),
            (files, "_remove", end),
            (os, "replace", rename),
            (Journal, "_append", note),
        ):
            monkeypatch.setattr(owner, name, patch)

    def begin(self, number: int = -1, fitting: int = 0) -> None:
        """From now on, this number of bytes of the file of this number fit."""
        self.written.clear()
        self._number = number
        self._fitting = fitting
        self._full = None


@pytest.fixture
def disk(monkeypatch):
    return Disk(monkeypatch)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """The folder for temporary files."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def faults(sizes: list[tuple[Path, int]], renaming: bool = False) -> list[tuple[int, int]]:
    """The numbers of files, each with the bytes of it that fit: all but one; and all, so that renaming fails."""
    kinds = (lambda size: size - 1, lambda size: RENAMING)[: 1 + renaming]
    return [(number, fitting(size)) for number, (_, size) in enumerate(sizes) for fitting in kinds]


@pytest.mark.parametrize("output", ["a.exr", "a.png"])
def test_a_picture(lent_device, tmp_path, disk, elsewhere, capsys, output):
    """The older files were rendered with another seed. A picture that was rendered is in another folder."""
    place = tmp_path / "out"
    place.mkdir()
    command = ["render", *REFERENCE, "--aov", "depth,albedo", "-o", str(place / output)]
    assert main([*command, "--seed", "7"]) == 0
    old = contents(place)
    disk.begin()
    assert main(command) == 0
    new, sizes = contents(place), list(disk.written)
    assert len(sizes) == 1 + len(new)
    assert all(old[name] != new[name] for name in new if "depth" not in name and "albedo" not in name)
    for number, fitting in faults(sizes, renaming=True):
        if number == 0 and fitting == RENAMING:
            continue  # the trial at the start is not renamed
        for name, content in old.items():
            (place / name).write_bytes(content)
        disk.begin(number, fitting)
        capsys.readouterr()
        assert main(command) == 2
        said = capsys.readouterr().err
        failed = sizes[number][0]
        assert re.search(rf"^solari-vk: {re.escape(str(failed))}: can't be written: .*: make room", said, re.M), said
        assert said.count("solari-vk:") == 1
        assert "Traceback" not in said
        done = [path.name for path, _ in sizes[1:number]]
        assert contents(place) == {name: new[name] if name in done else old[name] for name in old}
        if number == 0:
            assert "rendering" not in said, "a full disk is noticed before anything is rendered"
            assert not any(elsewhere.iterdir())
            continue
        found = re.search(r"the picture is in (\S+)$", said, re.M)
        assert found, said
        assert contents(Path(found[1])) == new
    disk.begin()
    assert main(command) == 0
    assert contents(place) == new


@pytest.mark.slow
def test_a_data_set(lent_device, tmp_path, disk, elsewhere, capsys):
    """The next call renders what is missing."""
    command = ["dataset", *REFERENCE, "--views", "2", "--aov", "depth", "-o"]
    whole = tmp_path / "whole"
    assert main([*command, str(whole)]) == 0
    sizes, expected = list(disk.written), contents(whole)
    assert {path.name for path, _ in sizes} == set(expected)
    for number, fitting in faults(sizes):
        place = tmp_path / str(number)
        disk.begin(number, fitting)
        capsys.readouterr()
        assert main([*command, str(place)]) == 2
        said = capsys.readouterr().err
        failed = sizes[number][0].name
        assert re.search(rf"{re.escape(failed)}: can't be written: .*: make room there", said), said
        assert said.count("solari-vk:") == 1
        left = contents(place)
        assert all(left[name] == expected[name] for name in left if name != "views.jsonl")
        assert expected["views.jsonl"].startswith(left.get("views.jsonl", b""))
        disk.begin()
        assert main([*command, str(place)]) == 0
        assert contents(place) == expected
        finished = max(left.get("views.jsonl", b"").count(b"\n") - 1, 0)
        assert [path.suffix for path, _ in disk.written].count(".png") == 2 - finished
    assert not any(elsewhere.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("output", ["a.gif", "a.mp4", "a.npy"])
def test_an_animation(lent_device, tmp_path, disk, elsewhere, capsys, output):
    """What was rendered stays: numbered pictures where they are, those of a movie in the folder for temporary files."""
    place = tmp_path / "out"
    place.mkdir()
    command = ["render", *ANIMATION, "-o", str(place / output)]
    assert main(command) == 0
    sizes, new = list(disk.written), contents(place)
    is_movie = output != "a.npy"
    assert [path.suffix for path, _ in sizes] == [
        Path(output).suffix,
        *([".png"] * 2 if is_movie else []),
        *([Path(output).suffix] * (1 if is_movie else 2)),
    ]
    assert not any(elsewhere.iterdir())
    for number, fitting in faults(sizes):
        for path in place.iterdir():
            path.unlink()
        disk.begin(number, fitting)
        capsys.readouterr()
        assert main(command) == 2
        said = capsys.readouterr().err
        assert f"{sizes[number][0].name}: can't be written: " in said
        assert said.count("solari-vk:") == 1
        done = [path.name for path, _ in sizes[1:number]]
        assert contents(place) == ({} if is_movie else {name: new[name] for name in done})
        if number:
            kept = Path(re.findall(r"(?:the picture is|the pictures so far are) in (\S+)$", said, re.M)[-1])
            assert {path.name for path in kept.iterdir()} >= (set(done) if is_movie else {sizes[number][0].name})
    disk.begin()
    assert main(command) == 0
    assert contents(place) == new


def test_a_page_of_measurements(device, tmp_path, disk):
    """The page before stays, and a run that can't write its page ends before it measures."""
    page = tmp_path / "page.md"
    report = Report(device, page, "Figures", ())
    report.table("One", ("a", "b"), [("x", "1")])
    before = page.read_bytes()
    for fitting in (0, len(before) - 1, RENAMING):
        disk.begin(0, fitting)
        with pytest.raises(sv.SolariError, match=r"page\.md: can't be written: .*: make room there"):
            report.table("Two", ("a", "b"), [("x", "2")])
        assert contents(tmp_path) == {"page.md": before}
    disk.begin(0, 0)
    with pytest.raises(sv.SolariError, match=r"page\.md: can't be written"):
        Report(device, page, "Figures", ())
    assert contents(tmp_path) == {"page.md": before}


@pytest.mark.parametrize("shape", [(4, 4), (200, 300)])
@pytest.mark.parametrize("name", ["a.exr", "a.npy"])
def test_the_end_of_a_picture(tmp_path, name, shape):
    """OpenEXR and numpy don't report it when what they have buffered can't be written: all of a small or black .exr."""
    path, black = tmp_path / name, np.zeros((*shape, 3), np.float32)
    sv.save_image(path, black)
    whole = path.read_bytes()
    for size in (*range(0, len(whole), len(whole) // 40), len(whole) - 1):
        with (
            files_limited_to(size),
            pytest.raises(sv.SolariError, match=r"can't be written: (No space|File too large)"),
        ):
            sv.save_image(path, black)
        assert contents(tmp_path) == {name: whole}


def fail(path: Path) -> None:
    raise sv.SolariError(f"{path}: full")


def test_a_picture_that_fits_nowhere(tmp_path, elsewhere, monkeypatch):
    with pytest.raises(sv.SolariError, match=r"^a\.png: full$"):
        write_with_fallback(Path("a.png"), fail)
    assert not any(elsewhere.iterdir())

    def none(**_: object) -> str:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr(tempfile, "mkdtemp", none)
    with pytest.raises(sv.SolariError, match=r"^a\.png: full$"):
        write_with_fallback(Path("a.png"), fail)
    with pytest.raises(sv.SolariError, match="No usable temporary directory found: set TMPDIR"), frames_folder():
        pass


@pytest.mark.parametrize("error", [sv.SolariError, sv.DeviceError])
def test_frames_of_a_movie_are_kept_when_there_are_some(elsewhere, error):
    def leave(write: Callable[[Path], object]) -> None:
        with frames_folder() as folder:
            write(folder / "a.png")
            raise error("lost")

    with pytest.raises(error, match=r"^lost$"):
        leave(lambda path: None)
    assert not any(elsewhere.iterdir())
    with pytest.raises(error, match=r"^lost; the pictures so far are in .*elsewhere.solari-vk-\w+$"):
        leave(lambda path: path.write_bytes(b"picture"))
    assert list(contents(elsewhere).values()) == [b"picture"]


def test_a_folder_that_can_not_be_made(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(sv.SolariError, match="can't be made: "):
        files.make_folder(tmp_path / "file" / "folder")
