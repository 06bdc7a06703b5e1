"""What rays traverse: the driver's acceleration structures, or on devices that trace by compute shaders trees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.acceleration.structure import UpdateMode
from solari_vk.gpu.acceleration.tlas import Tlas, TlasBuild, TlasBuilds, TlasCopy
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.trees import tree as trees

MeshStructure = Blas | trees.MeshTree
SceneStructure = Tlas | trees.SceneTree


def traces_by_compute(device: Device) -> bool:
    """Whether rays traverse trees."""
    return device.rays == "compute"


def mesh_structure(device: Device, geometry: TriangleGeometry, name: str, *, moves: bool = False) -> MeshStructure:
    """A structure over the triangles of a mesh, which isn't built yet. moves: it is built again for other positions."""
    if traces_by_compute(device):
        return trees.MeshTree(device, geometry, name, moves=moves)
    if moves:
        return Blas(device, [geometry], allow_compaction=False, name=name, update_mode=UpdateMode.PREFER_UPDATE)
    return Blas(device, [geometry], name=name)


def build_mesh_structures(device: Device, structures: Sequence[Any]) -> None:
    """Submit the first builds of structures of meshes."""
    if traces_by_compute(device):
        trees.build_meshes(device, structures)
    else:
        build_blases(device, structures)


def scene_structure(device: Device, max_instances: int, name: str) -> SceneStructure:
    """A structure over the records of instances (INSTANCE_DTYPE)."""
    if traces_by_compute(device):
        return trees.SceneTree(device, max_instances, name=name)
    return Tlas(device, max_instances, name=name)


def scene_build(
    structure: Any, instances: int, count: int, flat_tree: trees.FlatTree | None
) -> TlasBuild | trees.SceneBuild:
    """Its build over `count` records at an address, which can be submitted again and again. flat_tree: that of
    instances that never moved, of devices that trace by compute."""
    if traces_by_compute(structure.device):
        return trees.SceneBuild(structure, instances, count, flat_tree)
    return TlasBuild(structure, instances, count)


def scene_builds(
    structures: Sequence[Any], instances: int, stride: int, counts: Sequence[int], flat_tree: trees.FlatTree | None
) -> TlasBuilds | trees.SceneBuilds:
    """The builds of several structures in one step, as `TlasBuilds`. flat_tree: as `scene_build`, of all."""
    if traces_by_compute(structures[0].device):
        return trees.SceneBuilds(structures, instances, stride, counts, flat_tree)
    return TlasBuilds(structures, instances, stride, counts)


def scene_copy(source: Any, target: Any) -> TlasCopy | trees.SceneCopy:
    """A copy of a structure to another one of the same size, which can be submitted again and again."""
    if traces_by_compute(source.device):
        return trees.SceneCopy(source, target)
    return TlasCopy(source, target)
