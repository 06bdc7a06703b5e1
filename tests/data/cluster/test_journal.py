"""The journal of a folder: which pictures it takes, which it refuses, and what it does with damage."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest

import solari_vk as sv
from solari_vk.data.cluster import Identity, RenderTask, Style, View, render_tasks
from solari_vk.data.datasets.journal import Journal
from solari_vk.data.datasets.tasks import File

STYLE = Style((8, 8), samples=1)


class Painter:
    """A pool whose pictures are bytes. comes_back: their files are sent; otherwise a worker kept them to itself."""

    identity = Identity("1", "code", "GPU", "driver", "query")

    def __init__(self, comes_back=True):
        self.comes_back, self.painted = comes_back, []

    def map(self, scene, jobs):
        for task in jobs:
            self.painted += [view.name for view in task.views]
            data = {view.name: repr(view.camera.pose()).encode() for view in task.views}
            sent = [content if self.comes_back else None for content in data.values()]
            hashes = [hashlib.sha256(content).hexdigest() for content in data.values()]
            yield task, dict(zip(data, map(File, hashes, sent), strict=True))


@pytest.fixture(scope="module")
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture
def paint(scene, tmp_path):
    """Render pictures from places along a line; returns those that weren't there."""

    def run(places, exposure=0.0):
        cameras = [sv.Camera.look_at((x, 1.0, -2.4), (1, 1, 1), ev100=exposure) for x in places]
        tasks = [RenderTask(STYLE, n, (View(f"{n}.npy", camera),)) for n, camera in enumerate(cameras)]
        pool = Painter()
        assert render_tasks(pool, scene, tasks, tmp_path / "journal.jsonl") == len(places)
        return pool.painted

    return run


def test_no_picture_replaces_another_one(paint, tmp_path):
    """One of another camera or exposure is refused; more of the same, and fewer, are taken."""
    assert paint([0, 1, 2]) == ["0.npy", "1.npy", "2.npy"]
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for places, exposure in (([0, 2], 0.0), ([0, 1, 2, 3], 1.0)):
        with pytest.raises(sv.SolariError, match=r"\.npy: is there already, with another camera"):
            paint(places, exposure)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert paint([0, 1]) == []
    assert paint([0, 1, 2, 3]) == ["3.npy"]
    (tmp_path / "1.npy").unlink()
    assert paint([0, 1, 2, 3]) == ["1.npy"]


def test_damage(paint, tmp_path):
    """A journal of something else, and a line that is no task."""
    journal = tmp_path / "journal.jsonl"
    paint([0])
    whole = journal.read_text()
    lines = ("1", "{}", '{"task": [], "files": {}}', '{"task": "a", "files": 1}')
    for text in ("[]", "{}", '{"made_of": 1}', "x", *(whole + line for line in lines)):
        journal.write_text(text + "\n")
        with pytest.raises(sv.SolariError, match=r"journal\.jsonl: is damaged"):
            paint([0])


def test_a_line_with_other_files(paint, tmp_path):
    """Whatever files a line names, only the task's own are looked at, and one that is missing is made anew."""
    assert paint([0, 1]) == ["0.npy", "1.npy"]
    journal = tmp_path / "journal.jsonl"
    lines = journal.read_text().splitlines()
    first = json.loads(lines[1])
    for files in ({}, {"\0": "a"}, {"../0.npy": first["files"]["0.npy"]}, {"0.npy": None}):
        journal.write_text("\n".join([lines[0], json.dumps({**first, "files": files}), lines[2], ""]))
        assert paint([0, 1]) == ["0.npy"]


def test_a_line_that_was_cut_off(paint, tmp_path, monkeypatch):
    """The other lines stay, also when nothing can be written: to repair the journal takes no room."""
    assert paint([0, 1]) == ["0.npy", "1.npy"]
    journal = tmp_path / "journal.jsonl"
    whole = journal.read_bytes()
    journal.write_bytes(whole[:-9])

    def fail(*_: object) -> None:
        raise sv.SolariError("full")

    with monkeypatch.context() as full:
        full.setattr(Journal, "_append", fail)
        with pytest.raises(sv.SolariError, match="full"):
            paint([0, 1])
    assert journal.read_bytes() == b"".join(whole.splitlines(True)[:2])
    assert paint([0, 1]) == ["1.npy"]
    assert journal.read_bytes() == whole


def test_files_that_workers_wrote_elsewhere(scene, tmp_path, monkeypatch):
    """A folder of the same path on another machine isn't shared."""
    monkeypatch.setattr("solari_vk.data.datasets.journal.LATE_SECONDS", 0.0)
    monkeypatch.setattr("solari_vk.data.datasets.journal.TICK_SECONDS", 0.0)
    task = RenderTask(STYLE, 0, (View("0.npy", scene.camera),), folder=str(tmp_path))
    with pytest.raises(sv.SolariError, match=r"0\.npy: a worker wrote it, but it isn't here"):
        render_tasks(Painter(comes_back=False), scene, [task], tmp_path / "journal.jsonl")
    lines = (tmp_path / "journal.jsonl").read_text().splitlines()
    assert [list(json.loads(line)) for line in lines] == [["made_of"]]


def test_a_folder_that_goes_away_while_workers_write(scene, tmp_path):
    folder = tmp_path / "views"
    folder.mkdir()

    class Removing(Painter):
        def map(self, scene, jobs):
            shutil.rmtree(folder)
            yield from super().map(scene, jobs)

    task = RenderTask(STYLE, 0, (View("0.npy", scene.camera),), folder=str(folder))
    with pytest.raises(sv.SolariError, match="views: can't be read any more: No such file"):
        render_tasks(Removing(comes_back=False), scene, [task], folder / "journal.jsonl")


def test_wrong_tasks_are_refused(scene, tmp_path):
    with pytest.raises(sv.SolariError, match="at least one task"):
        render_tasks(Painter(), scene, [], tmp_path / "journal.jsonl")
    assert not list(tmp_path.iterdir())
    with pytest.raises(sv.SolariError, match="give all views of a task a time, or none"):
        RenderTask(STYLE, 0, (View("0.npy", scene.camera, 1.0), View("1.npy", scene.camera)))
