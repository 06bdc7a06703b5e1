"""Ray tracing on Vulkan with the acceleration structures of the wgpu document.

    blas = rt.create_blas(device, [rt.Triangles(positions, indices)])
    tlas = rt.create_tlas(device, 16)
    rt.build_acceleration_structures(
        device,
        [rt.BlasBuildEntry(blas, [rt.Triangles(positions, indices)])],
        [rt.TlasPackage(tlas, [rt.TlasInstance(blas, np.eye(4)[:3], custom_data=7)])],
    )

Pass a Tlas to a `Frame` by its name in the shaders (`external={"tlas": tlas}`); they trace rays with
`scene/ray_query.glsl` on a device whose `rays` is "query". The frame raises SolariError for a Tlas that was never
built, or whose Blases were built or destroyed since. `device.has_position_fetch` says whether shaders can read the
vertices of a hit triangle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from solari_vk.base.errors import unknown_attribute
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.build_call import BlasBuildEntry, BuildCall, TlasPackage
from solari_vk.gpu.acceleration.checks import check_items, check_kind
from solari_vk.gpu.acceleration.instances import InstanceFlags, TlasInstance, TlasInstances
from solari_vk.gpu.acceleration.sources import Aabbs, AabbSize, BufferSlice, Triangles, TriangleSize
from solari_vk.gpu.acceleration.structure import BuildOptions, UpdateMode
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.ray_query_constants import IntersectionKind, RayFlags
from solari_vk.gpu.frame.ray_query_faults import (
    FAULT_BUFFERS,
    RAY_QUERY_DEBUG,
    RULES,
    RayQueryFault,
    check_ray_queries,
    ray_query_faults,
)

__all__ = [
    "FAULT_BUFFERS", "RAY_QUERY_DEBUG", "RULES", "AabbSize", "Aabbs", "Blas", "BlasBuildEntry", "BufferSlice",
    "BuildCall", "BuildOptions", "InstanceFlags", "IntersectionKind", "RayFlags", "RayQueryFault", "Tlas",
    "TlasInstance", "TlasInstances", "TlasPackage", "TriangleSize", "Triangles", "UpdateMode",
    "build_acceleration_structures", "check_ray_queries", "create_blas", "create_tlas", "ray_query_faults",
]  # fmt: skip


def create_blas(
    device: Device, geometries: Sequence[Triangles | Aabbs | TriangleSize | AabbSize], **options: Any
) -> Blas:
    """A Blas for geometries like these, all triangles or all boxes, of which only counts and formats are used.

    options: allow_compaction (default True), name, and those of `BuildOptions`: prefer_fast_trace, low_memory,
    update_mode and rebuild_after. Raises SolariError for geometries that can't be built.
    """
    check_kind(device, Device, "Blas: the device", "give a solari_vk.Device")
    kinds = (Triangles, Aabbs, TriangleSize, AabbSize)
    remedy = "give rt.Triangles, rt.Aabbs, rt.TriangleSize or rt.AabbSize"
    geometries = check_items(geometries, kinds, f"Blas {options.get('name', 'blas')}: the geometries", remedy)
    return Blas(device, [geometry.geometry() for geometry in geometries], **options)


def create_tlas(device: Device, max_instances: int, **options: Any) -> Tlas:
    """A Tlas for at most this many instances.

    options: name, and those of `BuildOptions`: prefer_fast_trace, low_memory, update_mode and rebuild_after. Raises
    SolariError beyond the device's limit.
    """
    check_kind(device, Device, "Tlas: the device", "give a solari_vk.Device")
    return Tlas(device, max_instances, **options)


def build_acceleration_structures(
    device: Device, blases: Iterable[BlasBuildEntry] = (), tlases: Iterable[TlasPackage] = ()
) -> int:
    """Build or refit structures in one call, Blases before Tlases; returns the timeline value of its completion.

    A Tlas may be built over Blases of the same or an earlier call. Raises SolariError, before anything is built, for a
    structure that was never built, was destroyed, is too large or occurs twice. Use `BuildCall` to submit a call later.
    """
    return BuildCall(device, blases, tlases).submit()


def __getattr__(name: str) -> NoReturn:
    error = unknown_attribute("solari_vk.renderers.rt has no", name, lambda: __all__)
    raise AttributeError(
        f"{error}; solari_vk.RayTracer(device, scene) traces arrays of rays through a scene", name=None
    )
