"""Scenes on the device."""

import itertools

import numpy as np
import pytest
from support.frames import fail_after

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads


@pytest.fixture
def bound(device):
    """bound(*objects) -> a binder of a scene of them; freed at the end, when nothing of it may be left."""
    made = []

    def make(*items):
        made.append(SceneBinder(device, sv.Scene(*items)))
        return made[-1]

    def free():
        device.wait_idle()
        while made:
            made.pop().destroy()
        device.wait_idle()
        return device.objects_in_use

    corner = sv.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    for magnification in ("linear", "nearest"):  # the device keeps their samplers
        texture = sv.Texture(np.zeros((1, 1), np.uint8), magnification=magnification)
        make(sv.Instance(corner, sv.Material(emissive_texture=texture))).update()
    kept = free()
    yield make
    assert free() == kept


@pytest.fixture
def each_failed_upload(any_device, monkeypatch):
    """each_failed_upload(make) -> a binder of a scene of `make()` for each upload of its first update, which failed.

    Data goes through staging memory. Nothing of a binder may be left.
    """

    def each(make):
        with Device(validation=True, staging=True) as device:
            for count in itertools.count():
                binder = SceneBinder(device, make())
                with monkeypatch.context() as patch:
                    fail_after(patch, Uploads, "buffer", count)
                    try:
                        binder.update()
                    except SolariError:
                        yield binder
                    else:
                        break
                binder.destroy()
                device.wait_idle()
                assert device.objects_in_use == 0
        assert count > 4

    return each
