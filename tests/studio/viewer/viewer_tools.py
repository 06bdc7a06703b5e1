"""Input for the viewer's tests, sessions without a window, and the pixels of an EXR."""

from __future__ import annotations

from pathlib import Path

import OpenEXR

from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings
from solari_vk.studio.viewer.camera_control import CameraControl
from solari_vk.studio.viewer.reload import Sources
from solari_vk.studio.viewer.scaling import ScaleControl
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.window import Event


def press(code, modifiers=0, repeats=False):
    return Event("key", code, True, modifiers, repeats=repeats)


def release(code):
    return Event("key", code, False)


def drag(button, *steps, start=(50.0, 50.0)):
    """The events of a drag by steps (right, down)."""
    x, y = start
    events = [Event("cursor", x=x, y=y), Event("button", button, True)]
    for right, down in steps:
        x, y = x + right, y + down
        events.append(Event("cursor", x=x, y=y))
    return [*events, Event("button", button, False)]


def type_keys(viewer, *codes, modifiers=0):
    for code in codes:
        viewer.window.events += [press(code, modifiers), release(code)]
    viewer.step()


def click(viewer, x, y):
    viewer.window.events += drag(0, start=(x, y))
    viewer.step()


def read_exr(path):
    with OpenEXR.File(str(path)) as file:
        return file.channels()["RGB"].pixels.copy()


class FakeWindow:
    """Stands for a window of 640 x 360 pixels where there is no screen."""

    size = pixels = (640, 360)
    text_scale = 1.0
    wants_to_close = False
    clipboard = ""


class FakePictures:
    """Stands for pictures that were never rendered."""

    device = binder = realtime = reference = None
    ready = False
    mode = "reference"
    view = debug_view = "picture"
    known_views = DEBUG_VIEWS
    tonemap = "agx"
    seed = 3
    size = (64, 48)
    upscale = 1.0

    def __init__(self, scene):
        self.scene, self.settings = scene, Settings()

    def reload(self):
        pass

    def cut(self):
        pass


def make_session(scene, folder="."):
    """The state of a viewer without a window and a device, for what edits the scene."""
    camera = CameraControl(Camera.look_at((0, 1, 4), (0, 1, 0)), 2.0)
    camera.see(4.0)
    sources = Sources(scene, None, None)
    pictures = FakePictures(scene)
    return Session(
        FakeWindow(), pictures, camera, ScaleControl(), sources, source=None, source_options=(), folder=Path(folder)
    )
