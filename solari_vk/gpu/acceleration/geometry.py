"""The geometry of a bottom-level acceleration structure: triangles and boxes in device memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.checks import check_kind, check_switch, show, whole_number
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device

AABB_DTYPE = np.dtype([("minimum", "<f4", 3), ("maximum", "<f4", 3)])
_INDEX_TYPES = {np.dtype(np.uint16): raw.VK_INDEX_TYPE_UINT16, np.dtype(np.uint32): raw.VK_INDEX_TYPE_UINT32}


@dataclass(frozen=True)
class TriangleGeometry:
    """Triangles in device memory; `positions`, `indices` and `transform` are device addresses.

    positions: float32 x, y, z every `position_stride` bytes. indices: three per triangle, of `index_dtype` (uint16 or
    uint32), or 0 if every three positions are a triangle. transform: 3x4 float32, row-major, 16-byte aligned, or 0.
    index_hash: a hash of the indices, if known; a refit needs the same indices.
    """

    positions: int
    position_count: int
    triangle_count: int
    indices: int = 0
    index_dtype: type[np.unsignedinteger] = np.uint32
    position_stride: int = 12
    transform: int = 0
    opaque: bool = True
    no_duplicate_any_hit: bool = False
    index_hash: int = 0

    @property
    def primitive_count(self) -> int:
        """Number of triangles."""
        return self.triangle_count


@dataclass(frozen=True)
class AabbGeometry:
    """Boxes in device memory: AABB_DTYPE records at the address `boxes`, `stride` bytes apart (a multiple of 8)."""

    boxes: int
    count: int
    stride: int = AABB_DTYPE.itemsize
    opaque: bool = True
    no_duplicate_any_hit: bool = False

    @property
    def primitive_count(self) -> int:
        """Number of boxes."""
        return self.count


Geometry = TriangleGeometry | AabbGeometry


def geometry_struct(geometry: Geometry) -> raw.CData:
    """The VkAccelerationStructureGeometryKHR of a geometry."""
    flags = 0
    if geometry.opaque:
        flags |= raw.VK_GEOMETRY_OPAQUE_BIT_KHR
    if geometry.no_duplicate_any_hit:
        flags |= raw.VK_GEOMETRY_NO_DUPLICATE_ANY_HIT_INVOCATION_BIT_KHR
    if isinstance(geometry, AabbGeometry):
        kind = raw.VK_GEOMETRY_TYPE_AABBS_KHR
        data = {
            "aabbs": raw.struct(
                "VkAccelerationStructureGeometryAabbsDataKHR",
                data={"deviceAddress": geometry.boxes},
                stride=geometry.stride,
            )
        }
    else:
        kind = raw.VK_GEOMETRY_TYPE_TRIANGLES_KHR
        # Without indices, each three positions are a triangle.
        index_type = _INDEX_TYPES[np.dtype(geometry.index_dtype)] if geometry.indices else raw.VK_INDEX_TYPE_NONE_KHR
        data = {
            "triangles": raw.struct(
                "VkAccelerationStructureGeometryTrianglesDataKHR",
                vertexFormat=raw.VK_FORMAT_R32G32B32_SFLOAT,
                vertexData={"deviceAddress": geometry.positions},
                vertexStride=geometry.position_stride,
                maxVertex=max(geometry.position_count - 1, 0),
                indexType=index_type,
                indexData={"deviceAddress": geometry.indices},
                transformData={"deviceAddress": geometry.transform},
            )
        }
    return raw.struct("VkAccelerationStructureGeometryKHR", geometryType=kind, geometry=data, flags=flags)


def build_ranges(geometries: Sequence[Geometry]) -> raw.CData:
    """A VkAccelerationStructureBuildRangeInfoKHR for each geometry, with all its primitives."""
    # The offsets stay 0: addresses point to the first primitive already.
    counts = [{"primitiveCount": geometry.primitive_count} for geometry in geometries]
    return raw.array("VkAccelerationStructureBuildRangeInfoKHR", counts)


def refit_keys(geometries: Sequence[Geometry]) -> list[tuple[object, ...]]:
    """What must be equal for a refit: counts and indices, but not addresses, positions or transforms."""
    return [
        # Of indices in a buffer the hash is 0 in both, so the caller vouches that they are the same.
        (geometry.position_count, geometry.triangle_count, geometry.index_hash)
        if isinstance(geometry, TriangleGeometry)
        else (geometry.count,)
        for geometry in geometries
    ]


def _format(geometry: Geometry) -> dict[str, object]:
    """The properties that a structure is created with and no build may change."""
    common = {"kind": "boxes", "opaque": geometry.opaque, "no_duplicate_any_hit": geometry.no_duplicate_any_hit}
    if isinstance(geometry, AabbGeometry):
        return common
    return common | {
        "kind": "triangles",
        "indices": np.dtype(geometry.index_dtype).name if geometry.indices else "none",
        "transform": "given" if geometry.transform else "none",
    }


def check_fit(made_for: Sequence[Geometry], geometries: Sequence[Geometry], where: str) -> None:
    """Raise SolariError unless these geometries can be built in a structure that was created for `made_for`."""
    if len(geometries) != len(made_for):
        raise SolariError(f"build of {where}: {len(geometries)} geometries, but it was made for {len(made_for)}")
    for i, (wanted, geometry) in enumerate(zip(made_for, geometries, strict=True)):
        expected, found = _format(wanted), _format(geometry)
        for key, value in expected.items():
            if found.get(key) != value:
                raise SolariError(
                    f"build of {where}, geometry {i}: {key} is {found.get(key)}, but it was made for {value}"
                )
        for field in ("position_count", "triangle_count", "count"):
            limit, count = getattr(wanted, field, 0), getattr(geometry, field, 0)
            if count > limit:
                raise SolariError(
                    f"build of {where}, geometry {i}: {field} is {count:,}, but it was made for {limit:,}"
                )


def check_index_type(dtype: Any, where: str) -> None:
    """Raise SolariError unless indices can have this type."""
    try:
        fits = np.dtype(dtype) in _INDEX_TYPES
    except TypeError:
        fits = False
    if not fits:
        raise SolariError(f"{where}: index_dtype must be uint16 or uint32, not {show(dtype)}")


def _check_types(geometry: Any, where: str) -> None:
    check_kind(geometry, (TriangleGeometry, AabbGeometry), where, "give a TriangleGeometry or an AabbGeometry")
    for field, value in vars(geometry).items():
        if field == "index_dtype":
            check_index_type(value, where)
        elif field in ("opaque", "no_duplicate_any_hit"):
            check_switch(value, f"{where}: {field}")
        else:
            whole_number(value, f"{where}: {field}")


def check_geometries(device: Device, geometries: Sequence[Geometry], name: str) -> None:
    """Raise SolariError unless vkCmdBuildAccelerationStructuresKHR can build these geometries."""
    limits = device.properties.acceleration
    where = f"Blas {name}"
    for i, geometry in enumerate(geometries):
        _check_types(geometry, f"{where}, geometry {i}")
    if not 1 <= len(geometries) <= limits.maxGeometryCount:
        raise SolariError(f"{where}: {len(geometries)} geometries; this device takes 1 to {limits.maxGeometryCount:,}")
    # Vulkan demands one geometry type in a bottom-level structure.
    if len({type(geometry) for geometry in geometries}) > 1:
        raise SolariError(f"{where}: triangles and boxes can't be in one Blas")
    total = sum(geometry.primitive_count for geometry in geometries)
    if total > limits.maxPrimitiveCount:
        raise SolariError(f"{where}: {total:,} primitives; this device takes {limits.maxPrimitiveCount:,} at most")
    for i, geometry in enumerate(geometries):
        _check_counts(geometry, f"{where}, geometry {i}")
        _check_alignments(geometry, f"{where}, geometry {i}")


def _check_counts(geometry: Geometry, where: str) -> None:
    if geometry.primitive_count < 0:
        raise SolariError(f"{where}: the number of primitives must not be negative, like {geometry.primitive_count}")
    if isinstance(geometry, AabbGeometry) or geometry.indices:
        return  # indices are the caller's promise: only those of arrays are known to the host
    if geometry.position_count < 3 * geometry.triangle_count:
        raise SolariError(
            f"{where}: {geometry.triangle_count:,} triangles without indices "
            f"need {3 * geometry.triangle_count:,} positions, not {geometry.position_count:,}"
        )


def _check_alignments(geometry: Geometry, where: str) -> None:
    # The alignments of VkAccelerationStructureGeometry*DataKHR: of boxes 8, of floats 4, of a VkTransformMatrixKHR 16,
    # of indices their own size.
    if isinstance(geometry, AabbGeometry):
        aligned = {"boxes": (geometry.boxes, 8), "stride": (geometry.stride, 8)}
    else:
        aligned = {
            "positions": (geometry.positions, 4),
            "position_stride": (geometry.position_stride, 4),
            "indices": (geometry.indices, np.dtype(geometry.index_dtype).itemsize),
            "transform": (geometry.transform, 16),
        }
    for field, (value, alignment) in aligned.items():
        if value < 0 or value % alignment:
            raise SolariError(f"{where}: {field} is {value:#x}, not a multiple of {alignment}")
