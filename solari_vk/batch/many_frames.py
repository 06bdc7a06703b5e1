"""Several frames of a batch in one submission: `Batch.render_many`, and the results that it keeps of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.base.host_array import host_array
from solari_vk.batch import view_cameras
from solari_vk.batch.worlds import Worlds
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.gpu.tensors.port import TensorPort
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Camera, Instance

WHERE = "Batch.render_many"


class Result(NamedTuple):
    """A result of a batch. frame: has it as its resource, of so many values of a dtype. shaped: makes (N, height,
    width[, channels]) of these values."""

    frame: SceneFrame
    resource: str
    dtype: np.dtype[Any]
    value_count: int
    shaped: Callable[[Any], Any]

    @property
    def size(self) -> int:
        """In bytes."""
        return self.value_count * self.dtype.itemsize

    def record_copy(self, cmd: raw.CData, target: Buffer, begin: int) -> None:
        """Record a copy of the latest frame's to a byte of a buffer."""
        source: Buffer | Image = self.frame.resource(self.resource)
        if isinstance(source, Image):
            source.record_copy(cmd, target.handle, begin=begin)
        else:
            offset = self.frame.binding(self.resource).element_offset
            source.record_copy(cmd, target.handle, size=self.size, offset=offset, begin=begin)


class LentMemory:
    """Memory that arrays and tensors may show. It stays as long as one of them does, also after `close`.

    free: frees it, and may be called twice.
    """

    def __init__(self, device: Device, free: Callable[[], None]) -> None:
        self.is_closed = False
        self._device = device
        self._free = free
        self._arrays = 0

    def lend(self, memory: NDArray[Any]) -> None:
        """Count an array that shows the memory, until it and all that was made of it are gone."""
        self._arrays += 1
        self._device.loans.lend(memory, self._take_back)

    def _take_back(self) -> None:
        self._arrays -= 1
        if self.is_closed:
            self.close()

    def close(self) -> None:
        """Free the memory, when no array shows it any more. Safe to call twice."""
        self.is_closed = True
        if not self._arrays:
            self._free()


class FrameMemory(LentMemory):
    """The memory of the results of several frames, by their names."""

    def __init__(self, device: Device, results: Mapping[str, Result], frames: int) -> None:
        super().__init__(device, self._destroy)
        self.frames = frames
        self.buffers: dict[str, Buffer] = {}
        with device.undone_on_error():
            for name, result in results.items():
                self.buffers[name] = device.buffer(frames * result.size, f"frames of {name}")

    def fits(self, results: Mapping[str, Result], frames: int) -> bool:
        """Whether there is room for just these results."""
        sizes = [(name, frames * result.size) for name, result in results.items()]
        return sizes == [(name, buffer.size) for name, buffer in self.buffers.items()]

    def _destroy(self) -> None:
        for buffer in self.buffers.values():
            buffer.destroy()


class FrameResults(Mapping[str, NDArray[Any]]):
    """What several frames of a batch show: results by their names, (frames, N, height, width[, channels]).

    They are these until the batch renders many frames again, or is closed; arrays are copies.
    """

    _is_over = False

    def __init__(
        self, device: Device, results: Mapping[str, Result], memory: FrameMemory, check_tensors: Callable[[], None]
    ) -> None:
        self.memory = memory
        self._device = device
        self._results = dict(results)
        self._frames = memory.frames
        self._check_tensors = check_tensors

    def copy_results(self, index: int, results: Mapping[str, Result]) -> None:
        """Have the device copy what the latest frame shows, which is number `index`."""
        self._results = dict(results)

        def record(cmd: raw.CData) -> None:
            # After the frame that made the results, and before the next one overwrites them.
            self._device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            for name, result in results.items():
                result.record_copy(cmd, self.memory.buffers[name], index * result.size)
            self._device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

        self._device.start(record, "results of a frame")

    def _of(self, name: str) -> tuple[Result, Buffer]:
        if name not in self._results:
            raise unknown_name(f"{WHERE} kept no result", name, self._results)
        if self._is_over:
            raise SolariError(f"there is no '{name}' any more: the batch was closed, or has rendered many frames again")
        return self._results[name], self.memory.buffers[name]

    def __getitem__(self, name: str) -> NDArray[Any]:
        result, buffer = self._of(name)
        values = buffer.read(result.dtype, self._frames * result.value_count).reshape(self._frames, result.value_count)
        # What was wrong in tensors of these frames is known now that the device has rendered them.
        self._check_tensors()
        return np.stack([result.shaped(one) for one in values])

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        """A result that stays on the device, as `Batch.tensor` has those of the latest frame."""
        result, buffer = self._of(name)
        if isinstance(result.frame.resource(result.resource), Image):
            raise SolariError(f"{WHERE}: '{name}' is an image: frames['{name}'] copies it")
        count = self._frames * result.value_count
        if buffer.mapped:
            # The host sees the device's memory: an array shows it without a copy.
            self._device.sync_host()
            memory = buffer.view(result.dtype, count)
            self.memory.lend(memory)
            first = result.shaped(memory[: result.value_count])
            shown: NDArray[Any] = memory.view(first.dtype).reshape(self._frames, *first.shape)
            return shown
        if self._device.properties.kind == "cpu":
            return self[name]
        shape = result.shaped(np.empty(result.value_count, result.dtype)).shape
        copy = partial(buffer.record_copy, size=buffer.size)
        return self._device.cuda_for(name).export(copy, (self._frames, *shape), result.dtype)

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)

    def end(self) -> None:
        """Have no results any more: the memory has, or will have, those of other frames."""
        self._is_over = True


def accept_cameras(port: TensorPort, cameras: Any, where: str, *shapes: tuple[int, ...]) -> Any:
    """Cameras, those of a tensor of the device in its memory."""
    return port.accept_shaped(cameras, "cameras", *shapes, where=where) or cameras


def cameras_of(frames: int, views: int, cameras: Any, port: TensorPort) -> Sequence[Any]:
    """The cameras of each frame: those of all, or for each its own."""
    cameras = accept_cameras(port, cameras, WHERE, (views, 4, 4), (frames, views, 4, 4))
    if isinstance(cameras, DeviceTensor):
        return [cameras if len(cameras.shape) == 3 else cameras.at(index) for index in range(frames)]
    if _is_camera_list(cameras):
        return [cameras] * frames
    if isinstance(cameras, (list, tuple)) and any(map(_is_camera_list, cameras)):
        lists = [one for one in cameras if _is_camera_list(one)]
        if len(lists) != len(cameras) or len(cameras) != frames:
            raise SolariError(f"{WHERE}: give {frames} lists of cameras, one for each frame, not {len(lists)}")
        return lists
    shape = views, 4, 4
    transforms = view_cameras.array(cameras, "cameras", shape, (frames, *shape), where=WHERE)
    return list(np.broadcast_to(transforms, (frames, *shape)))


def _is_camera_list(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and isinstance(value[0], Camera)


def transforms_of(frames: int, worlds: Worlds, transforms: Any) -> list[list[tuple[Instance, Any]]]:
    """What to replace in the transforms of worlds before each frame."""
    if not isinstance(transforms, Mapping | None):
        raise SolariError(f"{WHERE}: transforms is a dictionary of arrays by instance, not {quoted(transforms)}")
    moves: list[list[tuple[Instance, Any]]] = [[] for _ in range(frames)]
    for key, values in (transforms or {}).items():
        overrides = worlds.transforms
        what = f"transforms of {key}"
        shape = (frames, worlds.count, 4, 4)
        tensor = overrides.accept_tensor(values, what, shape, where=WHERE)
        parts: Any
        if tensor is not None:
            parts = [tensor.at(index) for index in range(frames)]
        else:
            parts = view_cameras.array(values, what, shape, where=WHERE)
        for of_frame, part in zip(moves, parts, strict=True):
            of_frame.append(overrides.checked(key, part))
    return moves


def resets_of(frames: int, views: int, reset: Any) -> NDArray[np.bool_]:
    """The views (frames, N) that are reset, of all or some in the first frame, or in each."""
    try:
        mask = host_array(reset)
    except (TypeError, ValueError, RuntimeError):
        mask = np.zeros(0)
    if mask.dtype != np.bool_ or mask.shape not in ((), (views,), (frames, views)):
        raise SolariError(
            f"{WHERE}: reset is True, False or an array ({views},) or ({frames}, {views}) of these, not {quoted(reset)}"
        )
    if mask.ndim == 2:
        return mask
    # A mask of one frame is that of the first: the others follow it.
    resets = np.zeros((frames, views), bool)
    resets[0] = mask
    return resets


def seeds_of(frames: int, views: int, seeds: Any) -> Sequence[Any]:
    """The seeds of each frame, None for those that the batch has."""
    if seeds is None:
        return [None] * frames
    numbers = view_cameras.array(seeds, "seeds", (views,), (frames, views), where=WHERE)
    return list(np.broadcast_to(numbers, (frames, views)))
