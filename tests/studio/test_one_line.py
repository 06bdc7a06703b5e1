"""Pictures, windows and pages by one line, and what they keep between calls."""

from __future__ import annotations

import tempfile
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.output import oidn
from solari_vk.studio import one_line

SIZE = (24, 16)


@pytest.fixture(autouse=True)
def tests_device(device, monkeypatch):
    """The tests' device in place of one that the functions open."""
    monkeypatch.setattr(one_line._here, "kept", SimpleNamespace(device=device))


def test_a_frame_lasts_and_its_renderer_is_closed_after_it(device):
    scene = sv.builtin("cornell_box")
    first = sv.render(scene, SIZE, 1, denoise=False)
    before = first["radiance"].copy()
    camera = sv.Camera(position=(0, 1, 3), look_at=(0, 1, 0), fov=50)
    second = sv.render(scene, SIZE, 1, denoise=False, camera=camera)
    np.testing.assert_array_equal(first["radiance"], before)
    assert not np.array_equal(second["depth"], first["depth"])
    renderer = first._renderer.renderer
    del first
    assert not renderer._closed
    sv.render("builtin:cornell_box", SIZE, 1, denoise=False, progress=False)
    assert renderer._closed
    assert second["radiance"].any()


def test_modes(monkeypatch, capsys):
    scene = sv.builtin("cornell_box")
    monkeypatch.setattr(one_line, "REALTIME_FRAMES", 2)
    monkeypatch.setattr(oidn, "is_installed", lambda: False)
    assert "display" in sv.render(scene, SIZE)
    with pytest.warns(UserWarning, match="pip install 'solari-vk\\[oidn\\]'"):
        assert "display" not in sv.render(scene, SIZE, 1)
    for wrong, why in (
        ({"spp": 4}, "it is called samples here"),
        ({"mode": "fast"}, "there is no mode 'fast'"),
        ({"mode": "realtime", "samples": 3}, 'leave samples out, or give mode="reference"'),
    ):
        with pytest.raises(sv.SolariError, match=why):
            sv.render(scene, SIZE, **wrong)
    with pytest.raises(sv.SolariError, match="a mesh is added to a scene"):
        sv.render(sv.shapes.box(), SIZE)


def test_a_device_that_is_gone_is_opened_again(device, monkeypatch):
    opened = []

    class Opened:
        lost = closed = False

        def __init__(self):
            opened.append(self)

        def close(self):
            self.closed = True

    monkeypatch.setattr(one_line, "Device", Opened)
    assert one_line.kept_device().device is device
    monkeypatch.setattr(one_line._here, "kept", None)
    first = one_line.kept_device().device
    assert one_line.kept_device().device is first
    first.lost = True
    second = one_line.kept_device().device
    assert (first.closed, opened) == (True, [first, second])
    one_line._here.kept = None
    assert second.closed


def test_a_device_is_closed_with_its_thread_and_frames(device, monkeypatch):
    closed = []
    monkeypatch.setattr(
        one_line, "Device", lambda: SimpleNamespace(lost=False, closed=False, close=lambda: closed.append(1))
    )
    sources = []

    def work(keeps):
        kept = one_line.kept_device()
        one_line._here.unused.append("of this thread")
        if keeps:
            sources.append(one_line._LastingSource(kept, kept))

    for keeps, expected in ((False, 1), (True, 1)):
        thread = threading.Thread(target=work, args=(keeps,))
        thread.start()
        thread.join()
        for _ in range(200):  # a thread forgets what is its own after `join`, in some versions of Python
            if len(closed) == expected:
                break
            time.sleep(0.01)
        assert len(closed) == expected
    sources.clear()
    assert len(closed) == 2
    assert "of this thread" not in one_line._here.unused


def test_wrong_arguments(device, monkeypatch):
    scene = sv.builtin("cornell_box")
    for function, wrong, why in (
        (sv.view, {"device": "cpu"}, r"device must be a Device, such as solari_vk.Device\("),
        (sv.view, {"camera": "x"}, "camera must be a Camera"),
        (sv.view, {"mode": "x"}, "solari_vk.view: there is no mode 'x'"),
        (sv.serve, {"size": 64}, "size must be two whole numbers"),
        (sv.serve, {"mode": "x"}, "solari_vk.serve: there is no mode 'x'"),
        (sv.serve, {"port": "x"}, "port must be a whole number"),
        (sv.render, {"camera": "x"}, "camera must be a Camera"),
    ):
        with pytest.raises(sv.SolariError, match=why):
            function(scene, **wrong)
    with monkeypatch.context() as patched:
        patched.setattr(device, "closed", True)
        with pytest.raises(sv.SolariError, match="was closed: make a new Device"):
            sv.render(scene, SIZE, device=device)
    errors = []

    def serve():
        with pytest.raises(sv.SolariError, match="main thread") as error:
            sv.serve(scene)
        errors.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    thread.join()
    assert errors


def test_show(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    frame = sv.render(sv.builtin("cornell_box"), SIZE, 1, denoise=False)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(sv.SolariError, match=r"no desktop .*; frame.save\(\"picture.png\"\) writes"):
        frame.show()
    monkeypatch.setattr("solari_vk.renderers.results.why_no_desktop", lambda: "")
    monkeypatch.setattr("solari_vk.renderers.results.open_on_desktop", lambda path: f"no program for {path.name}")
    with pytest.raises(sv.SolariError, match="no program for picture"):
        frame.show()
    assert not list(tmp_path.iterdir())
    shown = []
    monkeypatch.setattr("solari_vk.renderers.results.open_on_desktop", lambda path: shown.append(path) or "")
    frame.show()
    assert shown[0].read_bytes()[:4] == b"\x89PNG"


def test_serve():
    """Until the first page was read, when Ctrl-C ends it."""
    pytest.importorskip("websockets")
    read = []

    def started(address):
        read.append(address)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sv.serve(sv.builtin("cornell_box"), SIZE, port=0, started=started)
    assert read[0].startswith("http://127.0.0.1:")
