"""A screen for the viewer's tests: an Xvfb of their own. Without the program they are skipped."""

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
    """The name of an X display that shows nothing but these tests' windows."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{SCREEN[0]}x{SCREEN[1]}x24", "-nolisten", "tcp",
         "-noreset"],  # a server that starts anew as its last window closes refuses the next one meanwhile
        pass_fds=[write], stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(write)
    with os.fdopen(read) as pipe:
        name = f":{pipe.readline().strip()}"
    assert name != ":", "Xvfb does not start"
    before = os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY")
    os.environ["DISPLAY"] = name
    os.environ.pop("WAYLAND_DISPLAY", None)
    yield name
    for variable, value in zip(("DISPLAY", "WAYLAND_DISPLAY"), before, strict=True):
        if value is None:
            os.environ.pop(variable, None)
        else:
            os.environ[variable] = value
    server.terminate()
    server.wait()


@pytest.fixture
def held(device):
    """Tells how many objects there are on the device, but for those that it keeps for the next one who needs some."""

    def count() -> int:
        device.wait_idle()
        return device.live_objects - len(device.staging_pool._chunks) - len(device._samplers)

    return count


@pytest.fixture
def open_viewer(screen, device, held):
    """Opens viewers, closes them, and looks whether they left anything on the device."""
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
