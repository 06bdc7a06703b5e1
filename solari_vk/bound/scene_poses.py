"""Meshes in the poses of their instances on the device: vertices and acceleration structures of their own.

A pose is computed by scene/deform.comp. Each posed mesh has its positions and its BLAS twice, and poses alternate
between the two: motion vectors read the previous positions, and rays through the TLAS of the previous frame meet the
previous pose. A BLAS is refitted from the other one, which takes a fraction of the time of a build but leaves the boxes
of its tree as they were grouped; after some poses, and when the bounds have grown or shrunk, it is built anew.

The previous frame of one renderer of the scene may be older than that of another one. Before each frame the records
name the positions that its renderer showed last, and a pose that a renderer showed last is copied before it is lost.
Meshes whose positions were edited have the buffers of earlier ones for the same purpose.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.pose_commands import TIMED, PoseCommands
from solari_vk.bound.posed_mesh import EditedMesh, PosedMesh
from solari_vk.bound.table import Table
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.stopwatch import Stopwatch
from solari_vk.gpu.structures import mesh_structure
from solari_vk.gpu.trees.refits import MovedTrees
from solari_vk.scene.meshes.deformation import Deformation
from solari_vk.scene.objects import Mesh


class ScenePoses:
    """The posed meshes of a scene. block_dtypes: of the shaders, by name. meshes: the table of meshes."""

    def __init__(self, device: Device, block_dtypes: dict[str, Any], meshes: Table, moved_trees: MovedTrees) -> None:
        self._device = device
        self._meshes = meshes
        self._commands = PoseCommands(device, block_dtypes, moved_trees)
        self.tables = self._commands.tables
        """Are uploaded between `update` and `submit`."""
        self._influence = block_dtypes["influences"]
        self._sources: dict[Mesh, Buffer] = {}  # influences and targets
        self._rows: dict[PosedMesh, tuple[int, bool]] = {}  # in `meshes`, and whether rays meet it
        self._changed: dict[PosedMesh, None] = {}
        self._to_compute: dict[PosedMesh, None] = {}  # whose vertices `submit` computes
        self._edited: dict[Mesh, EditedMesh] = {}
        # Whose records name previous positions that aren't the current ones.
        self._moving: dict[PosedMesh | EditedMesh, None] = {}
        # In the order of their latest changes, the newest last: frames look at the end of it alone.
        self._by_change: dict[PosedMesh | EditedMesh, None] = {}
        # The revision of each renderer's latest frame, to which its motion vectors point.
        self._seen: weakref.WeakKeyDictionary[Any, int] = weakref.WeakKeyDictionary()

    def add(self, posed: PosedMesh, row: int, traced: bool) -> None:
        """Add a posed mesh with a row of its own, or another use of it."""
        _, was_traced = self._rows.get(posed, (row, False))
        self._rows[posed] = row, traced or was_traced
        if traced and not was_traced:
            posed.destroy()  # a mesh that no ray met has no BLAS, and is made anew with one
        if posed.buffer is None:
            self._changed[posed] = None

    def remove(self, posed: PosedMesh) -> None:
        """Remove a posed mesh."""
        for posed_meshes in (self._rows, self._changed, self._to_compute, self._moving, self._by_change):
            posed_meshes.pop(posed, None)
        posed.destroy()
        if not any(other.mesh is posed.mesh for other in self._rows) and posed.mesh in self._sources:
            self._sources.pop(posed.mesh).destroy()

    def follow_instance(self, posed: PosedMesh) -> None:
        """Give a mesh the pose that its instance has now, which may have changed."""
        pose = posed.instance.joint_matrices, posed.instance.morph_weights
        if not all(map(_same, pose, posed.pose)):
            posed.pose = pose
            self._changed[posed] = None

    def free_poses_of(self, mesh: Mesh) -> bool:
        """Free all poses of a mesh that was edited, which `update` makes anew; returns whether there were some."""
        found = [posed for posed in self._rows if posed.mesh is mesh]
        if mesh in self._sources:
            self._sources.pop(mesh).destroy()
        for posed in found:
            posed.destroy()
            self._changed[posed] = None
        return bool(found)

    # ---- records ------------------------------------------------------------------------------------

    def update(
        self, revision: int, base: Callable[[Mesh], int], packed: Callable[[Mesh], NDArray[Any] | None]
    ) -> list[PosedMesh]:
        """Write the records of meshes in new poses, as if they had always been there; returns these meshes.

        revision: of the scene. base(mesh): the row of a mesh in its rest pose, which is uploaded. packed(mesh): its
        attributes as records.
        """
        found = [posed for posed in self._changed if posed in self._rows]
        for posed in found:
            if posed.buffer is None:
                try:
                    self._make(posed, base(posed.mesh), packed(posed.mesh))
                except BaseException:  # what was made so far is of no use
                    posed.destroy()
                    raise
                posed.revisions = [-1, -1]
            elif posed not in self._to_compute:
                # The newest pose becomes the previous one. The pose before is lost, unless a renderer needs it.
                self._copy_seen(posed)
                posed.side = 1 - posed.side
            posed.revisions[posed.side] = revision
            self._by_change.pop(posed, None)
            self._by_change[posed] = None
            self._to_compute[posed] = None
            self._write_record(posed, base(posed.mesh))
            self._moving.pop(posed, None)
        self._changed.clear()
        if self._to_compute:
            work = [
                (posed, self._meshes.records[base(posed.mesh)], self._sources[posed.mesh]) for posed in self._to_compute
            ]
            self._commands.write(work)
        return found

    # ---- motion -------------------------------------------------------------------------------------

    @property
    def is_seen(self) -> bool:
        """Whether a renderer has shown the scene, for whose motion vectors previous positions are needed."""
        return bool(self._seen)

    def edit(self, mesh: Mesh, row: int, before: Buffer, address: int, revision: int) -> None:
        """Have other positions of a mesh, at an address, from a revision of the scene on. row: in `meshes`. before:
        begins with the earlier positions, and is owned from now on."""
        edited = self._edited.setdefault(mesh, EditedMesh(row, before.address))
        edited.edit(before, address, revision)
        edited.free_unseen(self._seen.values())
        self._by_change.pop(edited, None)
        self._by_change[edited] = None

    def forget(self, mesh: Mesh) -> None:
        """Free the earlier positions of a mesh, which have nothing to do with its current ones or aren't used."""
        edited = self._edited.pop(mesh, None)
        if edited is None:
            return
        for posed_meshes in (self._moving, self._by_change):
            posed_meshes.pop(edited, None)
        edited.destroy()

    def set_previous_positions(self, renderer: Any) -> bool:
        """Have the previous positions be those that a renderer has shown last; returns whether records
        changed.

        A renderer that is new has shown nothing but the current pose. Without a renderer nothing is done.
        """
        if renderer is None:
            return False
        moved = self._moved_since(self._seen.get(renderer, math.inf))
        # What moved for the renderer before, and doesn't any more, has its current positions as previous ones again.
        targets = {posed: posed.address for posed in self._moving} | moved
        self._moving = dict.fromkeys(moved)
        changed = False
        for posed, address in targets.items():
            row = posed.row if isinstance(posed, EditedMesh) else self._rows[posed][0]
            record = self._meshes.records[row]
            if record["previous_positions"] != address:
                record["previous_positions"] = address
                self._meshes.mark([row])
                changed = True
            if isinstance(posed, EditedMesh) and posed not in moved:
                posed.free_unseen(self._seen.values())
        return changed

    def _moved_since(self, seen: float) -> dict[PosedMesh | EditedMesh, int]:
        """The meshes that have changed since a revision, and the addresses of their positions at that time."""
        moved = {}
        for posed in reversed(self._by_change):
            if posed.revision <= seen:
                break
            address = posed.address_at(seen)
            if address is not None:
                moved[posed] = address
        return moved

    def mark_seen(self, renderer: Any, revision: int) -> None:
        """Say that a renderer of the scene, if there is one, renders it as it is at a revision."""
        if renderer is not None:
            self._seen[renderer] = revision

    def _copy_seen(self, posed: PosedMesh) -> None:
        """Have copies of exactly those earlier poses that are the latest ones that a renderer has shown, just before
        the older of the two poses is overwritten."""
        newest = posed.revisions[posed.side]
        lost = posed.revisions[1 - posed.side]
        if not posed.copies and min(self._seen.values(), default=newest) >= newest:
            return
        needed = {posed.revision_at(seen) for seen in self._seen.values() if seen < newest}
        for revision in set(posed.copies) - needed:
            posed.copies.pop(revision).destroy()
        if lost in needed:
            size = posed.mesh.positions.nbytes
            source = posed.buffer
            assert source is not None
            copy = posed.copies[lost] = self._device.buffer(size, "pose that a renderer has seen")
            region = raw.struct("VkBufferCopy", srcOffset=(1 - posed.side) * size, size=size)

            def record(commands: raw.CData) -> None:
                if source.handle is not None and copy.handle is not None:
                    self._device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
                    self._device.vk.vkCmdCopyBuffer(commands, source.handle, copy.handle, 1, region)

            self._device.before_next_submit(record)

    def _make(self, posed: PosedMesh, base: int, attributes: NDArray[Any] | None) -> None:
        """Make vertices and BLASes of its own. attributes: those of the rest pose."""
        device = self._device
        mesh = posed.mesh
        if mesh not in self._sources:
            self._sources[mesh] = self._upload_source(mesh.deformation)
        # Positions twice, then the attributes, which poses overwrite in place: nobody reads previous normals.
        size = mesh.positions.nbytes
        total = 2 * size + (0 if attributes is None else attributes.nbytes)
        name = f"posed {mesh.name or 'mesh'}"
        posed.buffer = buffer = device.buffer(total, name)
        if attributes is not None:
            buffer.upload(attributes, 2 * size)
        posed.addresses = buffer.address, buffer.address + size, buffer.address + 2 * size
        posed.side = 0
        posed.refits = 0
        self._moving.pop(posed, None)
        if not self._rows[posed][1]:
            return
        record = self._meshes.records[base]
        for address in posed.addresses[:2]:
            geometry = TriangleGeometry(
                positions=address,
                position_count=len(mesh.positions),
                indices=int(record["triangles"]),
                triangle_count=int(record["triangle_count"]),
                no_duplicate_any_hit=True,  # which blended surfaces need, and structures that are refitted allow
            )
            blas = mesh_structure(device, geometry, name, moves=True)
            if isinstance(blas, Blas):
                blas.ensure_storage()
            posed.blases.append(blas)

    def _upload_source(self, deformation: Deformation | None) -> Buffer:
        """Influences, then for each target and vertex all that it adds."""
        assert deformation is not None
        parts: list[NDArray[Any]] = []
        if deformation.joints is not None and deformation.joint_weights is not None:
            influences = np.zeros(deformation.joints.shape, self._influence)
            influences["weight"] = deformation.joint_weights
            influences["joint"] = np.where(deformation.joint_weights > 0, deformation.joints, 0)
            parts.append(influences)
        if deformation.targets is not None:
            added = (deformation.targets, deformation.target_normals, deformation.target_tangents)
            parts.append(np.concatenate([part for part in added if part is not None], axis=2))
        with self._device.undone_on_error():
            buffer = self._device.buffer(max(sum(part.nbytes for part in parts), 4), "deformation")
            offset = 0
            for part in parts:
                buffer.upload(part, offset)
                offset += part.nbytes
        return buffer

    def _write_record(self, posed: PosedMesh, base: int) -> None:
        row, _ = self._rows[posed]
        self._meshes.records[row] = self._meshes.records[base]
        record = self._meshes.records[row]
        low, high = posed.deformation.bounds(posed.mesh.positions, *posed.pose)
        record["bounds_min"] = low
        record["bounds_max"] = high
        record["positions"] = record["previous_positions"] = posed.addresses[posed.side]
        record["attributes"] = posed.addresses[2] if record["attributes"] else 0
        self._meshes.mark([row])
        x, y, z = high - low
        posed.area = float(x * y + y * z + z * x)

    def time_poses(self) -> Stopwatch:
        """Time the device's work from now on; returns what tells the times of the latest poses, by TIMED."""
        if self._commands.stopwatch is None:
            self._commands.stopwatch = Stopwatch(self._device, TIMED)
        return self._commands.stopwatch

    def submit(self) -> None:
        """Compute the vertices of new poses and bring their BLASes up to date, just before the next submission."""
        if self._to_compute:
            self._commands.submit(list(self._to_compute))
            self._to_compute.clear()

    def destroy(self) -> None:
        for posed in self._rows:
            posed.destroy()
        for source in self._sources.values():
            source.destroy()
        for edited in self._edited.values():
            edited.destroy()
        self._commands.destroy()


def _same(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))
