"""Instances of bottom-level structures, given as one object each or as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.checks import check_items, check_kind, check_whole, numbers, show
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE

CUSTOM_DATA_BITS = 24
_MAKE_BLAS = "give what rt.create_blas makes"


class InstanceFlags(IntFlag):
    """How an instance changes the traversal of rays."""

    NONE = 0
    FACING_CULL_DISABLE = 1
    """Its faces are never culled."""
    FLIP_FACING = 2
    """Its front faces are those whose vertices run clockwise."""
    FORCE_OPAQUE = 4
    FORCE_NO_OPAQUE = 8


def _check(transforms: NDArray[Any], custom_data: NDArray[Any], mask: NDArray[Any], flags: NDArray[Any]) -> None:
    """Raise SolariError for values that records can't hold, naming the index of the first among several."""

    def where(wrong: NDArray[np.bool_]) -> str:
        return f" (number {int(wrong.argmax())})" if len(wrong) > 1 else ""

    for what, values, limit in (("custom_data", custom_data, (1 << CUSTOM_DATA_BITS) - 1), ("mask", mask, 0xFF)):
        check_whole(values, f"instance: {what} must be a whole number from 0 to {limit:,}")
        wrong = (values < 0) | (values > limit)
        if wrong.any():
            example = values[wrong][0]
            raise SolariError(f"instance: {what} must be 0 to {limit:,}, not {example}{where(wrong)}")
    check_whole(flags, "instance: flags must be rt.InstanceFlags")
    flags = flags.astype(np.int64)
    wrong = (flags < 0) | (flags > 0xF) | (flags & 0xC == 0xC)
    if wrong.any():
        found = InstanceFlags(int(flags[wrong][0]))
        raise SolariError(f"instance: the flags {found!r} are unknown or contradict each other{where(wrong)}")
    with np.errstate(over="ignore", invalid="ignore"):
        # Checked as the float32 numbers that the records hold: a large double may become infinite.
        linear = transforms[:, :, :3].astype(np.float32).astype(np.float64)
        wrong = np.logical_not(np.isfinite(transforms.astype(np.float32)).all(axis=(1, 2)))
        if wrong.any():
            raise SolariError(f"instance: the transform is not finite{where(wrong)}")
        # Written so that a NaN determinant counts as wrong too.
        wrong = np.logical_not(np.abs(np.linalg.det(linear)) > 0)
    if wrong.any():
        raise SolariError(f"instance: the transform is not invertible{where(wrong)}")


def _affine(transforms: Any) -> NDArray[np.float64]:
    """(N, 3, 4) of 3x4 matrices or affine 4x4 ones."""
    matrices = numbers(transforms, "instance: the transform's elements").astype(np.float64)
    # The last row of an affine matrix says nothing, and Vulkan's records leave it out.
    if matrices.shape[-2:] == (4, 4) and (matrices[..., 3, :] == (0, 0, 0, 1)).all():
        matrices = matrices[..., :3, :]
    if matrices.shape[-2:] != (3, 4):
        raise SolariError(f"instance: the transform must be 3x4, or an affine 4x4, not {matrices.shape}")
    return matrices.reshape(-1, 3, 4)


@dataclass(eq=False)
class TlasInstance:
    """An instance of a Blas.

    transform: (3, 4) or affine (4, 4), world from object. custom_data: 24 bits that shaders get at a hit. mask: 8 bits;
    a ray can hit the instance if its cull mask has one of them. Raises SolariError for values out of range.
    """

    blas: Blas
    transform: Any = None
    custom_data: int = 0
    mask: int = 0xFF
    flags: InstanceFlags = InstanceFlags.NONE

    def __post_init__(self) -> None:
        self.record()

    def record(self) -> NDArray[Any]:
        """Its INSTANCE_DTYPE record, of shape (1,), with address 0."""
        check_kind(self.blas, Blas, "instance: the Blas", _MAKE_BLAS)
        transform = np.eye(4)[:3] if self.transform is None else self.transform
        return make_records(transform, self.custom_data, self.mask, self.flags, 1)


class TlasInstances:
    """Many instances in arrays. Each argument is one value for all instances, or a sequence with a value for each.

    blases: a Blas, or a sequence of them with None for instances that are never hit. Other arguments as for
    `TlasInstance`. The values are checked and copied once, and can't be changed later.
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
        self._records.setflags(write=False)  # values that were checked must not change before the build

    @property
    def blases(self) -> Sequence[Blas | None]:
        """The Blas of each instance."""
        return self._blases

    @property
    def records(self) -> NDArray[Any]:
        """Their INSTANCE_DTYPE records, read-only, with address 0."""
        return self._records.view()

    def __len__(self) -> int:
        return len(self._records)


def make_records(transforms: Any, custom_data: Any, mask: Any, flags: Any, count: int) -> NDArray[Any]:
    """INSTANCE_DTYPE records of values that are checked here, with address 0."""
    matrices = _affine(transforms)
    try:
        matrices = np.broadcast_to(matrices, (count, 3, 4))
        custom, masks, bits = (np.broadcast_to(np.asarray(value), (count,)) for value in (custom_data, mask, flags))
    except ValueError as error:
        raise SolariError(f"instances: give one value for all, or a sequence of {count} ({error})") from error
    _check(matrices, custom, masks, bits)
    records = np.zeros(count, INSTANCE_DTYPE)
    records["transform"] = matrices
    # The bit fields of VkAccelerationStructureInstanceKHR: 24 bits of index and 8 of mask, 24 of offset and 8 of flags.
    records["custom_index_and_mask"] = custom.astype(np.uint32) | masks.astype(np.uint32) << 24
    records["sbt_offset_and_flags"] = bits.astype(np.uint32) << 24
    return records


def gather(instances: Iterable[TlasInstance | None] | TlasInstances) -> tuple[Sequence[Blas | None], NDArray[Any]]:
    """The Blas of each instance (None: never hit), and their records with address 0."""
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
