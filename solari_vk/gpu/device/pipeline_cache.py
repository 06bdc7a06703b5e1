"""The device's pipeline cache, kept on disk from one process to the next."""

from __future__ import annotations

import hashlib
import struct

from solari_vk.base import disk_cache
from solari_vk.base.errors import DeviceError, warn
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue

MAX_BYTES = 64 << 20  # more is mostly pipelines of shaders that have been edited since
_HEADER_BYTES = 32  # of VkPipelineCacheHeaderVersionOne


class PipelineCache:
    """A VkPipelineCache. It begins with what earlier processes saved for the same device and driver version.

    Data that is damaged, too large or made by another device is not used. Vulkan lets several threads create
    pipelines with the same cache.
    """

    def __init__(self, device: WorkQueue) -> None:
        properties = raw.ffi.new("VkPhysicalDeviceProperties*")
        device.instance_vk.vkGetPhysicalDeviceProperties(device.physical_device, properties)
        # VkPipelineCacheHeaderVersionOne has vendor, device and a UUID of the driver: data of another maker is refused
        # here, before the driver sees it.
        header = struct.pack(
            "<4I", _HEADER_BYTES, raw.VK_PIPELINE_CACHE_HEADER_VERSION_ONE, properties.vendorID, properties.deviceID
        ) + bytes(properties.pipelineCacheUUID)
        maker = header + struct.pack("<I", properties.driverVersion)
        self.entry = f"{hashlib.sha256(maker).hexdigest()}.pipelines"
        """The name of its entry on disk."""
        known = disk_cache.load(self.entry) or b""
        if not known.startswith(header) or len(known) > MAX_BYTES:
            known = b""
        self._saved_bytes = len(known)
        self._device = device
        create = raw.struct("VkPipelineCacheCreateInfo", initialDataSize=len(known), pInitialData=known or None)
        self.handle = handle = device.create("VkPipelineCache", create, "pipeline cache")
        device.share(device.register(lambda: device.vk.vkDestroyPipelineCache(device.handle, handle, raw.NULL)))

    def save(self) -> None:
        """Write it to disk if it has grown. A failure only gives a warning."""
        try:
            self._save()
        except DeviceError as error:
            warn(f"compiled pipelines can't be kept for the next process: {error}")

    def _save(self) -> None:
        get = self._device.vk.vkGetPipelineCacheData
        size = raw.ffi.new("size_t*")
        get(self._device.handle, self.handle, size, raw.NULL)
        # Nothing was added: writing megabytes again would take longer than the frame.
        if size[0] == self._saved_bytes:
            return
        data = raw.ffi.new("char[]", size[0])
        get(self._device.handle, self.handle, size, data)
        self._saved_bytes = len(data)
        disk_cache.store(self.entry, raw.ffi.buffer(data)[:])  # all: Mesa 26.2 counts too few bytes of its header
