"""The viewer's first picture: what is compiled is named, and the path tracer's picture comes before the other one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.viewer import waiting


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(waiting, "PATIENCE", 0.0)
    monkeypatch.setattr(waiting, "PAUSE", 1e9)


@pytest.fixture
def shown(open_viewer, device, monkeypatch):
    """A realtime viewer; a function that runs a frame and returns what was shown before it: titles and parts."""
    if device.properties.kind != "cpu":
        pytest.skip("only software devices compile for long")
    viewer = open_viewer(mode="realtime", overlay=False)
    titles, parts = [], []
    show = viewer._presenter.show
    monkeypatch.setattr(viewer.window, "set_title", titles.append)
    monkeypatch.setattr(viewer._presenter, "show", lambda given, draw: (parts.append(given), show(given, draw))[1])

    def step():
        viewer.step()
        return titles, parts

    return viewer, step


def test_the_path_tracer_is_shown_until_the_realtime_picture_is_there(shown, impatient):
    viewer, step = shown
    titles, parts = step()
    reference, realtime = viewer.pictures.reference, viewer.pictures.realtime
    assert reference.tracer.samples == 1
    early = [given for given in parts if given and given[0].image is reference.display]
    assert len(early) > 10, "one picture for each pipeline that is compiled"
    assert not parts[0], "nothing at first"
    assert [part.image for part in parts[-1]] == [realtime.resource("display")]
    pixels = reference.display.read()[..., :3]
    assert np.mean(pixels > 30) > 0.2, "it is a picture"
    assert any(re.search(r"compiling machine code 1 of \d+: gbuffer/begin \.\.\.$", title) for title in titles)
    assert viewer.device.on_compile is None
    count = len(titles), len(parts)
    step()
    assert (len(titles), len(parts)) == (count[0] + 1, count[1] + 1), "later frames don't wait"


def test_quick_compilation_needs_no_preview(shown, monkeypatch):
    monkeypatch.setattr(waiting, "PATIENCE", 1e9)
    viewer, step = shown
    step()
    assert viewer.pictures.reference is None


def test_a_preview_that_fails_is_given_up(shown, impatient, monkeypatch):
    viewer, step = shown
    calls = []

    def fail(*arguments):
        calls.append(arguments)
        raise SolariError("no memory")

    monkeypatch.setattr(viewer.pictures, "preview", fail)
    _, parts = step()
    assert len(calls) == 1
    assert [part.image for part in parts[-1]] == [viewer.pictures.realtime.resource("display")]
    assert not viewer.faults
