"""The maps of portals: what is computed again, and what is freed."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import DeviceError
from solari_vk.bound.lights import portal_maps


class FakeDevice:
    """A device that holds `room` buffers."""

    def __init__(self, room=100):
        self.room, self.live = room, []

    def buffer(self, size, name):
        if len(self.live) == self.room:
            raise DeviceError("out of memory")
        made = FakeBuffer()
        made.size = size
        made.address = id(made)
        made.destroy = lambda: self.live.remove(made)
        self.live.append(made)
        return made


class FakeBuffer:
    def upload(self, table):
        self.table = table


def sky(turn=0.0):
    image = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32)
    return sv.Environment(image, rotation=turn)


PORTALS = [sv.Portal((0, 0, 0), *sides) for sides in (((1, 0, 0), (0, 1, 0)), ((1, 0, 0), (0, 0, 1)))]


def test_a_turn_leaves_the_luminance_of_images(monkeypatch):
    calls = []
    monkeypatch.setattr(portal_maps, "texel_means", lambda image: calls.append(1) or image.mean(axis=2, dtype=float))
    device, environment = FakeDevice(), sky()
    maps = portal_maps.PortalMaps(device)
    assert maps.make(PORTALS, [environment]) == PORTALS
    before = [buffer.table for buffer in device.live]
    environment.rotation = 0.5
    assert maps.make(PORTALS, [environment]) == PORTALS
    assert (len(calls), len(device.live)) == (1, 2)
    assert not any(np.array_equal(buffer.table, table) for buffer in device.live for table in before)
    environment.image = environment.image * np.float32(2)
    maps.make(PORTALS, [environment])
    assert len(calls) == 2
    maps.make([], [])
    assert (device.live, maps._luminances) == ([], {})


def test_no_map_is_lost_when_memory_runs_out():
    device = FakeDevice(3)
    maps = portal_maps.PortalMaps(device)
    maps.make(PORTALS, [sky()])
    with pytest.raises(DeviceError, match="out of memory"):
        maps.make(PORTALS, [sky(0.5)])
    maps.destroy()
    assert device.live == []
