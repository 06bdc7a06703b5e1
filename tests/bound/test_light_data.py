"""Data of lights on the device: one buffer for each profile."""

from __future__ import annotations

from unittest import mock

import pytest
from support.frames import leaves_nothing

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.lights import light_data
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.scene.lights.profile import LightProfile


def test_lamps_of_one_profile_share_its_buffer(device, bound):
    """The last one that goes frees it, and so does an upload that fails."""
    profile = LightProfile([0, 90], [0, 180], [[9, 1], [5, 1]])
    lamps = [sv.PointLight((x, 0, 0), ies=profile) for x in range(3)]
    with mock.patch.object(light_data, "ProfileBuffer", wraps=light_data.ProfileBuffer) as made:
        binder = bound(*lamps[:2])
        binder.update()
        binder.scene.remove(lamps[0])
        binder.scene.add(lamps[2])
        binder.update()
        assert made.call_count == 1
        shared = binder.lights.data[lamps[1]]
        assert binder.lights.data == {lamps[1]: shared, lamps[2]: shared}
    with mock.patch.object(shared, "destroy", wraps=shared.destroy) as freed:
        lamps[1].profile = None
        binder.update()
        assert not freed.called
        lamps[2].ies = LightProfile([0, 90], [0], [[1, 1]])
        with (
            mock.patch.object(Buffer, "upload", side_effect=SolariError("no memory")),
            leaves_nothing(device),
            pytest.raises(SolariError, match="no memory"),
        ):
            binder.update()
        binder.update()
        assert freed.call_count == 1
