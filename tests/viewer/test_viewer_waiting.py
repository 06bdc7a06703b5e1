"""The viewer's first picture: what is compiled is named, and the path tracer's picture comes before the other one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.viewer import waiting
from solari_vk.viewer.presenter import Presenter


@pytest.fixture
def first_frame(open_viewer, device, monkeypatch):
    """A realtime viewer; a function that runs a frame and returns what was shown before it: titles and parts."""
    if device.properties.kind != "cpu":
        pytest.skip("only software devices compile for long")
    titles, parts, show = [], [], Presenter.show
    monkeypatch.setattr(Presenter, "show", lambda self, given, draw: (parts.append(given), show(self, given, draw))[1])
    viewer = open_viewer(mode="realtime", overlay=False)
    monkeypatch.setattr(viewer.window, "set_title", titles.append)

    def step(patience):
        monkeypatch.setattr(waiting, "PATIENCE", patience)
        monkeypatch.setattr(waiting, "PAUSE", 1e9)
        viewer.step()
        return titles, parts

    return viewer, step


def test_the_path_tracer_is_shown_until_the_realtime_picture_is_there(first_frame):
    viewer, step = first_frame
    titles, parts = step(patience=0.0)
    reference, realtime = viewer.pictures.reference, viewer.pictures.realtime
    assert reference.tracer.samples == 1
    early = [given for given in parts if given and given[0].image is reference.display]
    assert len(early) > 10, "one picture for each pipeline that is compiled"
    assert not parts[0], "nothing at first"
    assert [part.image for part in parts[-1]] == [realtime.resource("display")]
    assert np.mean(reference.display.read()[..., :3] > 30) > 0.2, "it is a picture"
    assert any(re.search(r"compiling machine code 1 of \d+: gbuffer/begin \.\.\.$", title) for title in titles)
    assert viewer.device.on_compile is None
    count = len(titles), len(parts)
    viewer.step()
    assert (len(titles), len(parts)) == (count[0] + 1, count[1] + 1), "later frames don't wait"


def test_quick_compilation_needs_no_preview(first_frame):
    viewer, step = first_frame
    step(patience=1e9)
    assert viewer.pictures.reference is None


def test_a_preview_that_fails_is_given_up(first_frame, monkeypatch):
    viewer, step = first_frame
    calls = []

    def fail(*arguments):
        calls.append(arguments)
        raise SolariError("no memory")

    monkeypatch.setattr(viewer.pictures, "preview", fail)
    _, parts = step(patience=0.0)
    assert len(calls) == 1
    assert [part.image for part in parts[-1]] == [viewer.pictures.realtime.resource("display")]
    assert not viewer.faults
