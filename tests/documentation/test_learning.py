"""The guide to reinforcement learning: its worlds are lit, moved and cut, and its loop learns where PyTorch is."""

from __future__ import annotations

import numpy as np
import pytest
from test_pages import DOCS, blocks

WORLDS, LOOP = blocks(DOCS / "guides/learning.md", "python")


def run(program, names):
    exec(compile(program, "learning.md", "exec"), names)
    return names


def test_worlds_are_seen_and_move(lent_device):
    assert "16, (32, 32)" in WORLDS
    names = run(WORLDS.replace("16, (32, 32)", "4, (16, 16)"), {})
    with names["device"], names["batch"]:
        first = np.array(names["seen"])
        assert first.shape == (4, 16, 16, 3)
        assert len({view.tobytes() for view in first}) == 4  # lamps and colors of their own
        moved = np.tile(names["start"], (4, 1, 1))
        moved[:, 0, 3] += 0.4
        assert (np.abs(names["observe"](moved, np.arange(4) > 1) - first).max(axis=(1, 2, 3)) > 0.02).all()


@pytest.mark.slow
def test_the_loop_learns(lent_device):
    """At first pushes are noise; later they bring the block nearer."""
    pytest.importorskip("torch")
    names = run(WORLDS, {})
    with names["device"], names["batch"]:
        earned = [float(reward) for reward in run(LOOP, names)["earned"]]
    assert np.mean(earned[-50:]) > np.mean(earned[:20]) + 0.01
    assert np.mean(earned[-50:]) > 0


def test_the_loop_is_short():
    assert len(LOOP.splitlines()) <= 30
    compile(LOOP, "learning.md", "exec")
