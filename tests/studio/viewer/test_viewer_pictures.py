"""The viewer's pictures: upscaled to the window, side by side, compared with the path tracer, and while one waits."""

from __future__ import annotations

import re

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.gpu.device.shared_objects import SharedObjects
from solari_vk.studio.viewer import compile_preview
from solari_vk.studio.viewer.comparison import difference, errors
from solari_vk.studio.viewer.pictures import STRIP
from solari_vk.studio.viewer.presenter import Presenter

SIZE = (96, 64)


@pytest.fixture(scope="module")
def shared(open_shared):
    return open_shared(overlay=False, mode="split", settings=sv.Settings(denoise=True, antialiasing=True))


@pytest.fixture
def show(shared):
    """Show frames in a mode and scale; returns the viewer, which the tests share."""

    def run(mode, scale, frames, divider=0.5):
        shared.pictures.mode, shared.pictures.divider = mode, divider
        shared.scale.fix(scale)
        shared.run(frames=frames)
        return shared

    return run


def test_the_realtime_picture_has_the_windows_size(show):
    """The renderer makes it from fewer pixels; the window shows it texel by texel."""
    points = []
    for scale in (1.0, 0.5, 0.4, 1.0):
        viewer = show("realtime", scale, frames=3)
        pictures = viewer.pictures
        assert pictures.size == pictures.realtime.size == SIZE
        assert pictures.rendered_size == pytest.approx((96 * scale, 64 * scale), abs=1)
        assert pictures.upscale == pytest.approx(1 / scale)
        assert (viewer.capture() == pictures.realtime["display"][..., :3]).all()
        viewer.act("pick", (30.0, 40.0))
        points.append(viewer.pick.point)
    assert np.linalg.norm(np.subtract(points, points[0]), axis=1).max() < 0.1, "what is picked stays the same"
    viewer.settings.upscale = 1.5
    viewer.run(frames=2)
    assert viewer.pictures.rendered_size == (64, 43), "a change of the setting lasts until the scale changes"
    show("realtime", 0.5, frames=1)
    assert (viewer.pictures.upscale, viewer.settings.upscale) == (2, 1.5), "the user's settings stay as they are"


# ---- the split view ---------------------------------------------------------------------------------


def test_raw_denoised_and_reference_side_by_side(show):
    viewer = show("split", 0.5, frames=24)
    pictures = viewer.pictures
    middle = (1 - STRIP) / 2
    assert pictures.columns() == {"raw": (0, middle), "denoised": (middle, 1 - middle), "reference": (1 - middle, 1)}
    raw, denoised, reference = (part.image for part in pictures.parts())
    assert [(image.width, image.height) for image in (raw, denoised, reference)] == [SIZE] * 3
    shown, whole = viewer.capture(), pictures.pixels()
    assert shown.shape == whole.shape == (64, 96, 3)
    assert (shown[:, 32:64] == denoised.read()[:, 32:64, :3]).all()
    assert (whole[:, :32] == raw.read()[:, :32, :3]).all()
    assert (whole[:, 64:] == reference.read()[:, 64:, :3]).all()
    assert np.abs(shown.astype(int) - whole).mean() < 12
    found = errors(pictures)
    assert found.keys() == {"raw", "denoised"}
    assert found["denoised"][0] < 0.5 * found["raw"][0]
    assert abs(found["denoised"][1]) < 0.3
    pictures.view = "paths_distance"
    assert errors(pictures) == {}, "the path tracer has no debug views"
    pictures.view = "picture"
    viewer.settings.denoise = False
    viewer.run(frames=2)
    assert pictures.columns().keys() == errors(pictures).keys() | {"reference"} == {"realtime", "reference"}
    viewer.settings.denoise = True


def test_columns_cover_the_window_and_are_not_shifted(show, monkeypatch):
    """Each picture is where it is when it fills the window, but for half a pixel of the window."""
    for divider in (0.0, 0.1, 0.43, 0.5, 0.61, 1.0):
        viewer = show("split", 0.4, 2, divider)
        columns = list(viewer.pictures.columns().values())
        assert [columns[0][0], columns[-1][1]] == [0, 1]
        assert [end for _, end in columns[:-1]] == [begin for begin, _ in columns[1:]]
        shown, parts = viewer.capture().astype(int), viewer.pictures.parts()
        assert shown.shape == viewer.pictures.pixels().shape == (64, 96, 3)
        for part in parts:
            with monkeypatch.context() as patch:
                patch.setattr(viewer.pictures, "parts", lambda part=part: [type(part)(part.image)])
                whole = viewer.capture()
            begin, end = part.columns(96)
            inside = slice(begin + 3, max(end - 3, begin + 3))  # at its borders, a small picture has one texel less
            away = np.abs(shown[:, inside] - whole[:, inside])
            assert not away.size or away.mean() < 2, divider  # at most 1.4; 5 with borders within texels


# ---- comparison -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_known_difference_is_found(device):
    """A picture that is 10 % too bright everywhere; the little noise of the reference counts too."""
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (64, 64)) as tracer, sv.PathTracer(device, scene, (64, 64), seed=9) as other:
        truth = tracer.render(samples=600)["radiance"]
        other.render(samples=1)
        assert difference(truth, other) is None
        other.render(samples=600)
        error, mean = difference(1.1 * truth, other)
        assert error == pytest.approx(0.1, abs=0.06)
        assert mean == pytest.approx(0.1, abs=0.03)


# ---- the first picture ------------------------------------------------------------------------------


@pytest.fixture
def first_frame(open_viewer, device, monkeypatch):
    """A realtime viewer; a function that runs a frame and returns what was shown before it: titles and parts."""
    if device.properties.kind != "cpu":
        pytest.skip("only software devices compile for long")
    titles = []
    parts = []
    show = Presenter.show
    monkeypatch.setattr(Presenter, "show", lambda self, given, draw: (parts.append(given), show(self, given, draw))[1])
    viewer = open_viewer(mode="realtime", overlay=False)
    monkeypatch.setattr(device, "pipelines", SharedObjects(limit=0))  # other viewers' would be there already
    monkeypatch.setattr(viewer.window, "set_title", titles.append)

    def step(patience):
        monkeypatch.setattr(compile_preview, "PATIENCE", patience)
        monkeypatch.setattr(compile_preview, "PAUSE", 1e9)
        viewer.step()
        return titles, parts

    return viewer, step


def test_the_path_tracer_is_shown_until_the_realtime_picture_is_there(first_frame):
    viewer, step = first_frame
    heard = viewer.device.on_compile
    titles, parts = step(patience=0.0)
    reference, realtime = viewer.pictures.reference, viewer.pictures.realtime
    assert reference.tracer.samples == 1
    early = [given for given in parts if given and given[0].image is reference.display]
    assert len(early) > 10, "one picture for each pipeline that is compiled"
    assert not parts[0], "nothing at first"
    assert [part.image for part in parts[-1]] == [realtime.resource("display")]
    assert np.mean(reference.display.read()[..., :3] > 30) > 0.2, "it is a picture"
    assert any(re.search(r"compiling machine code 1 of \d+: gbuffer/begin \.\.\.$", title) for title in titles)
    assert viewer.device.on_compile is heard
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
        raise sv.SolariError("no memory")

    monkeypatch.setattr(viewer.pictures, "preview", fail)
    _, parts = step(patience=0.0)
    assert len(calls) == 1
    assert [part.image for part in parts[-1]] == [viewer.pictures.realtime.resource("display")]
    assert not viewer.faults
