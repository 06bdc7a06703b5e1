"""Light profiles on a device."""

from __future__ import annotations

from solari_vk.bound.lights.emissive_meshes import Emission
from solari_vk.gpu.device.device import Device
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
