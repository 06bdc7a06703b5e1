"""Uploads: many small copies into buffers and images, gathered into one submission."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.allocator import Allocator
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.storage import Storage, as_bytes

CHUNK_SIZE = 4 << 20
LARGEST_CACHED = 256 << 20  # of the larger chunks that were read through one is kept, for results of each frame
FLUSH_SIZE = 64 << 20  # a larger batch is submitted in parts, which bounds staging memory
_ALIGNMENT = 16  # bytes between pieces of data in a chunk: no texel that is uploaded is larger
_TRANSFER_LAYOUT = raw.VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL


class StagingPool:
    """Mapped chunks that uploads and reads are copied through, each used again when the device is done with it."""

    def __init__(self, memory: Allocator) -> None:
        self.memory = memory
        self.device = memory.device
        self._chunks: list[Storage] = []
        self._large: Storage | None = None
        # What is kept for later goes first when memory runs out.
        memory.on_shortage = self.trim

    def take(self, size: int) -> Storage:
        """A mapped buffer of at least `size` bytes; return it with `give` when the copy is done."""
        # Small pieces share the size of a chunk, so that any free chunk serves any of them.
        if size <= CHUNK_SIZE and self._chunks:
            return self._chunks.pop()
        if size > CHUNK_SIZE and self._large is not None and size <= self._large.size:
            chunk, self._large = self._large, None
            return chunk
        return Storage(self.memory, max(size, CHUNK_SIZE), "staging", host=True, shared=True)

    def give(self, chunk: Storage, *, was_read: bool = False) -> None:
        """Take a chunk back that the device no longer uses. The pool keeps up to 16 chunks of ordinary size, and the
        latest larger one that results were read through."""
        if self.device.closed:
            return
        # Results of a frame have the same size in each frame; uploads of large scenes happen once.
        if was_read and CHUNK_SIZE < chunk.size <= LARGEST_CACHED:
            self._free_large()
            self._large = chunk
        elif chunk.size == CHUNK_SIZE and len(self._chunks) < 16:
            self._chunks.append(chunk)
        else:
            chunk.destroy()

    def trim(self) -> None:
        """Free all chunks that are kept."""
        self._free_large()
        while self._chunks:
            self._chunks.pop().destroy()

    def _free_large(self) -> None:
        if self._large is not None:
            self._large.destroy()
            self._large = None

    def read_back(self, size: int, copy: Callable[[raw.CData, raw.CData], None]) -> np.ndarray:
        """The bytes that `copy(command buffer, VkBuffer)` writes into a chunk; waits for the copy."""
        device = self.device
        chunk = self.take(size)

        def record(cmd: raw.CData) -> None:
            device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            copy(cmd, chunk.handle)
            device.vk.vkCmdPipelineBarrier2(cmd, host_read_barrier())

        try:
            device.run(record, "read back")
            return chunk.view(np.uint8, size).copy()
        finally:
            self.give(chunk, was_read=True)


class ImageTarget(Protocol):
    """What an upload needs to know of an `Image`."""

    handle: raw.CData
    layout: int

    def check_levels(self, levels: Sequence[np.ndarray]) -> list[np.ndarray]: ...

    def copy_region(self, level: int, buffer_offset: int) -> dict[str, Any]: ...

    def layout_change(self, old: int, new: int) -> raw.CData: ...


class _Copies:
    """Buffer copies whose targets don't overlap, so that no barrier is needed between them."""

    def __init__(self) -> None:
        self.regions: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        self.buffers: dict[tuple[int, int], tuple[Storage, Storage]] = {}
        self._ranges: dict[int, list[tuple[int, int]]] = {}

    def add(self, chunk: Storage, start: int, buffer: Storage, offset: int, size: int) -> bool:
        """Add a copy and return True; return False if it overlaps one that was added before."""
        ranges = self._ranges.setdefault(id(buffer), [])
        i = bisect_left(ranges, (offset, 0))
        if (i and ranges[i - 1][1] > offset) or (i < len(ranges) and ranges[i][0] < offset + size):
            return False
        insort(ranges, (offset, offset + size))
        key = (id(chunk), id(buffer))
        self.buffers[key] = (chunk, buffer)
        self.regions.setdefault(key, []).append((start, offset, size))
        return True


class Uploads:
    """A batch of uploads. As a context manager it submits once at its end, in order with other submissions.

    Data is copied when `buffer` or `image` is called, so arrays may change afterwards. Work submitted later sees the
    new contents.
    """

    def __init__(self, staging: StagingPool) -> None:
        self._staging = staging
        self._device = staging.device
        self._reset()

    def _reset(self) -> None:
        self._chunks: list[Storage] = []
        self._used = 0
        self._staged = 0
        self._copies: list[_Copies] = []
        self._images: list[tuple[Storage, ImageTarget, list[tuple[int, int]]]] = []

    def __enter__(self) -> Uploads:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            if kind is None and not self._empty:
                self._device.start(self._record, "uploads")
        finally:
            self._give_back()

    @property
    def _empty(self) -> bool:
        return not self._copies and not self._images

    def buffer(self, buffer: Storage, data: Any, offset: int = 0) -> None:
        """Upload `data` (an array or bytes) to a byte offset of a buffer. Raises SolariError beyond its end."""
        source = as_bytes(data)
        buffer.check_range(offset, source.size, "upload")
        # While the device is idle nothing reads a mapped buffer, so the host may write to it directly.
        if self._empty and buffer.mapped and self._device.idle:
            buffer.write(source, offset)
            return
        for position in range(0, source.size, CHUNK_SIZE):
            piece = source[position : position + CHUNK_SIZE]
            chunk, start = self._stage(piece)
            copy = (chunk, start, buffer, offset + position, piece.size)
            if not self._copies or not self._copies[-1].add(*copy):
                self._copies.append(_Copies())
                self._copies[-1].add(*copy)
            self._flush_when_large()

    def image(self, image: ImageTarget, levels: Sequence[np.ndarray]) -> None:
        """Replace all mip levels of an image; `levels` are (height, width, channels) of its dtype, largest first."""
        sources = [as_bytes(level) for level in image.check_levels(levels)]
        starts = [0]
        for source in sources:
            starts.append(-(-(starts[-1] + source.size) // _ALIGNMENT) * _ALIGNMENT)
        packed = np.zeros(starts[-1], np.uint8)
        for begin, source in zip(starts, sources, strict=False):
            packed[begin : begin + source.size] = source
        chunk, start = self._stage(packed)
        self._images.append((chunk, image, [(start + begin, level) for level, begin in enumerate(starts[:-1])]))
        self._flush_when_large()

    def _stage(self, source: np.ndarray) -> tuple[Storage, int]:
        """Copy bytes into a chunk; returns the chunk and the offset in it."""
        start = -(-self._used // _ALIGNMENT) * _ALIGNMENT
        if not self._chunks or start + source.size > self._chunks[-1].size:
            self._chunks.append(self._staging.take(source.size))
            start = 0
        self._chunks[-1].write(source, start)
        self._used = start + source.size
        self._staged += source.size
        return self._chunks[-1], start

    def _flush_when_large(self) -> None:
        if self._staged > FLUSH_SIZE:
            # Two parts at most are in memory: the one that the device copies and the one that is being filled.
            value = self._device.start(self._record, "uploads")
            self._give_back()
            self._device.await_value(value - 1)

    def _give_back(self) -> None:
        """Return the chunks to the pool when the submission that reads them is done."""
        for chunk in self._chunks:
            self._device.retire(partial(self._staging.give, chunk))
        self._reset()

    def _record(self, cmd: raw.CData) -> None:
        vk = self._device.vk
        for copies in self._copies:
            vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            for key, regions in copies.regions.items():
                chunk, buffer = copies.buffers[key]
                if buffer.handle is None:  # destroyed since the upload was added
                    continue
                table = np.array(regions, np.uint64)  # the layout of VkBufferCopy: source offset, target offset, size
                pointer = raw.ffi.cast("VkBufferCopy*", raw.ffi.from_buffer(table))
                vk.vkCmdCopyBuffer(cmd, chunk.handle, buffer.handle, len(regions), pointer)
        # Whole images are replaced, so what they held may be discarded: UNDEFINED as the old layout allows that.
        for chunk, image, levels in self._images:
            if image.handle is None:
                continue
            vk.vkCmdPipelineBarrier2(cmd, image.layout_change(raw.VK_IMAGE_LAYOUT_UNDEFINED, _TRANSFER_LAYOUT))
            parts = raw.array("VkBufferImageCopy", [image.copy_region(level, start) for start, level in levels])
            vk.vkCmdCopyBufferToImage(cmd, chunk.handle, image.handle, _TRANSFER_LAYOUT, len(levels), parts)
            vk.vkCmdPipelineBarrier2(cmd, image.layout_change(_TRANSFER_LAYOUT, image.layout))
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
