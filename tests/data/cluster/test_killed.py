"""`solari-vk dataset`, killed at any moment: the same command goes on, and ends with the files of a fresh run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from solari_vk.cli import main

VIEWS, KILLS = 12, 50
WORDS = ["dataset", "builtin:cornell_box", "--size", "32x32", "--samples", "4", "--views", str(VIEWS), "--aov", "depth"]


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def killed(folder, pictures, seconds):
    """Start the command, kill it this long after the folder has so many pictures, unless it is done before."""
    command = [sys.executable, "-m", "solari_vk", *WORDS, "-o", str(folder)]
    environment = {**os.environ, "SOLARI_VK_VALIDATION": "0"}
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment)
    while process.poll() is None and len(list(folder.glob("[0-9]*.png"))) < pictures:
        time.sleep(0.002)
    time.sleep(seconds)
    process.kill()
    return process.wait()


@pytest.mark.slow
def test_fifty_kills(any_device, tmp_path):
    rng = np.random.default_rng(30)
    there = []
    ended = []
    assert main([*WORDS, "-o", str(tmp_path / "fresh")]) == 0
    fresh = contents(tmp_path / "fresh")
    for _ in range(KILLS):
        folder = tmp_path / "views"
        # Before pictures it imports and compiles for seconds; then a picture takes some milliseconds.
        pictures = int(rng.integers(0, VIEWS))
        ended.append(killed(folder, pictures, rng.uniform(0, 0.02 if pictures else 2)))
        left = contents(folder) if folder.exists() else {}
        pictures = {name for name in left if name.endswith(".png") and not name.startswith(".")}
        there.append(len(pictures))
        assert all(left[name] == fresh[name] for name in pictures)
        assert main([*WORDS, "-o", str(folder)]) == 0
        assert contents(folder) == fresh
        shutil.rmtree(folder)
    print(f"{ended.count(-9)} of {KILLS} runs were killed; pictures were there: {there}")
    assert ended.count(-9) > 0.9 * KILLS
    assert sum(count > 0 for count in there) > 0.6 * KILLS


def test_what_a_killed_process_had_not_finished_goes(any_device, tmp_path):
    """A file that was being written has a name of its own, which nobody else needs."""
    (tmp_path / "views").mkdir()
    for name in (".00001.0123456789abcdef.png", ".mine.png"):
        (tmp_path / "views" / name).write_bytes(b"half")
    assert main([*WORDS, "--views", "2", "-o", str(tmp_path / "views")]) == 0
    hidden = {name for name in contents(tmp_path / "views") if name.startswith(".")}
    assert hidden == {".mine.png"}
