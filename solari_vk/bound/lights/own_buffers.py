"""Data on a device that a light has of its own: an environment's image, a lamp's profile."""

from __future__ import annotations

from typing import Any

import numpy as np

from solari_vk.bound.lights.emissive_meshes import Emission
from solari_vk.bound.lights.environment_buffers import EnvironmentBuffers
from solari_vk.gpu.device.device import Device
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.profile import LightProfile


class ProfileBuffer:
    """The buffer of a profile's shares. record: the fields of the shaders' PunctualLight that follow from it."""

    def __init__(self, device: Device, profile: LightProfile) -> None:
        self.image = profile
        self.emission = Emission(1.0, 1, None)
        self._shares = device.buffer(profile.shares.nbytes, "light profile")
        self._shares.upload(profile.shares)
        self.record = {"profile": self._shares.address, "profile_columns": profile.shares.shape[1]}

    def destroy(self) -> None:
        """Free the buffer."""
        self._shares.destroy()


OwnBuffers = EnvironmentBuffers | ProfileBuffer


def own_image(light: Any) -> Any:
    """An environment's image or a lamp's profile, None for lights without one."""
    return light.image if isinstance(light, EnvironmentLight) else getattr(light, "profile", None)


def own_buffers(device: Device, row: np.dtype[Any], image: Any) -> OwnBuffers:
    """The buffers of what `own_image` gives. row: as EnvironmentBuffers has it."""
    return ProfileBuffer(device, image) if isinstance(image, LightProfile) else EnvironmentBuffers(device, row, image)
