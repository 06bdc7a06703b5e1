"""An open device: chosen, created with its features, validated, and closed with all that it owns."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from solari_vk.errors import DeviceError, ValidationError
from solari_vk.gpu.device import memory, raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import memory_barrier as memory_barrier
from solari_vk.gpu.device.instance import Instance
from solari_vk.gpu.device.physical import OPTIONAL_EXTENSIONS, REQUIRED_EXTENSIONS, DeviceReport, choose, feature_chain
from solari_vk.gpu.device.submission import Submission as Submission
from solari_vk.gpu.device.uploads import StagingPool, Uploads
from solari_vk.gpu.device.work_queue import WorkQueue


class Device(WorkQueue):
    """A Vulkan 1.3 device with ray queries, opened. Use it in one thread; a context manager.

    Submitting, waiting and deferred destruction are those of `WorkQueue`.

    select: part of a device's name, its index or its UUID; by default SOLARI_VK_DEVICE, else the best.
    validation: core and synchronization validation; by default on when SOLARI_VK_VALIDATION=1. Extensions
    newer than the installed layer, such as position fetch, are off while it is on.
    staging: treat device memory as not mappable, as on a discrete GPU; by default SOLARI_VK_STAGING=1.
    Raises DeviceError when no device fits, saying what each one misses.
    """

    def __init__(
        self, select: str | int | None = None, *, validation: bool | None = None, staging: bool | None = None
    ) -> None:
        self.validation = _flag("SOLARI_VK_VALIDATION") if validation is None else validation
        self.staging = _flag("SOLARI_VK_STAGING") if staging is None else staging
        self.lost = False
        self.closed = False
        self._instance = Instance(self.validation)
        try:
            wanted = os.environ.get("SOLARI_VK_DEVICE") or None if select is None else select
            self._open(choose(self._instance.devices(), wanted))
        except BaseException:
            self._instance.close()
            raise
        self.memory = Allocator(self)
        self.staging_pool = StagingPool(self)
        self._samplers: dict[tuple[Any, ...], memory.Sampler] = {}

    def _open(self, chosen: Any) -> None:
        """Create the VkDevice and what every submission needs."""
        self.instance = self._instance.handle
        self.instance_vk = self._instance.vk
        self.messages = self._instance.messages
        self.physical_device = chosen.handle
        self.properties = chosen.properties
        self.name: str = chosen.properties.name
        self.queue_family: int = chosen.queue_family
        self.timestamp_bits: int = chosen.timestamp_bits
        optional = [name for name in OPTIONAL_EXTENSIONS if name in chosen.extensions]
        if "VK_KHR_surface" not in self._instance.extensions and "VK_KHR_swapchain" in optional:
            optional.remove("VK_KHR_swapchain")
        self.extensions = frozenset([*REQUIRED_EXTENSIONS, *optional])
        enabled = chosen.enabled_features()
        self.features = frozenset(name for names in enabled.values() for name in names)
        self.has_position_fetch = "rayTracingPositionFetch" in self.features
        queue = raw.struct(
            "VkDeviceQueueCreateInfo", queueFamilyIndex=self.queue_family, queueCount=1, pQueuePriorities=[1.0]
        )
        chain, _ = feature_chain(enabled)
        create = raw.struct(
            "VkDeviceCreateInfo",
            pNext=chain,
            queueCreateInfoCount=1,
            pQueueCreateInfos=queue,
            enabledExtensionCount=len(self.extensions),
            ppEnabledExtensionNames=sorted(self.extensions),
        )
        out = raw.ffi.new("VkDevice*")
        self.instance_vk.vkCreateDevice(self.physical_device, create, raw.NULL, out)
        self.handle = out[0]
        self.vk = raw.device_functions(self.handle, self._on_error)
        queues = raw.ffi.new("VkQueue*")
        self.vk.vkGetDeviceQueue(self.handle, self.queue_family, 0, queues)
        self.queue = queues[0]
        super().__init__()

    def _refuse(self, name: bytes) -> raw.CData:
        raise DeviceError(f"{name.decode()} on {self.name}, which was closed")

    def _on_error(self, result: int) -> None:
        if result == raw.VK_ERROR_DEVICE_LOST:
            self.lost = True

    def create(self, type_name: str, create_info: raw.CData, name: str) -> raw.CData:
        """vkCreate of a handle type such as "VkSemaphore", with its debug name; the caller destroys it."""
        out = raw.ffi.new(type_name + "*")
        getattr(self.vk, "vkCreate" + type_name[2:])(self.handle, create_info, raw.NULL, out)
        self.name_object(type_name[2:], out[0], name)
        return out[0]

    def close(self) -> None:
        """Wait for the device, destroy all that is left, and close it. Safe to call twice.

        A lost device is not waited for. Raises ValidationError if messages are left.
        """
        if self.closed:
            return
        self.closed = True
        self._finish()
        self.memory.close()
        self._destroy_queue()
        self.vk.vkDestroyDevice(self.handle, raw.NULL)
        self._instance.close()
        self.vk = self.instance_vk = raw.Functions(self._refuse)
        self.check_messages()

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- debugging ----------------------------------------------------------------------------------

    @property
    def _has_debug_utils(self) -> bool:
        return "VK_EXT_debug_utils" in self._instance.extensions

    def name_object(self, kind: str, handle: raw.CData, name: str) -> None:
        """Give a handle its name in debuggers and validation; kind: "buffer", "image_view", "ImageView", ..."""
        if not name or not self._has_debug_utils:
            return
        object_type = getattr(raw, "VK_OBJECT_TYPE_" + _upper_snake(kind))
        info = raw.struct(
            "VkDebugUtilsObjectNameInfoEXT",
            objectType=object_type,
            objectHandle=int(raw.ffi.cast("uintptr_t", handle)),
            pObjectName=name,
        )
        self.vk.vkSetDebugUtilsObjectNameEXT(self.handle, info)

    @contextmanager
    def label(self, command_buffer: raw.CData, name: str) -> Iterator[None]:
        """A debug label around the commands recorded inside the `with` block."""
        if not self._has_debug_utils:
            yield
            return
        self.vk.vkCmdBeginDebugUtilsLabelEXT(command_buffer, raw.struct("VkDebugUtilsLabelEXT", pLabelName=name))
        yield
        self.vk.vkCmdEndDebugUtilsLabelEXT(command_buffer)

    def check_messages(self) -> None:
        """Raise ValidationError with the messages that validation has reported since the last call."""
        if self.messages:
            text = "\n".join(self.messages)
            self.messages.clear()
            raise ValidationError(text)

    # ---- resources ----------------------------------------------------------------------------------

    def buffer(self, size_bytes: int, name: str, **options: Any) -> memory.Buffer:
        """A new `memory.Buffer`; options are its keyword arguments."""
        return memory.Buffer(self, size_bytes, name, **options)

    def image(self, width: int, height: int, format: int, name: str, **options: Any) -> memory.Image:
        """A new `memory.Image`; options are its keyword arguments."""
        return memory.Image(self, width, height, format, name, **options)

    def sampler(self, **options: Any) -> memory.Sampler:
        """A `memory.Sampler` with these keyword arguments, shared by all who ask for the same."""
        key = tuple(sorted(options.items()))
        if key not in self._samplers:
            self._samplers[key] = memory.Sampler(self, **options)
        return self._samplers[key]

    def uploads(self) -> Uploads:
        """A batch of uploads: `with device.uploads() as uploads:`, one submission at its end."""
        return Uploads(self)


def list_devices() -> list[DeviceReport]:
    """Every Vulkan device of this machine with what it misses; raises DeviceError without a driver."""
    instance = Instance()
    try:
        return [device.report() for device in instance.devices()]
    finally:
        instance.close()


def _flag(variable: str) -> bool:
    return os.environ.get(variable, "0") not in ("", "0")


def _upper_snake(kind: str) -> str:
    """"ImageView" and "image_view" as Vulkan's object types spell them: IMAGE_VIEW."""
    spaced = "".join("_" + c if c.isupper() and i and kind[i - 1].islower() else c for i, c in enumerate(kind))
    return spaced.upper().removesuffix("KHR").rstrip("_")
