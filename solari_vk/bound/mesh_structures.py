"""The acceleration structures of meshes: equal ones share theirs, and those with vertices in tensors have two each."""

from __future__ import annotations

from collections.abc import Container, Hashable, Mapping
from typing import Any

from solari_vk.bound.mesh_tensors import MeshTensors
from solari_vk.bound.table import RowAllocator
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.structures import MeshStructure, build_mesh_structures, mesh_structure
from solari_vk.scene.model import Mesh

Build = tuple[Hashable, bool]
"""What a structure is built from: the content of a mesh, and whether it is built with no_duplicate_any_hit, so that
any-hit shaders run once for each triangle that a ray meets."""


class MeshStructures:
    """tensors: the meshes with vertices in tensors."""

    def __init__(self, device: Device, tensors: MeshTensors) -> None:
        self._device = device
        self._tensors = tensors
        self._built: dict[Build, MeshStructure] = {}
        self._builds: RowAllocator[Build] = RowAllocator()  # whose users share a structure
        self._build_of: dict[Mesh, Build] = {}
        self.builds_at_once = True
        """Whether all structures are built. Otherwise `TracedRecords` builds those that rays need."""
        self.all_alive = True
        """Whether no structure was destroyed since this was last set: the TLAS of the previous frame may name it."""

    def build(
        self, traced: Mapping[Mesh, TriangleGeometry], builds: Mapping[Mesh, Build], moved: Container[Mesh]
    ) -> dict[Any, MeshStructure]:
        """The structures of meshes. builds: of those without vertices in tensors. moved: have other positions."""
        new = {build: mesh for mesh, build in builds.items() if build not in self._built}
        with self._device.undone_on_error():
            made = {
                build: mesh_structure(self._device, traced[mesh], mesh.name or "mesh") for build, mesh in new.items()
            }
            if self.builds_at_once:
                build_mesh_structures(self._device, list(made.values()))
        self._built |= made
        # All are acquired before earlier ones are dropped, which may be the same, or what another mesh has from now on.
        for mesh, build in builds.items():
            self._builds.acquire(build, mesh)
        for mesh, build in builds.items():
            self._drop_build(mesh)
            self._build_of[mesh] = build
        of_tensors = self._tensors.structures({mesh: traced[mesh] for mesh in traced if mesh not in builds}, moved)
        for mesh in of_tensors:
            self._drop_build(mesh)
        return {mesh: self._built[build] for mesh, build in builds.items()} | of_tensors

    def drop(self, mesh: Mesh) -> None:
        """Rays don't meet a mesh any more."""
        self._drop_build(mesh)
        self.all_alive = not self._tensors.drop_structures(mesh) and self.all_alive

    def forget_tensors(self, mesh: Mesh) -> None:
        """The host has all vertices of a mesh again, or it isn't used any more."""
        self.all_alive = not self._tensors.forget(mesh) and self.all_alive

    def _drop_build(self, mesh: Mesh) -> None:
        """Free the structure that was built for a mesh, if there is one and no other mesh's."""
        build = self._build_of.pop(mesh, None)
        if build is not None and self._builds.release(build, mesh):
            self._built.pop(build).destroy()
            self.all_alive = False

    def destroy(self) -> None:
        for blas in self._built.values():
            blas.destroy()
