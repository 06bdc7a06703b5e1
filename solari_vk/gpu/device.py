"""An open device: one queue, one timeline that counts submissions, deferred destruction, validation."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from solari_vk.errors import DeviceError, ValidationError
from solari_vk.gpu import memory, raw
from solari_vk.gpu.allocator import Allocator
from solari_vk.gpu.barriers import host_read_barrier
from solari_vk.gpu.barriers import memory_barrier as memory_barrier
from solari_vk.gpu.instance import Instance
from solari_vk.gpu.physical import OPTIONAL_EXTENSIONS, REQUIRED_EXTENSIONS, DeviceReport, choose, feature_chain
from solari_vk.gpu.submission import Submission as Submission
from solari_vk.gpu.uploads import StagingPool, Uploads

_WAIT_SLICE = 100_000_000  # nanoseconds: Python sees Ctrl-C between slices


class Device:
    """A Vulkan 1.3 device with ray queries, opened. Use it in one thread; a context manager.

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
        self.submitted = 0
        self._host_synced = 0
        self._owned: dict[int, Callable[[], None]] = {}
        self._next_token = 0
        self._retired: deque[tuple[int, Callable[[], None]]] = deque()
        self._retired_with_next: list[Callable[[], None]] = []
        self._before_next: list[Callable[[raw.CData], None]] = []
        self._instance = Instance(self.validation)
        try:
            chosen = choose(self._instance.devices(), os.environ.get("SOLARI_VK_DEVICE") if select is None else select)
            self._open(chosen)
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
        self.timeline = self.create(
            "VkSemaphore",
            raw.struct(
                "VkSemaphoreCreateInfo",
                pNext=raw.struct("VkSemaphoreTypeCreateInfo", semaphoreType=raw.VK_SEMAPHORE_TYPE_TIMELINE),
            ),
            "device timeline",
        )
        self._pool = self.create(
            "VkCommandPool",
            raw.struct(
                "VkCommandPoolCreateInfo",
                flags=raw.VK_COMMAND_POOL_CREATE_TRANSIENT_BIT,
                queueFamilyIndex=self.queue_family,
            ),
            "device one-time commands",
        )
        self._counter = raw.ffi.new("uint64_t*")
        self._wait_value = raw.ffi.new("uint64_t*")
        self._wait_info = raw.struct(
            "VkSemaphoreWaitInfo", semaphoreCount=1, pSemaphores=[self.timeline], pValues=self._wait_value
        )
        self._completed = 0

    def _refuse(self, name: bytes) -> raw.CData:
        raise DeviceError(f"{name.decode()} on {self.name}, which was closed")

    def _on_error(self, result: int) -> None:
        if result == raw.VK_ERROR_DEVICE_LOST:
            self.lost = True

    # ---- submissions --------------------------------------------------------------------------------

    def submission(
        self,
        command_buffers: Sequence[raw.CData],
        *,
        waits: Sequence[tuple[raw.CData, int, int]] = (),
        signals: Sequence[tuple[raw.CData, int, int]] = (),
    ) -> Submission:
        """A submission prepared once and made many times; waits and signals are (semaphore, value, stages)."""
        return Submission(self, command_buffers, waits, signals)

    def submit(self, command_buffers: Sequence[raw.CData]) -> int:
        """Submit command buffers; returns the value that the timeline reaches when they are done."""
        return Submission(self, command_buffers).submit()

    def before_next_submit(self, record: Callable[[raw.CData], None]) -> None:
        """Have commands recorded and submitted just before the next submission: all such in one batch."""
        self._before_next.append(record)

    def _submit(self, submission: Submission, *, internal: bool = False) -> int:
        if self.lost:
            raise DeviceError(f"{self.name} was lost: make a new Device")
        if self._before_next and not internal:
            self.flush()
        value = self.submitted + 1
        submission.signal.value = value
        self.vk.vkQueueSubmit2(self.queue, 1, submission.info, raw.NULL)
        self.submitted = value
        if self._retired_with_next and not internal:
            self._retired.extend((value, destroy) for destroy in self._retired_with_next)
            self._retired_with_next.clear()
        if self._retired:
            self.collect()
        if self.messages:
            self.check_messages()
        return value

    def flush(self) -> None:
        """Submit now what `before_next_submit` has gathered."""
        if records := self._before_next:
            self._before_next = []

            def record_all(cmd: raw.CData) -> None:
                for record in records:
                    record(cmd)

            self._start(record_all, "prepare resources")

    def start(self, record: Callable[[raw.CData], None], name: str = "") -> int:
        """Record one-time commands and submit them without waiting; returns the timeline's value."""
        self.flush()
        return self._start(record, name)

    def run(self, record: Callable[[raw.CData], None], name: str = "") -> None:
        """Record one-time commands, submit them and wait until they are done."""
        self.wait(self.start(record, name))

    def _start(self, record: Callable[[raw.CData], None], name: str) -> int:
        allocate = raw.struct(
            "VkCommandBufferAllocateInfo",
            commandPool=self._pool,
            level=raw.VK_COMMAND_BUFFER_LEVEL_PRIMARY,
            commandBufferCount=1,
        )
        buffers = raw.ffi.new("VkCommandBuffer[1]")
        self.vk.vkAllocateCommandBuffers(self.handle, allocate, buffers)
        commands = buffers[0]

        def free() -> None:
            self.vk.vkFreeCommandBuffers(self.handle, self._pool, 1, buffers)

        try:
            self.name_object("command_buffer", commands, name)
            begin = raw.struct("VkCommandBufferBeginInfo", flags=raw.VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT)
            self.vk.vkBeginCommandBuffer(commands, begin)
            with self.label(commands, name or "one-time commands"):
                record(commands)
            self.vk.vkEndCommandBuffer(commands)
        except BaseException:
            free()
            raise
        value = self._submit(Submission(self, [commands]), internal=True)
        self.retire(free)
        return value

    @property
    def completed(self) -> int:
        """The newest timeline value whose work is done."""
        if self._completed < self.submitted:
            self.vk.vkGetSemaphoreCounterValue(self.handle, self.timeline, self._counter)
            self._completed = self._counter[0]
        return self._completed

    @property
    def idle(self) -> bool:
        """Whether no work is running or waiting to be submitted."""
        return not self._before_next and self.completed == self.submitted

    def wait(self, value: int) -> None:
        """Wait until the timeline has reached a value that a submission returned."""
        if self.lost:
            raise DeviceError(f"{self.name} was lost: make a new Device")
        if value > self.submitted:
            raise DeviceError(f"waiting for submission {value}, but only {self.submitted} were made")
        self._wait_value[0] = value
        while self._completed < value:
            if self.vk.vkWaitSemaphores(self.handle, self._wait_info, _WAIT_SLICE) == raw.VK_SUCCESS:
                self._completed = max(self._completed, value)
        self.collect()
        self.check_messages()

    def wait_idle(self) -> None:
        """Wait for everything submitted so far."""
        self.wait(self.submitted)

    def sync_host(self) -> None:
        """Wait for everything submitted and make what it wrote visible to the host (mapped memory)."""
        if self.submitted == self._host_synced and not self._before_next:
            return
        self.run(lambda cmd: self.vk.vkCmdPipelineBarrier2(cmd, host_read_barrier()), "host reads")
        self._host_synced = self.submitted

    # ---- lifetime -----------------------------------------------------------------------------------

    def create(self, type_name: str, create_info: raw.CData, name: str) -> raw.CData:
        """vkCreate of a handle type such as "VkSemaphore", with its debug name; the caller destroys it."""
        out = raw.ffi.new(type_name + "*")
        getattr(self.vk, "vkCreate" + type_name[2:])(self.handle, create_info, raw.NULL, out)
        self.name_object(type_name[2:], out[0], name)
        return out[0]

    def own(self, destroy: Callable[[], None]) -> int:
        """Remember how an object is destroyed; returns a token for `release`. `close` destroys the rest."""
        self._next_token += 1
        self._owned[self._next_token] = destroy
        return self._next_token

    def release(self, token: int) -> None:
        """Destroy an owned object once the work submitted so far is done; no effect the second time."""
        destroy = self._owned.pop(token, None)
        if destroy is not None:
            self.retire(destroy)

    @property
    def live_objects(self) -> int:
        """How many owned objects exist, those that wait for their destruction included."""
        return len(self._owned) + len(self._retired) + len(self._retired_with_next)

    def retire(self, destroy: Callable[[], None], *, with_next: bool = False) -> None:
        """Call `destroy` when all work submitted so far is done; with_next: and the next submission too."""
        if self.closed:
            raise DeviceError(f"{self.name} was closed")
        if with_next:
            self._retired_with_next.append(destroy)
        else:
            self._retired.append((self.submitted, destroy))
            self.collect()

    def collect(self) -> None:
        """Destroy what was retired and is no longer used."""
        if not self._retired or self.lost:
            return
        completed = self.completed
        while self._retired and self._retired[0][0] <= completed:
            self._retired.popleft()[1]()

    def close(self) -> None:
        """Wait for the device, destroy all that is left, and close it. Safe to call twice.

        A lost device is not waited for. Raises ValidationError if messages are left.
        """
        if self.closed:
            return
        self.closed = True
        wait = raw.ffi.cast("PFN_vkWaitSemaphores", raw.lib.vkGetDeviceProcAddr(self.handle, b"vkWaitSemaphores"))
        self._wait_value[0] = self.submitted
        waited = 0
        while wait(self.handle, self._wait_info, _WAIT_SLICE) == raw.VK_TIMEOUT and not (self.lost and waited > 10):
            waited += 1
        retired = [destroy for _, destroy in self._retired]
        for destroy in [*retired, *self._retired_with_next, *reversed(self._owned.values())]:
            destroy()
        self._retired.clear()
        self._retired_with_next.clear()
        self._owned.clear()
        self.memory.close()
        self.vk.vkDestroyCommandPool(self.handle, self._pool, raw.NULL)
        self.vk.vkDestroySemaphore(self.handle, self.timeline, raw.NULL)
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
