"""The data of single lights on a device: environments' images, and light profiles (IES)."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.bound.lights.emissive_meshes import ONE_PART
from solari_vk.bound.lights.environment_buffers import EnvironmentBuffers
from solari_vk.bound.table import RowAllocator, content_of
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.lights.punctual import PointLight


class ProfileBuffer:
    """The buffer of a profile's shares. record: the fields of the shaders' PunctualLight that follow from it."""

    emission = ONE_PART

    def __init__(self, device: Device, profile: LightProfile) -> None:
        self._shares = device.buffer(profile.shares.nbytes, "light profile")
        try:
            self._shares.upload(profile.shares)
        except BaseException:
            self._shares.destroy()
            raise
        self.record = {"profile": self._shares.address, "profile_columns": profile.shares.shape[1]}

    def destroy(self) -> None:
        """Free the buffer."""
        self._shares.destroy()


class SharedBuffers:
    """The buffers of images and profiles, by their contents."""

    def __init__(self) -> None:
        self.users: RowAllocator[bytes | LightProfile] = RowAllocator()  # each a light, and the LightData that has it
        self.made: dict[bytes | LightProfile, EnvironmentBuffers | ProfileBuffer] = {}


class LightData(dict[Light, EnvironmentBuffers | ProfileBuffer]):
    """The buffers of each light that has an image or a profile; lights of equal ones share them.

    row: as EnvironmentBuffers has it. shared: with the lights of others too.
    """

    def __init__(self, device: Device, row: np.dtype[Any], shared: SharedBuffers | None = None) -> None:
        super().__init__()
        self._device = device
        self._row = row
        self._shared = SharedBuffers() if shared is None else shared
        self._data: dict[Light, tuple[Any, bytes | LightProfile]] = {}  # of each light, with its content

    def set(self, light: Light, data: Any) -> bool:
        """Have buffers for the data, an image or a profile, that a light has now; None: for none. Returns whether it is
        another than before. On errors nothing is changed."""
        if data is self._data.get(light, (None,))[0]:
            return False
        if data is None:
            self._drop(light)
            return True
        shared = self._shared
        key = data if isinstance(data, LightProfile) else content_of(data)
        if key not in shared.made:
            shared.made[key] = self._make(data)
        # Acquired before the other data are dropped, which may be equal.
        shared.users.acquire(key, (id(self), light))
        self._drop(light)
        self[light] = shared.made[key]
        self._data[light] = data, key
        return True

    def _make(self, data: Any) -> EnvironmentBuffers | ProfileBuffer:
        if isinstance(data, LightProfile):
            return ProfileBuffer(self._device, data)
        return EnvironmentBuffers(self._device, self._row, data)

    def _drop(self, light: Light) -> None:
        """Free the buffers of a light, if it has some and is their last user."""
        if light not in self:
            return
        buffers = self.pop(light)
        _, key = self._data.pop(light)
        if self._shared.users.release(key, (id(self), light)):
            del self._shared.made[key]
            buffers.destroy()

    def destroy(self) -> None:
        """Free all buffers."""
        for light in list(self):
            self._drop(light)


def data_of(light: Any) -> Any:
    """The image of an environment, or the profile of a point light, None for lights without one."""
    if isinstance(light, EnvironmentLight):
        return light.image
    return light.profile if isinstance(light, PointLight) else None
