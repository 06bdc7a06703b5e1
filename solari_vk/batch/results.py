"""The results of a batch: as arrays, and as tensors that stay on the device."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import Hints, SolariError, unknown_name
from solari_vk.batch.batch_renderers import BatchPathTracer, BatchRenderer
from solari_vk.batch.many_frames import FrameResults, LentMemory, Result
from solari_vk.batch.options import RADIANCE_NAMES
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.renderers.scene_frame import SceneFrame, bind_scene
from solari_vk.scene.model import Material, Scene


class BatchResults(Hints):
    """A batch with what its latest frames show. `_labels`, `_paths` and `_realtime` are its frames."""

    size: tuple[int, int]
    views: int
    _names: tuple[str, ...] = ()
    _rendered = False
    _many: FrameResults | None = None
    _labels: SceneFrame | None = None
    _paths: BatchPathTracer | None = None
    _realtime: BatchRenderer | None = None

    def __init__(self, device: Device, scene: Scene | SceneBinder | Sequence[Scene]) -> None:
        self.device = device
        self._owned = ExitStack()
        self._memory = LentMemory(device, self._owned.close)
        self.binder = bind_scene(device, scene, type(self).__name__, self._owned, many=True)
        # Poses have a port of their own: what it refuses concerns this batch, and no other renderer of the binder.
        try:
            self._port = TensorPort(device)
        except BaseException:
            self._owned.close()
            raise
        self._owned.callback(self._port.destroy)

    def keys(self) -> list[str]:
        """The names of the results."""
        return list(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A copy of a result of the latest frame, (N, height, width[, channels]). Waits for the frame."""
        result = self._result(name)
        buffer: Buffer | Image = result.frame.resource(result.resource)
        if isinstance(buffer, Image):
            values = buffer.read()
        else:
            values = buffer.read(result.dtype, result.value_count, result.frame.binding(result.resource).element_offset)
        self._check_tensors()
        read: NDArray[Any] = result.shaped(values)
        return read

    def _result(self, name: str) -> Result:
        frame, resource = self._place(name)
        buffer: Buffer | Image = frame.resource(resource)
        if isinstance(buffer, Image):
            assert self._realtime is not None
            return Result(frame, resource, buffer.dtype, math.prod(buffer.level_shape(0)), self._realtime.picture_of)
        element = frame.binding(resource).element
        assert element is not None
        # The grid of realtime views may have more places than views, which come last.
        count = self._pixels(name) * math.prod(element.shape)
        return Result(frame, resource, element.base, count, partial(self._shaped, name))

    def _size_of(self, name: str) -> tuple[int, int]:
        """The width and height of a result of a view: what is rendered is smaller than the picture with upscale."""
        return self._realtime.render_size if self._realtime is not None and name == "raw_radiance" else self.size

    def _pixels(self, name: str) -> int:
        return self.views * math.prod(self._size_of(name))

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        """A result of the latest frame that stays on the device, (N, height, width[, channels]).

        On software devices, and others whose memory the host sees, it is an array in the device's own memory, without a
        copy. It waits for the frame, and shows later frames too: take it again after each `render`, which waits. On
        NVIDIA devices it is a copy on the device that later frames don't change, without waiting, for CUDA: see
        `RenderedFrame.tensor`. Both, and what `torch.from_dlpack` and others make of them, keep their memory when the
        batch and the device are closed. Raises SolariError, with the reason, where the device can't share its memory.
        """
        result = self._result(name)
        buffer: Buffer | Image = result.frame.resource(result.resource)
        if isinstance(buffer, Image):
            raise SolariError(f"Batch.tensor: '{name}' is an image: batch['{name}'] copies it")
        tensor: NDArray[Any] | CudaTensor
        if not buffer.mapped:
            # CUDA gets a copy in memory that it shares with Vulkan.
            tensor = self._shaped(name, result.frame.tensor(result.resource, self._pixels(name)))
            return tensor
        self.device.sync_host()
        memory = buffer.view(result.dtype, result.value_count)
        self._memory.lend(memory)
        tensor = self._shaped(name, memory)
        return tensor

    def _place(self, name: str) -> tuple[SceneFrame, str]:
        """The frame that has a result, and the name of its buffer."""
        self._check_open()
        if name not in self._names:
            raise unknown_name("Batch: there is no result", name, self._names)
        if not self._rendered:
            raise SolariError(f"Batch: render before asking for '{name}'")
        if self._realtime is not None and name in RADIANCE_NAMES["realtime"]:
            return self._realtime.frame, name
        if self._paths is not None and name in RADIANCE_NAMES["reference"]:
            return self._paths.frame, "radiance_mean"
        assert self._labels is not None
        return self._labels, f"aov_{name}"

    def _shaped(self, name: str, values: Any) -> Any:
        # -1 for none, as hits of RayTracer have it.
        if name == "primitive" and isinstance(values, np.ndarray):
            values = values.view(np.int32)
        width, height = self._size_of(name)
        channels = math.prod(values.shape) // self._pixels(name)
        return values.reshape(self.views, height, width, *((channels,) if channels > 1 else ()))

    @property
    def instances(self) -> dict[int, Any]:
        """The scene's instances by the numbers in `batch["instance_id"]`. With a list of scenes, these for each world:
        `batch.instances[world][number]`."""
        if self.binder.has_many_scenes:
            return {world: records.instances for world, records in enumerate(self.binder.listed_records)}
        return self.binder.instances

    @property
    def materials(self) -> dict[int, Material]:
        """The scene's materials by the numbers in `batch["material_id"]`."""
        return self.binder.materials.by_row

    def close(self) -> None:
        """Free everything on the device, when no tensor needs it any more. Safe to call twice."""
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<Batch of {self.views} views {width}x{height} on {self.device.name}: {', '.join(self._names)}>"

    def _check_open(self) -> None:
        if self._memory.is_closed:
            raise SolariError("nothing can be rendered or read: the batch was closed; make a new one")

    def _check_tensors(self) -> None:
        """Raise SolariError for a number of a tensor that was refused: of the scene's assets, or of poses."""
        self.binder.tensors.check()
        self._port.check()

    def _close_many(self) -> None:
        if self._many is not None:
            self._many.end()
            self._many.memory.close()
            self._many = None
