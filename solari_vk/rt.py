"""Ray tracing: acceleration structures as the wgpu document has them, on Vulkan.

    blas = rt.create_blas(device, [rt.Triangles(positions, indices)])
    tlas = rt.create_tlas(device, 16)
    rt.build_acceleration_structures(
        device,
        [rt.BlasBuildEntry(blas, [rt.Triangles(positions, indices)])],
        [rt.TlasPackage(tlas, [rt.TlasInstance(blas, np.eye(4)[:3], custom_data=7)])],
    )

A Tlas is then given to a `Frame` by its name in the shaders (`external={"tlas": tlas}`), which traces it with
`scene/ray_query.glsl`. Used before it is built, or after a Blas below it was built again or destroyed, it is refused
with a SolariError. `device.has_position_fetch` says whether shaders can have the vertices of a hit triangle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.build_call import BlasBuildEntry, BuildCall, TlasPackage
from solari_vk.gpu.acceleration.checks import check_items, check_kind, whole_number
from solari_vk.gpu.acceleration.instances import InstanceFlags, TlasInstance, TlasInstances
from solari_vk.gpu.acceleration.sources import Aabbs, AabbSize, BufferSlice, Triangles, TriangleSize
from solari_vk.gpu.acceleration.structure import UpdateMode
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.ray_query_faults import (
    FAULT_BUFFERS,
    RAY_QUERY_DEBUG,
    RULES,
    RayQueryFault,
    check_ray_queries,
    ray_query_faults,
)

__all__ = [
    "FAULT_BUFFERS",
    "RAY_QUERY_DEBUG",
    "RULES",
    "AabbSize",
    "Aabbs",
    "Blas",
    "BlasBuildEntry",
    "BufferSlice",
    "BuildCall",
    "InstanceFlags",
    "RayQueryFault",
    "Tlas",
    "TlasInstance",
    "TlasInstances",
    "TlasPackage",
    "TriangleSize",
    "Triangles",
    "UpdateMode",
    "build_acceleration_structures",
    "check_ray_queries",
    "create_blas",
    "create_tlas",
    "ray_query_faults",
]


def create_blas(
    device: Device,
    geometries: Sequence[Triangles | Aabbs | TriangleSize | AabbSize],
    *,
    prefer_fast_trace: bool = True,
    low_memory: bool = False,
    allow_compaction: bool = True,
    update_mode: UpdateMode = UpdateMode.BUILD,
    rebuild_after: int = 32,
    name: str = "blas",
) -> Blas:
    """A Blas for geometries like these, all triangles or all boxes; of data only the counts and formats are taken.

    prefer_fast_trace: else builds are fast. update_mode: PREFER_UPDATE refits when it is built again from the same
    counts and indices, `rebuild_after` times in a row at most. Raises SolariError for what no build could take.
    """
    _check_creation(device, update_mode, rebuild_after, f"Blas {name}")
    kinds = (Triangles, Aabbs, TriangleSize, AabbSize)
    remedy = "give rt.Triangles, rt.Aabbs, rt.TriangleSize or rt.AabbSize"
    geometries = check_items(geometries, kinds, f"Blas {name}: the geometries", remedy)
    blas = Blas(
        device,
        [geometry.geometry() for geometry in geometries],
        prefer_fast_trace=prefer_fast_trace,
        low_memory=low_memory,
        allow_compaction=allow_compaction,
        allow_update=update_mode is UpdateMode.PREFER_UPDATE,
        name=name,
    )
    blas.update_mode, blas.rebuild_after = update_mode, rebuild_after
    return blas


def create_tlas(
    device: Device,
    max_instances: int,
    *,
    prefer_fast_trace: bool = True,
    low_memory: bool = False,
    update_mode: UpdateMode = UpdateMode.BUILD,
    rebuild_after: int = 32,
    name: str = "tlas",
) -> Tlas:
    """A Tlas for at most so many instances. update_mode: PREFER_UPDATE refits when it is built again over as many
    instances of the same Blases, `rebuild_after` times in a row at most. Raises SolariError beyond the device's
    limit."""
    _check_creation(device, update_mode, rebuild_after, f"Tlas {name}")
    tlas = Tlas(
        device,
        max_instances,
        prefer_fast_trace=prefer_fast_trace,
        low_memory=low_memory,
        allow_update=update_mode is UpdateMode.PREFER_UPDATE,
        name=name,
    )
    tlas.update_mode, tlas.rebuild_after = update_mode, rebuild_after
    return tlas


def _check_creation(device: Device, update_mode: UpdateMode, rebuild_after: int, what: str) -> None:
    check_kind(device, Device, f"{what}: the device", "give a solari_vk.Device")
    check_kind(update_mode, UpdateMode, f"{what}: update_mode", "give rt.UpdateMode.BUILD or PREFER_UPDATE")
    whole_number(rebuild_after, f"{what}: rebuild_after", 0)


def build_acceleration_structures(
    device: Device, blases: Iterable[BlasBuildEntry] = (), tlases: Iterable[TlasPackage] = ()
) -> int:
    """Build or refit structures in one call, Blases before Tlases; returns the timeline's value when it is done.

    A Tlas may be built over Blases of the same or an earlier call. Raises SolariError, before anything is built, for
    one that was never built, was destroyed or is too large, and for the same structure twice. `BuildCall` prepares a
    call for later.
    """
    return BuildCall(device, blases, tlases).submit()
