"""What a top-level structure is built over: instances of bottom-level ones, one object each or many in arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.checks import check_items, check_kind, check_whole, numbers, show
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE

CUSTOM_DATA_BITS = 24
_MAKE_BLAS = "give what rt.create_blas makes"


class InstanceFlags(IntFlag):
    """What an instance changes for rays that meet it."""

    NONE = 0
    FACING_CULL_DISABLE = 1
    """Rays never cull its faces."""
    FLIP_FACING = 2
    """Its front is where vertices run clockwise."""
    FORCE_OPAQUE = 4
    FORCE_NO_OPAQUE = 8


def _check(transforms: NDArray[Any], custom_data: NDArray[Any], mask: NDArray[Any], flags: NDArray[Any]) -> None:
    """Raise SolariError for what can't be put into records; the first wrong one is named when there are many."""

    def where(wrong: NDArray[np.bool_]) -> str:
        return f" (number {int(wrong.argmax())})" if len(wrong) > 1 else ""

    for what, values, most in (("custom_data", custom_data, (1 << CUSTOM_DATA_BITS) - 1), ("mask", mask, 0xFF)):
        check_whole(values, f"instance: {what} is a whole number from 0 to {most:,}")
        wrong = (values < 0) | (values > most)
        if wrong.any():
            example = values[wrong][0]
            raise SolariError(f"instance: {what} is a whole number from 0 to {most:,}, not {example}{where(wrong)}")
    check_whole(flags, "instance: flags are rt.InstanceFlags")
    flags = flags.astype(np.int64)
    wrong = (flags < 0) | (flags > 0xF) | (flags & 0xC == 0xC)
    if wrong.any():
        raise SolariError(f"instance: {InstanceFlags(int(flags[wrong][0]))!r} can't be{where(wrong)}")
    with np.errstate(over="ignore", invalid="ignore"):
        linear = transforms[:, :, :3].astype(np.float32).astype(np.float64)
        wrong = np.logical_not(np.isfinite(transforms.astype(np.float32)).all(axis=(1, 2)))
        if wrong.any():
            raise SolariError(f"instance: the transform is not finite{where(wrong)}")
        wrong = np.logical_not(np.abs(np.linalg.det(linear)) > 0)
    if wrong.any():
        raise SolariError(f"instance: the transform is not invertible{where(wrong)}")


def _affine(given: Any) -> NDArray[np.float64]:
    """(N, 3, 4) of 3x4 matrices or affine 4x4 ones."""
    matrices = numbers(given, "instance: the transform's elements").astype(np.float64)
    if matrices.shape[-2:] == (4, 4) and (matrices[..., 3, :] == (0, 0, 0, 1)).all():
        matrices = matrices[..., :3, :]
    if matrices.shape[-2:] != (3, 4):
        raise SolariError(f"instance: the transform is 3x4, or an affine 4x4, not {matrices.shape}")
    return matrices.reshape(-1, 3, 4)


@dataclass(eq=False)
class TlasInstance:
    """A Blas in the world: transform (3, 4) world from object; custom_data, 24 bits that the shader gets at a hit;
    mask, 8 bits of which a ray's cull mask must share one. Raises SolariError for what doesn't fit in."""

    blas: Blas
    transform: Any = None
    custom_data: int = 0
    mask: int = 0xFF
    flags: InstanceFlags = InstanceFlags.NONE

    def __post_init__(self) -> None:
        self.record()

    def record(self) -> NDArray[Any]:
        """Its INSTANCE_DTYPE record, of shape (1,), without the address."""
        check_kind(self.blas, Blas, "instance: the Blas", _MAKE_BLAS)
        transform = np.eye(4)[:3] if self.transform is None else self.transform
        return make_records(transform, self.custom_data, self.mask, self.flags, 1)


class TlasInstances:
    """Many instances in arrays, for tops of 100,000: each argument is one for all, or a sequence of `count`.

    blases: a Blas, or a sequence of them with None for places that no ray meets. Others as of `TlasInstance`. All is
    checked and copied once; for other instances make another one.
    """

    def __init__(
        self,
        blases: Blas | Sequence[Blas | None],
        transforms: Any,
        custom_data: Any = 0,
        mask: Any = 0xFF,
        flags: Any = InstanceFlags.NONE,
    ) -> None:
        matrices = _affine(transforms)
        if isinstance(blases, Blas):
            blases = [blases] * len(matrices)
        self._blases = tuple(check_items(blases, (Blas, type(None)), "instances: the Blases", _MAKE_BLAS))
        self._records = make_records(matrices, custom_data, mask, flags, len(self._blases))
        self._records.setflags(write=False)  # what was checked can't change before the build

    @property
    def blases(self) -> Sequence[Blas | None]:
        """The Blas of each instance."""
        return self._blases

    @property
    def records(self) -> NDArray[Any]:
        """Their INSTANCE_DTYPE records, addresses 0; not to be written to."""
        return self._records.view()

    def __len__(self) -> int:
        return len(self._records)


def make_records(transforms: Any, custom_data: Any, mask: Any, flags: Any, count: int) -> NDArray[Any]:
    """INSTANCE_DTYPE records from checked values, their addresses 0."""
    matrices = _affine(transforms)
    try:
        matrices = np.broadcast_to(matrices, (count, 3, 4))
        custom, masks, bits = (
            np.broadcast_to(np.asarray(value), (count,)) for value in (custom_data, mask, flags)
        )
    except ValueError as error:
        raise SolariError(f"instances: every value is one for all, or {count} in a sequence ({error})") from error
    _check(matrices, custom, masks, bits)
    records = np.zeros(count, INSTANCE_DTYPE)
    records["transform"] = matrices
    records["custom_index_and_mask"] = custom.astype(np.uint32) | masks.astype(np.uint32) << 24
    records["sbt_offset_and_flags"] = bits.astype(np.uint32) << 24
    return records


def gather(instances: Iterable[TlasInstance | None] | TlasInstances) -> tuple[Sequence[Blas | None], NDArray[Any]]:
    """The Blas of each instance, and their records without addresses. None stays a place that no ray meets."""
    if isinstance(instances, TlasInstances):
        return instances.blases, instances.records.copy()
    items = list(instances)
    for i, item in enumerate(items):
        if item is not None and not isinstance(item, TlasInstance):
            raise SolariError(f"instances: number {i} is {show(item)}: give rt.TlasInstance objects, or None")
    records = np.zeros(len(items), INSTANCE_DTYPE)
    for i, item in enumerate(items):
        if item is not None:
            records[i] = item.record()[0]
    return [None if item is None else item.blas for item in items], records
