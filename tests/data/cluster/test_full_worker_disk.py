"""Workers that write pictures themselves. A full disk: one error, no half-written file, and the next run goes on. And a
worker that is late: its picture replaces none of a later run."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.files import files_limited_to

import solari_vk as sv
from solari_vk.data.cluster import RenderTask, Style, View, render_tasks
from solari_vk.data.datasets import tasks as tasks_module
from solari_vk.output.picture import write_picture

SIZE = 24, 16


def tasks(folder, count=4):
    scene = sv.builtin("cornell_box")
    style = Style(SIZE, samples=1)
    return scene, [RenderTask(style, n, (View(f"{n}.npy", scene.camera),), folder=folder) for n in range(count)]


def fill_disk():
    """Runs in workers."""
    tasks_module.write_picture = save_on_full_disk


def empty_disk():
    """Runs in workers."""
    tasks_module.write_picture = write_picture


def running(dask_worker):
    """Runs in workers: the number of tasks that are under way, those called off too."""
    return dask_worker.state.executing_count


def save_on_full_disk(*arguments, **options):
    with files_limited_to(1000):
        write_picture(*arguments, **options)


@pytest.mark.parametrize("shared", [True, False], ids=["workers write", "files come back"])
def test_a_full_disk(pool, tmp_path, shared):
    """The message names the file; no file is left half written, and the next run renders what is missing."""
    scene, two = tasks(str(tmp_path) if shared else None, 2)
    _, four = tasks(str(tmp_path) if shared else None)
    journal = tmp_path / "journal.jsonl"
    assert render_tasks(pool, scene, two, journal) == 2
    whole = {path.name: path.read_bytes() for path in tmp_path.glob("*.npy")}
    if shared:
        pool.client.run(fill_disk)
    try:
        with files_limited_to(4000), pytest.raises(sv.SolariError, match=r"[23]\.npy: can't be written"):
            render_tasks(pool, scene, four, journal)
    finally:
        while any(pool.client.run(running).values()):
            time.sleep(0.05)
        if shared:
            pool.client.run(empty_disk)
    assert {path.name: path.read_bytes() for path in tmp_path.glob("*.npy")} == whole
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    assert render_tasks(pool, scene, four, journal) == 4
    assert {path.name for path in tmp_path.glob("*.npy")} == {f"{n}.npy" for n in range(4)}


@dataclass(frozen=True)
class Late(RenderTask):
    """Waits for a file, long after its run has called it off."""

    signals: str = ""

    def perform(self, session):
        Path(self.signals, "begun").touch()
        while not Path(self.signals, "go").exists():
            time.sleep(0.05)
        return super().perform(session)


def test_a_late_worker_replaces_no_picture_of_a_later_run(pool, tmp_path):
    """Its machine was asleep, say, while its task was called off and the folder was rendered anew."""
    folder = tmp_path / "views"
    folder.mkdir()
    scene, (task,) = tasks(str(folder), 1)
    late = Late(task.style, 0, task.views, folder=str(folder), signals=str(tmp_path))
    begun = tmp_path / "begun"
    assert render_tasks(pool, scene, [late], folder / "journal.jsonl", progress=lambda _: begun.exists()) == 0
    (folder / "0.npy").write_bytes(b"later")
    (tmp_path / "go").touch()
    while any(pool.client.run(running).values()):
        time.sleep(0.05)
    assert (folder / "0.npy").read_bytes() == b"later"
    assert {path.name for path in folder.iterdir()} == {"0.npy", "journal.jsonl"}
