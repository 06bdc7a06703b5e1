"""An X server and viewers for the tests. Without Xvfb the tests are skipped."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator

import pytest

import solari_vk as sv
from solari_vk.viewer import Viewer

SCREEN = (480, 360)


@pytest.fixture(scope="session")
def screen() -> Iterator[str]:
    """The name of an X display that only these tests use."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{SCREEN[0]}x{SCREEN[1]}x24", "-nolisten", "tcp",
         "-noreset"],  # without it the server restarts when its last window closes, and refuses windows until then
        pass_fds=[write], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as pipe:
        name = f":{pipe.readline().strip()}"
    assert name != ":", "Xvfb does not start"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DISPLAY", name)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        yield name
    server.terminate()
    server.wait()


@pytest.fixture
def held(device):
    """A function that counts the objects on the device, without those that the device keeps for later use."""

    def count() -> int:
        device.wait_idle()
        kept = len(device.staging_pool._chunks) + len(device._samplers) + ("pipeline_cache" in vars(device))
        return device.live_objects - kept

    return count


@pytest.fixture
def open_viewer(screen, device, held):
    """A function that opens a viewer. After the test all are closed, and must have left nothing on the device."""
    opened: list[Viewer] = []
    before = held()

    def open_one(scene=None, **options) -> Viewer:
        options = {"size": (96, 64), "mode": "reference", "scale": 1.0, **options}
        viewer = Viewer(device, scene or sv.builtin("cornell_box"), **options)
        opened.append(viewer)
        return viewer

    yield open_one
    for viewer in opened:
        viewer.close()
    assert held() == before, "the viewer left something on the device"


@pytest.fixture
def viewer(open_viewer):
    """A viewer without panels that has shown two frames of the path tracer's picture."""
    opened = open_viewer(overlay=False)
    opened.run(frames=2)
    return opened
