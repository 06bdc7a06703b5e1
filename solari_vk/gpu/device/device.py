"""`Device`: what users open. It makes buffers, images, samplers and batches of uploads, and closes what it owns."""

from __future__ import annotations

import os
from functools import cached_property
from typing import Any, Literal

from solari_vk.base.errors import DeviceError, SolariError, checked_keywords, quoted
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.compiling import OnCompile
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.device.instance import Instance
from solari_vk.gpu.device.logical import asked_for
from solari_vk.gpu.device.physical import DeviceReport, choose
from solari_vk.gpu.device.pipeline_cache import PipelineCache
from solari_vk.gpu.device.sampler import Sampler
from solari_vk.gpu.device.shared_objects import SharedObjects
from solari_vk.gpu.device.uploads import StagingPool, Uploads
from solari_vk.gpu.device.work_queue import WorkQueue
from solari_vk.gpu.tensors.exports import TensorExports
from solari_vk.gpu.tensors.imports import TensorImports

_UNUSED_PIPELINES = 256  # a realtime frame has about 40


class Device(WorkQueue):
    """A Vulkan 1.3 device that traces rays, opened. Use it in one thread; a context manager.

    Submitting, waiting and deferred destruction are those of `WorkQueue`.

    select: part of a device's name, its index, its UUID, "gpu" or "cpu"; by default SOLARI_VK_DEVICE, else the best.
    validation: core and synchronization validation; by default on when SOLARI_VK_VALIDATION=1. Extensions
    newer than the installed layer, such as position fetch, are off while validation is on. A software device then has
    its buffers bound by descriptors, unless SOLARI_VK_ADDRESSES=1.
    staging: treat device memory as not mappable, as on a discrete GPU; by default SOLARI_VK_STAGING=1.
    rays: how shaders trace: "query" (VK_KHR_ray_query), "pipeline" (VK_KHR_ray_tracing_pipeline), "compute" (needs no
    extension: compute shaders build trees of boxes and traverse them), or "auto": the first of these that the device
    has, but "compute" before "pipeline", and on cards of which no list says whether they have units for rays the faster
    of "query" and "compute", which is measured once and kept; by default SOLARI_VK_RAYS, else "auto". The attribute
    `rays` says which.
    on_compile: called with a `Compiling` before each shader and pipeline that is compiled, and at the end of each list;
    by default "stderr": there it is said what takes more than 3 seconds; None: nothing is said. The attribute may be
    assigned at any time. Unless it is None, the first frame's `render` waits while a software device compiles.
    Raises DeviceError when no device fits, saying what each one lacks, and SolariError for another value of `rays`.
    """

    @checked_keywords()
    def __init__(
        self,
        select: str | int | None = None,
        *,
        validation: bool | None = None,
        staging: bool | None = None,
        rays: str | None = None,
        on_compile: OnCompile | Literal["stderr"] | None = "stderr",
    ) -> None:
        if not (on_compile is None or on_compile == "stderr" or callable(on_compile)):
            raise SolariError(f"on_compile is a function, None or 'stderr', not {quoted(on_compile)}")
        super().__init__(select, _flag("SOLARI_VK_VALIDATION") if validation is None else validation, rays)
        self.on_compile: OnCompile | None = CompileNotes() if on_compile == "stderr" else on_compile
        self.staging = _flag("SOLARI_VK_STAGING") if staging is None else staging
        # Software drivers compile and run access by addresses much faster; validation can't follow such accesses.
        self.buffers_by_address = self.properties.kind == "cpu" and (
            not self.validation or _flag("SOLARI_VK_ADDRESSES")
        )
        # Without descriptor indexing the limits of descriptors are low, too: 32 storage buffers in Mesa 22.3.
        self.buffers_by_address |= not self.has_descriptor_indexing
        """Whether compute shaders access storage buffers by their addresses (`access_by_address`)."""
        # Mapped device memory saves a copy; `staging` behaves as a card whose memory the host can't see.
        self.memory = Allocator(self, map_device_memory=not self.staging)
        self.staging_pool = StagingPool(self.memory)
        self._samplers: dict[tuple[Any, ...], Sampler] = {}
        self.pipelines: SharedObjects[Any] = SharedObjects(_UNUSED_PIPELINES)

    def buffer(self, size_bytes: int, name: str, **options: Any) -> Buffer:
        """A new `Buffer`; options are its keyword arguments."""
        return Buffer(self.staging_pool, size_bytes, name, **options)

    def image(self, width: int, height: int, format: int, name: str, **options: Any) -> Image:
        """A new `Image`; options are its keyword arguments."""
        return Image(self.staging_pool, width, height, format, name, **options)

    def sampler(self, **options: Any) -> Sampler:
        """A `Sampler` with these keyword arguments, shared by all callers that ask for the same."""
        key = tuple(sorted(options.items()))
        # Drivers limit the number of samplers (maxSamplerAllocationCount), and few differ.
        if key not in self._samplers:
            self._samplers[key] = Sampler(self, shared=True, **options)
        return self._samplers[key]

    @cached_property
    def pipeline_cache(self) -> PipelineCache:
        """What all pipelines of the device are created with."""
        return PipelineCache(self)

    @cached_property
    def cuda(self) -> TensorExports:
        """Makes tensors that CUDA shares. Raises DeviceError, with the reason, where it can't."""
        return TensorExports(self, self.memory)

    @cached_property
    def tensor_imports(self) -> TensorImports:
        """Copies tensors of CUDA's libraries to the device. Raises DeviceError, with the reason, where it can't."""
        return TensorImports(self.cuda, self, self.buffer)

    @property
    def has_tensor_imports(self) -> bool:
        """Whether `tensor_imports` was made, which shows that CUDA shares the device."""
        return "tensor_imports" in vars(self)

    def cuda_for(self, name: str) -> TensorExports:
        """`cuda`, for a tensor of what has this name. Raises SolariError, with the reason, where there is none."""
        try:
            return self.cuda
        except DeviceError as error:
            raise SolariError(f"there is no tensor of {name} on the device: {error}: read it to the host") from None

    def uploads(self) -> Uploads:
        """A batch of uploads: `with device.uploads() as uploads:` makes one submission at its end."""
        return Uploads(self.staging_pool)

    def check_owns(self, made: Any, what: str) -> None:
        """Raise SolariError for an object that holds something of another device. what: begins the message."""
        if getattr(made, "device", self) is not self:
            raise SolariError(f"{what} belongs to another device: make it with the one that uses it")

    def trim(self) -> None:
        """Free compiled pipelines that nothing uses, and memory that data was copied through.

        Else up to 256 of them stay, so that the next renderer doesn't wait for the driver's compiler.
        """
        self.pipelines.clear()
        self.staging_pool.trim()

    def close(self) -> None:
        """Wait for the device, destroy everything that is left, and close it. Safe to call twice.

        Memory that tensors of a `Batch` show stays until they are gone. A lost device is not waited for. Raises
        ValidationError if messages are left.
        """
        if self.closed:
            return
        try:
            # While the device still works, and before its memory is lent on or freed.
            if self.has_tensor_imports:
                self.tensor_imports.move_to_host()
            if not self.lost:
                self._hand_over()
        finally:
            self.collect()
            self.closed = True
            # Memory that others still see must outlive this call: the last view ends the device.
            self.loans.close(self._end)

    def _end(self) -> None:
        self._finish()
        self.memory.close()
        self._destroy_queue()
        self._destroy()
        self.check_messages()

    def __repr__(self) -> str:
        state = self.closed_how if self.closed else f"rays by {self.rays}"
        return f"<Device '{self.name}', {self.properties.kind}, {state}>"

    def __enter__(self) -> Device:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@checked_keywords(who="solari_vk")
def list_devices() -> list[DeviceReport]:
    """Every Vulkan device of this machine with what it lacks; raises DeviceError without a driver."""
    instance = Instance()
    try:
        return [device.report() for device in instance.devices()]
    finally:
        instance.close()


def kind_of_device(select: str | int | None = None, rays: str | None = None) -> str:
    """The kind of the device that `Device(select, rays=rays)` opens: "discrete gpu", "integrated gpu", "virtual gpu",
    "cpu" or "other". Raises as it does."""
    instance = Instance()
    try:
        wanted, rays = asked_for(select, rays)
        return choose(instance.devices(), wanted, rays).properties.kind
    finally:
        instance.close()


def _flag(variable: str) -> bool:
    return os.environ.get(variable, "0") not in ("", "0")
