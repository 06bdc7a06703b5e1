"""An X server and viewers for the tests. Without Xvfb the tests are skipped."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from support.frames import leaves_nothing
from viewer_tools import make_session

import solari_vk as sv
from solari_vk.studio.viewer.app import Viewer
from solari_vk.studio.viewer.session import Session

SCREEN = (480, 360)


@pytest.fixture
def scene() -> sv.Scene:
    return sv.builtin("cornell_box")


@pytest.fixture
def session(scene: sv.Scene) -> Session:
    return make_session(scene)


@pytest.fixture(scope="session")
def screen() -> Iterator[str]:
    """The name of an X display that only these tests use."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb")
    read, write = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write),
            "-screen",
            "0",
            f"{SCREEN[0]}x{SCREEN[1]}x24",
            "-nolisten",
            "tcp",
            "-noreset",
        ],  # without it the server restarts when its last window closes, and refuses windows until then
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
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
    """A function that counts the objects in use on the device."""

    def count() -> int:
        device.wait_idle()
        return device.objects_in_use

    return count


@contextmanager
def viewers(device) -> Iterator[Callable[..., Viewer]]:
    """A function that opens a viewer. At the end all are closed, and must have left nothing on the device."""
    opened: list[Viewer] = []

    def open_one(scene=None, **options) -> Viewer:
        options = {"size": (96, 64), "mode": "reference", "scale": 1.0, **options}
        opened.append(Viewer(device, scene or sv.builtin("cornell_box"), **options))
        return opened[-1]

    with leaves_nothing(device):
        yield open_one
        for viewer in opened:
            viewer.close()


@pytest.fixture
def open_viewer(screen, device):
    with viewers(device) as open_one:
        yield open_one


@pytest.fixture(scope="module")
def open_shared(screen, device):
    """`open_viewer` for viewers that the tests of a module share."""
    with viewers(device) as open_one:
        yield open_one


@pytest.fixture
def viewer(open_viewer):
    """A viewer without panels that has shown two frames of the path tracer's picture."""
    opened = open_viewer(overlay=False)
    opened.run(frames=2)
    return opened


class Imgui:
    """Stands for the module imgui, with all headers, trees and popups open and some functions replaced."""

    def __init__(self, imgui, **replaced):
        self._imgui = imgui
        self.__dict__.update(replaced)

    def __getattr__(self, name):
        found = getattr(self._imgui, name)
        if name not in ("collapsing_header", "tree_node", "tree_node_ex"):
            return found

        def opened(*arguments):
            self._imgui.set_next_item_open(True)
            return found(*arguments)

        return opened


@pytest.fixture
def replace(monkeypatch):
    """replace(name=function, ...): let the panels use `Imgui` with these functions."""
    from solari_vk.studio.viewer import (
        environment_panel,
        file_panel,
        material_panel,
        object_panel,
        outliner,
        panels,
        widgets,
    )

    imgui = panels.imgui
    modules = environment_panel, file_panel, material_panel, object_panel, outliner, panels, widgets

    def put(**replaced):
        for module in modules:
            monkeypatch.setattr(module, "imgui", Imgui(imgui, **replaced))

    return put
