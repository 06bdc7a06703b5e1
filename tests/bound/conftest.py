"""Scenes on the device."""

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder


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
