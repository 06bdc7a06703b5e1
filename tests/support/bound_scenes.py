"""Scenes on the device for shaders under test."""

from contextlib import contextmanager

from solari_vk.bound.binder import SceneBinder


@contextmanager
def bound(device, scene):
    """The binder of a scene, updated once, and destroyed when the device is done."""
    binder = SceneBinder(device, scene)
    try:
        binder.update()
        yield binder
    finally:
        device.wait_idle()
        binder.destroy()
