"""The logical device: chosen, created with its features, with its functions, debug names and validation messages."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import NoReturn
from weakref import WeakSet

from solari_vk.base.errors import DeviceError, SolariError, ValidationError, is_name, quoted, warn
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.instance import Instance
from solari_vk.gpu.device.measured_rays import measured_speeds
from solari_vk.gpu.device.physical import (
    DESCRIPTOR_INDEXING,
    MACROS,
    OPTIONAL_EXTENSIONS,
    POSITION_FETCH,
    DeviceProperties,
    PhysicalDevice,
    choose,
    feature_chain,
)
from solari_vk.gpu.device.rays import AUTO, RAYS, automatic_method, is_unlisted
from solari_vk.gpu.device.software import why_software

_FORKED = (
    "belongs to the process that this one was forked from, and can't be used here: start processes by spawn "
    "(multiprocessing.get_context('spawn')), and open a Device in each"
)
_open_devices: WeakSet[LogicalDevice] = WeakSet()


def asked_for(select: str | int | None, rays: str | None) -> tuple[str | int | None, str]:
    """The device and the method of tracing that are asked for, where they are None by the environment's variables."""
    chosen = (os.environ.get("SOLARI_VK_RAYS") or AUTO) if rays is None else rays
    if not is_name(chosen, (AUTO, *RAYS)):
        where = "SOLARI_VK_RAYS" if rays is None else "rays"
        raise SolariError(f"{where} is {quoted(chosen)}: take one of {', '.join((AUTO, *RAYS))}")
    return os.environ.get("SOLARI_VK_DEVICE") or None if select is None else select, chosen


class LogicalDevice:
    """A VkDevice with one queue. `vk` has its functions, `properties`, `features` and `extensions` what it can do.

    `rays`: how shaders trace rays on it, "query", "pipeline" or "compute". The features of other methods are off.
    `missing_rays`: what the device lacks for each method. `has_descriptor_indexing`: whether shaders have arrays of
    textures; other devices have them in buffers. `lacking`: the macros that tell shaders what it lacks.
    """

    def __init__(self, select: str | int | None, validation: bool, rays: str | None) -> None:
        wanted, self.rays = asked_for(select, rays)
        self.validation = validation
        self.lost = False
        self.closed = False
        self.forked = False
        self._instance = Instance(validation)
        try:
            devices = self._instance.devices()
            chosen = choose(devices, wanted, self.rays)
            # Whoever named a device wants that one, and needs no advice.
            reason = why_software(devices, chosen, self.rays) if wanted is None else ""
            if reason:
                warn(reason)
            self._open(chosen)
        except BaseException:
            self._instance.close()
            raise

    def _open(self, chosen: PhysicalDevice) -> None:
        if self.rays == AUTO:
            p = chosen.properties
            unlisted = is_unlisted(chosen.missing_rays, p.kind, p.driver_id)
            speeds = measured_speeds(p.uuid, p.driver) if unlisted else None
            self.rays, _ = automatic_method(chosen.missing_rays, p.kind, speeds)
        self.instance = self._instance.handle
        self.instance_vk = self._instance.vk
        self.messages = self._instance.messages
        self.physical_device = chosen.handle
        self.properties: DeviceProperties = chosen.properties
        self.name = chosen.properties.name
        self.missing_rays = chosen.missing_rays
        self.offered_extensions = frozenset(chosen.extensions)
        self.queue_family = chosen.queue_family
        self.timestamp_bits = chosen.timestamp_bits
        optional = [name for name in OPTIONAL_EXTENSIONS if name in chosen.extensions]
        # VK_KHR_swapchain depends on VK_KHR_surface of the instance.
        if "VK_KHR_surface" not in self._instance.extensions and "VK_KHR_swapchain" in optional:
            optional.remove("VK_KHR_swapchain")
        if not RAYS[self.rays] and POSITION_FETCH in optional:
            optional.remove(POSITION_FETCH)
        self.extensions = frozenset([*RAYS[self.rays], *optional])
        enabled = chosen.enabled_features(self.rays)
        self.features = frozenset(name for names in enabled.values() for name in names)
        self.has_descriptor_indexing = self.features.issuperset(DESCRIPTOR_INDEXING)
        self.lacking = tuple(macro for macro, needed in MACROS.items() if not self.features.issuperset(needed))
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
        self.handle: raw.CData = out[0]
        # Functions of the device itself skip the loader's dispatch, which takes time at each call.
        self.vk = raw.device_functions(self.handle, self._on_error)
        queues = raw.ffi.new("VkQueue*")
        self.vk.vkGetDeviceQueue(self.handle, self.queue_family, 0, queues)
        self.queue: raw.CData = queues[0]
        _open_devices.add(self)

    def _on_error(self, result: int) -> None:
        if result == raw.VK_ERROR_DEVICE_LOST:
            self.lost = True

    def _refuse(self, name: bytes) -> raw.CData:
        raise DeviceError(f"{name.decode()}: {self.name} {self.closed_how}")

    def _destroy(self) -> None:
        """Destroy the VkDevice and its instance; later calls of their functions raise DeviceError."""
        self.vk.vkDestroyDevice(self.handle, raw.NULL)
        self._instance.close()
        self.vk = self.instance_vk = raw.Functions(self._refuse)

    def __reduce__(self) -> NoReturn:
        raise SolariError(f"{self!r} is of this process alone: open a Device in the other one, by the same name")

    def leave_to_parent(self) -> None:
        """Refuse all use in a forked process, where the driver's threads, and so the device's work, don't go on."""
        self.closed = self.forked = True
        self.vk = self.instance_vk = raw.Functions(self._refuse)

    @property
    def closed_how(self) -> str:
        """Why a closed device can't be used, for errors."""
        return _FORKED if self.forked else "was closed"

    def check_open(self) -> None:
        """Raise DeviceError after the device was closed or lost. What writes to mapped memory asks first."""
        if self.closed:
            raise DeviceError(f"{self.name} {self.closed_how}" + ("" if self.forked else ": make a new Device"))
        if self.lost:
            raise DeviceError(f"{self.name} was lost: make a new Device")

    def create(self, type_name: str, create_info: raw.CData, name: str) -> raw.CData:
        """A new handle of a type such as "VkSemaphore", with its debug name; the caller destroys it."""
        out = raw.ffi.new(type_name + "*")
        getattr(self.vk, "vkCreate" + type_name[2:])(self.handle, create_info, raw.NULL, out)
        self.name_object(type_name[2:], out[0], name)
        return out[0]

    # ---- debugging ----------------------------------------------------------------------------------

    @property
    def _has_debug_utils(self) -> bool:
        return "VK_EXT_debug_utils" in self._instance.extensions

    def name_object(self, kind: str, handle: raw.CData, name: str) -> None:
        """Name a handle for debuggers and validation messages; kind: its type without Vk, such as "ImageView"."""
        if not name or not self._has_debug_utils:
            return
        spaced = re.sub("(?<=[a-z])(?=[A-Z])", "_", kind).upper()
        # VK_OBJECT_TYPE_ names are those of the handles with underscores: "ImageView" is IMAGE_VIEW.
        object_type = getattr(raw, f"VK_OBJECT_TYPE_{spaced.removesuffix('KHR').removesuffix('_')}")
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
        self.vk.vkCmdBeginDebugUtilsLabelEXT(command_buffer, _label(name))
        yield
        self.vk.vkCmdEndDebugUtilsLabelEXT(command_buffer)

    def check_messages(self) -> None:
        """Raise ValidationError with the messages that validation has reported since the last call."""
        if self.messages:
            text = "\n".join(self.messages)
            self.messages.clear()
            raise ValidationError(text)


@lru_cache(256)
def _label(name: str) -> raw.CData:
    return raw.struct("VkDebugUtilsLabelEXT", pLabelName=name)


def _leave_devices_to_parent() -> None:
    for device in list(_open_devices):
        device.leave_to_parent()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_devices_to_parent)
