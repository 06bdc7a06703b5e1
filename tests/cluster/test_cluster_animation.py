"""Animations: blocks that any worker renders from the frames before them, and movies of their pictures."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.cluster import Style, View, blocks
from solari_vk.cluster.device_session import DeviceSession, pack
from solari_vk.output.animation import orbit

SIZE = 24, 16


def orbiting(count, frames=2, warm_up=3):
    scene = sv.builtin("cornell_box")
    cameras = orbit(scene.camera, scene.bounds.center, count, 20.0)
    style = Style(SIZE, seed=5, layers=("guides_motion",), settings=sv.Settings(), frames=frames, warm_up=warm_up)
    return scene, style, [View(f"{number}.npy", camera) for number, camera in enumerate(cameras)]


def test_blocks_begin_with_the_frames_before_them():
    _, style, views = orbiting(7)
    first, second, third = blocks(style, views, length=3)
    names = [[view.name[0] for view in task.before] for task in (first, second, third)]
    assert names == [["0", "0", "0"], ["1", "2", "2"], ["4", "5", "5"]]
    assert [[view.name[0] for view in task.views] for task in (first, second, third)] == [[*"012"], [*"345"], ["6"]]
    _, cold, _ = orbiting(7, warm_up=0)
    assert [[view.name[0] for view in task.before] for task in blocks(cold, views, length=3)] == [[], ["2"], ["5"]]


@pytest.mark.slow
def test_a_block_is_the_same_after_any_other(device):
    """On a session that rendered another block before, and on a fresh one. Where frames before a block are all that its
    light remembers, it shows the same as one long run."""
    scene, style, views = orbiting(6)
    key, data = pack(scene)
    results = []
    for order in ((0, 1), (1, 0)):
        session = DeviceSession(device)
        session.show(key, data, None)
        tasks = blocks(style, views, length=3)
        files = {}
        for number in order:
            files |= tasks[number].perform(session)
        results.append({name: file.sha256 for name, file in files.items()})
        session.forget()
    assert results[0] == results[1]
    assert len(results[0]) == 12


@pytest.mark.slow
def test_the_command_renders_a_movie_with_workers(pool, tmp_path, capsys):
    """The pictures are those of one worker; the folder of pictures goes when the movie is there."""
    command = ["render", "builtin:cornell_box", "--size", "24x16", "--animate", "orbit:20", "--frames", "26",
               "--average", "1", "--warm-up", "2"]  # fmt: skip
    address = ["--cluster", pool.client.scheduler.address]
    path = tmp_path / "movie.gif"
    assert main([*command, *address, "-o", str(path)]) == 0, capsys.readouterr().err
    assert "26 of 26 pictures" in capsys.readouterr().err
    assert Image.open(path).n_frames == 26
    assert [entry.name for entry in tmp_path.iterdir()] == ["movie.gif"]
    for workers, name in ((address, "two"), (["--workers", "1"], "one")):
        (tmp_path / name).mkdir()
        assert main([*command, *workers, "-o", str(tmp_path / name / "p.npy")]) == 0, capsys.readouterr().err
    for number in range(26):
        assert np.array_equal(*(np.load(tmp_path / name / f"p.{number:04}.npy") for name in ("one", "two")))
    lines = [json.loads(line) for line in (tmp_path / "one" / "p.jsonl").read_text().splitlines()]
    assert len(lines) == 3  # what the pictures are made of, and two blocks
