"""Input for the viewer's tests, and the pixels of an EXR."""

from __future__ import annotations

import OpenEXR

from solari_vk.viewer.window import Event


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
