"""The geometries that users pass to builds: triangles and boxes in numpy arrays or in device buffers."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.checks import check_kind, check_switch, numbers, whole_number
from solari_vk.gpu.acceleration.geometry import AABB_DTYPE, AabbGeometry, TriangleGeometry, check_index_type
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device

_PRESENT = 16  # stands for an address, of any alignment, while a structure is created but not built


@dataclass(frozen=True)
class BufferSlice:
    """`count` records in a device buffer from a byte offset on, `stride` bytes apart (0: without gaps).

    The contents aren't checked: the caller must avoid NaN, indices out of range and inverted boxes.
    """

    buffer: Buffer
    count: int
    offset: int = 0
    stride: int = 0

    def __post_init__(self) -> None:
        check_kind(self.buffer, Buffer, "slice: the buffer", "give what Device.buffer makes")
        for field in ("count", "offset", "stride"):
            whole_number(getattr(self, field), f"slice of buffer {self.buffer.name}: {field}")

    def locate(self, what: str, size: int, device: Device | None = None) -> tuple[int, int]:
        """Address and stride of records of `size` bytes; raises SolariError unless all of them lie in the buffer."""
        stride = self.stride or size
        name = self.buffer.name
        if self.buffer.handle is None:
            raise SolariError(f"{what}: buffer {name} was destroyed")
        if device is not None:
            device.check_owns(self.buffer, f"{what}: buffer {name}")
        if self.count < 0 or self.offset < 0 or stride < size:
            layout = f"count {self.count}, offset {self.offset}, stride {stride} of {size}-byte records"
            raise SolariError(f"{what} in buffer {name}: {layout}")
        # The last record has no gap behind it.
        end = self.offset + (self.count - 1) * stride + size if self.count else self.offset
        if end > self.buffer.size:
            raise SolariError(f"{what}: ends at byte {end:,} of buffer {name}, which has {self.buffer.size:,}")
        return self.buffer.address + self.offset, stride


@dataclass(frozen=True)
class TriangleSize:
    """The largest triangle geometry that a Blas is created for; an index_count of 0 means triangles without indices."""

    vertex_count: int
    index_count: int = 0
    index_dtype: Any = np.uint32
    has_transform: bool = False
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    def __post_init__(self) -> None:
        whole_number(self.vertex_count, "triangles: vertex_count", 0)
        whole_number(self.index_count, "triangles: index_count", 0)
        check_index_type(self.index_dtype, "triangles")
        check_switch(self.has_transform, "triangles: has_transform")
        _check_switches(self, "triangles")

    def geometry(self) -> TriangleGeometry:
        """A geometry with these counts, whose addresses only say what a build will give."""
        return TriangleGeometry(
            positions=0,
            position_count=self.vertex_count,
            triangle_count=(self.index_count or self.vertex_count) // 3,
            indices=_PRESENT if self.index_count else 0,
            index_dtype=self.index_dtype,
            transform=_PRESENT if self.has_transform else 0,
            opaque=self.opaque,
            no_duplicate_any_hit=self.no_duplicate_any_hit,
        )


@dataclass(frozen=True)
class AabbSize:
    """The largest geometry of boxes that a Blas is created for."""

    count: int
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    def __post_init__(self) -> None:
        whole_number(self.count, "boxes: count", 0)
        _check_switches(self, "boxes")

    def geometry(self) -> AabbGeometry:
        """A geometry with this count and no address."""
        return AabbGeometry(0, self.count, opaque=self.opaque, no_duplicate_any_hit=self.no_duplicate_any_hit)


@dataclass(frozen=True, eq=False)
class Triangles:
    """A triangle geometry. The build checks and uploads arrays; slices of buffers are used where they are.

    positions: (N, 3) float32, or a slice of such records. indices: (M, 3) uint16 or uint32, or a slice of 3 M indices
    of type index_dtype; by default every three positions are a triangle. transform: (3, 4), or a slice of one such
    record, applied before the instance's transform. opaque: rays commit hits without asking the shader.
    no_duplicate_any_hit: each triangle becomes a candidate at most once.
    """

    positions: Any
    indices: Any = None
    transform: Any = None
    index_dtype: Any = np.uint32
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    def __post_init__(self) -> None:
        # The dataclass is frozen, but arrays are checked and copied once when it is made.
        put: Callable[[str, Any], None] = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731
        check_index_type(self.index_dtype, "triangles")
        _check_switches(self, "triangles")
        if not isinstance(self.positions, BufferSlice):
            put("positions", _floats("positions", self.positions, (-1, 3)))
        if self.indices is not None and not isinstance(self.indices, BufferSlice):
            put("indices", _indices(self.indices, self.positions))
            put("index_dtype", self.indices.dtype.type)
        if self.transform is not None and not isinstance(self.transform, BufferSlice):
            put("transform", _floats("transform", self.transform, (3, 4)))
        if self._corner_count % 3:
            raise SolariError(f"triangles: the number of corners must be a multiple of 3, not {self._corner_count}")

    @property
    def _corner_count(self) -> int:
        return _count(self.positions if self.indices is None else self.indices)

    def geometry(self) -> TriangleGeometry:
        """The geometry that a Blas for it must be created for."""
        return TriangleSize(
            _count(self.positions),
            0 if self.indices is None else self._corner_count,
            self.index_dtype,
            self.transform is not None,
            self.opaque,
            self.no_duplicate_any_hit,
        ).geometry()

    def place(self, uploader: Uploader) -> TriangleGeometry:
        """The geometry in device memory, after queueing its uploads."""
        positions, stride = uploader.place("positions", self.positions, 12)
        size = np.dtype(self.index_dtype).itemsize
        indices, index_stride = (0, size) if self.indices is None else uploader.place("indices", self.indices, size)
        if index_stride != size:
            raise SolariError(f"indices: they lie {index_stride} bytes apart, but must have no gaps between them")
        transform, _ = (0, 0) if self.transform is None else uploader.place("transform", self.transform, 48)
        # The contents of a buffer aren't known here, so the hash stays 0.
        known = isinstance(self.indices, np.ndarray)
        return TriangleGeometry(
            positions,
            _count(self.positions),
            self._corner_count // 3,
            indices=indices,
            index_dtype=self.index_dtype,
            position_stride=stride,
            transform=transform,
            opaque=self.opaque,
            no_duplicate_any_hit=self.no_duplicate_any_hit,
            index_hash=zlib.crc32(self.indices) if known else 0,
        )


@dataclass(frozen=True, eq=False)
class Aabbs:
    """A geometry of boxes whose contents shaders intersect: (N, 6) of minimum and maximum corners, or a slice."""

    boxes: Any
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    def __post_init__(self) -> None:
        _check_switches(self, "boxes")
        if not isinstance(self.boxes, BufferSlice):
            values = numbers(self.boxes, "boxes")
            boxes = _floats("boxes", values.reshape(-1, 6) if values.size % 6 == 0 else values, (-1, 6))
            # Vulkan demands that no minimum lies beyond its maximum.
            inverted = (boxes[:, :3] > boxes[:, 3:]).any(axis=1)
            if inverted.any():
                raise SolariError(f"boxes: number {int(inverted.argmax())} has a minimum beyond its maximum")
            object.__setattr__(self, "boxes", boxes)

    def geometry(self) -> AabbGeometry:
        """The geometry that a Blas for it must be created for."""
        count = self.boxes.count if isinstance(self.boxes, BufferSlice) else len(self.boxes)
        return AabbSize(count, self.opaque, self.no_duplicate_any_hit).geometry()

    def place(self, uploader: Uploader) -> AabbGeometry:
        """The geometry in device memory, after queueing its uploads."""
        address, stride = uploader.place("boxes", self.boxes, AABB_DTYPE.itemsize)
        count = self.geometry().count
        return AabbGeometry(
            address, count, stride=stride, opaque=self.opaque, no_duplicate_any_hit=self.no_duplicate_any_hit
        )


Source = Triangles | Aabbs


class Uploader:
    """Uploads arrays for one build call; `free` releases their memory when the call is done."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.uploads = device.uploads()
        self._buffers: list[Buffer] = []

    def place(self, what: str, data: Any, size: int) -> tuple[int, int]:
        """Address and stride of the records, of `size` bytes, of a slice or of an array, whose upload is queued."""
        if isinstance(data, BufferSlice):
            return data.locate(what, size, self.device)
        buffer = self.device.buffer(data.nbytes, what)
        self._buffers.append(buffer)
        self.uploads.buffer(buffer, data)
        return buffer.address, size

    def free(self) -> None:
        """Destroy the buffers when the work submitted so far is done."""
        for buffer in self._buffers:
            buffer.destroy()


def _check_switches(geometry: Any, what: str) -> None:
    check_switch(geometry.opaque, f"{what}: opaque")
    check_switch(geometry.no_duplicate_any_hit, f"{what}: no_duplicate_any_hit")


def _count(data: Any) -> int:
    if isinstance(data, BufferSlice):
        return data.count
    # Indices count one by one, and positions by rows of three.
    return data.size if data.dtype.kind == "u" else len(data)


def _floats(what: str, values: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    source = numbers(values, what)
    with np.errstate(over="ignore"):  # overflow gives infinity, which is refused below
        array = np.array(source, np.float32, order="C")  # a copy: checked values must not change later
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("N" if n < 0 else str(n) for n in shape)
        raise SolariError(f"{what}: the shape is {array.shape}, not ({wanted})")
    if not np.isfinite(array).all():
        raise SolariError(f"{what}: element {tuple(np.argwhere(~np.isfinite(array))[0].tolist())} is not finite")
    array.setflags(write=False)
    return array


def _indices(values: Any, positions: Any) -> NDArray[Any]:
    # A copy, as of positions: what was checked must not change before the upload.
    array = np.array(numbers(values, "indices"), order="C")
    if array.dtype not in (np.uint16, np.uint32):
        if array.dtype.kind not in "iu" or (array.size and (array.min() < 0 or array.max() >= 2**32)):
            raise SolariError(f"indices: they must be whole numbers from 0 to 2^32 - 1, not {array.dtype}")
        array = array.astype(np.uint32)
    if array.ndim != 2 or array.shape[1] != 3:
        raise SolariError(f"indices: the shape is {array.shape}, not (N, 3)")
    count = _count(positions)
    # An index beyond the positions would read other memory, or lose the device.
    if array.size and int(array.max()) >= count:
        raise SolariError(f"indices: {int(array.max())} is out of range: there are {count} positions")
    array.setflags(write=False)
    return array
