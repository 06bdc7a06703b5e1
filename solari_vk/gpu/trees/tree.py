"""Trees of boxes over the triangles of a mesh, or over instances: builds by glsl/scene/trees/build.comp, and refits of
meshes that move by refit.comp.

They take the place of acceleration structures on devices whose rays are traced by compute: a MeshTree that of a Blas, a
SceneTree that of a Tlas, of whose interface they have what scenes need.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.kernel import Kernel

# Of the records of glsl/scene/trees/tree.glsl and build.comp.
NODE_BYTES = 64
TRIANGLE_BYTES = 48
INSTANCE_BYTES = 80
CLUSTER_BYTES = 48
PLACE_BYTES = 4
# Scratch for each primitive: the primitive itself and a node above it, and a place in three lists.
SCRATCH_BYTES = 2 * CLUSTER_BYTES + 3 * PLACE_BYTES
# A large scene is built in parts, of which only one at a time needs scratch.
SCRATCH_BUDGET = 256 << 20
# A leaf has 28 bits for the place of its first primitive.
MAX_PRIMITIVES = 1 << 28
GROUP_SIZE = 256  # threads that build a tree
MAX_GROUPS = 65535  # of one dispatch, on any device
BUILD_DTYPE = np.dtype(
    [(name, "<u8") for name in ("corners", "indices", "instances", "nodes", "clusters", "lists")]
    + [(name, "<u4") for name in ("count", "slot_count", "is_of_instances", "keeps_all")]
)
"""TreeBuild of build.comp."""

REFIT_DTYPE = np.dtype(
    [(name, "<u8") for name in ("corners", "indices", "source", "fitted")]
    + [(name, "<u4") for name in ("slot_count", "triangle_count")]
)
"""TreeRefit of refit.comp."""

_kernels: WeakKeyDictionary[Device, dict[str, Kernel]] = WeakKeyDictionary()


def _kernel(device: Device, name: str) -> Kernel:
    made = _kernels.setdefault(device, {})
    if name not in made:
        made[name] = Kernel(device, f"scene/trees/{name}.comp")
    return made[name]


class Tree:
    """Memory for a tree over at most `capacity` primitives, whose leaves have so many bytes each."""

    def __init__(self, device: Device, capacity: int, leaf_bytes: int, name: str) -> None:
        if capacity > MAX_PRIMITIVES:
            raise SolariError(f"{name}: a tree holds {MAX_PRIMITIVES:,} primitives, not {capacity:,}: split it")
        self.device = device
        self.name = name
        self.built = False
        self.destroyed = False
        # Slot 0 is there for an empty tree too.
        self.slot_count = max(capacity, 1)
        self.buffer: Buffer = device.buffer((NODE_BYTES + leaf_bytes) * self.slot_count, self.describe())
        self.address = self.buffer.address

    def describe(self) -> str:
        """Its name in messages."""
        return f"tree {self.name}"

    def destroy(self) -> None:
        """Free the memory when the work submitted so far is done. Safe to call twice."""
        self.destroyed = True
        self.buffer.destroy()


class MeshTree(Tree):
    """A tree over the triangles of a mesh in device memory, which come in spatial order. moves: it can be refitted."""

    def __init__(self, device: Device, geometry: TriangleGeometry, name: str, *, moves: bool = False) -> None:
        super().__init__(device, geometry.triangle_count, TRIANGLE_BYTES, name)
        self.geometry = geometry
        self.moves = moves
        if moves:
            self.buffer.fill()  # refits look at all slots, also at those without nodes

    def set_geometries(self, geometries: Sequence[TriangleGeometry]) -> None:
        """Have later builds and refits read this geometry, with as many triangles."""
        [self.geometry] = geometries

    @property
    def job(self) -> dict[str, int]:
        """What a build of it reads."""
        geometry = self.geometry
        return {
            "corners": geometry.positions,
            "indices": geometry.indices,
            "count": geometry.triangle_count,
            "keeps_all": int(self.moves),
        }


class SceneTree(Tree):
    """A tree over up to `max_instances` INSTANCE_DTYPE records, whose blas_address are those of MeshTrees."""

    def __init__(self, device: Device, max_instances: int, *, name: str = "scene") -> None:
        super().__init__(device, max_instances, INSTANCE_BYTES, name)
        self.max_instances = max_instances


def _record_groups(
    device: Device, commands: raw.CData, kernel: Kernel, count: int, record_bytes: int, **address: int
) -> None:
    """Record a workgroup for each of `count` records, after all earlier and before all later work. address: of the
    first record, by the name that the kernel has for it."""
    vk = device.vk
    vk.vkCmdPipelineBarrier2(commands, full_barrier())
    for first in range(0, count, MAX_GROUPS):
        groups = min(count - first, MAX_GROUPS)
        moved = {name: begin + first * record_bytes for name, begin in address.items()}
        kernel.record(commands, (GROUP_SIZE * groups, 1), **moved)
    vk.vkCmdPipelineBarrier2(commands, full_barrier())


class TreeBuilds:
    """Builds of trees, a workgroup each, which can be recorded and submitted again. jobs: trees, and what their builds
    read by the names of BUILD_DTYPE."""

    def __init__(self, device: Device, jobs: Sequence[tuple[Tree, dict[str, int]]]) -> None:
        self._device = device
        self.trees = [tree for tree, _ in jobs]
        counts = [read["count"] for _, read in jobs]
        with device.undone_on_error():
            self._kernel = _kernel(device, "build")
            self._scratch = device.buffer(max(SCRATCH_BYTES * sum(counts), 16), "scratch of trees")
            self._records = device.buffer(max(BUILD_DTYPE.itemsize * len(jobs), 16), "builds of trees")
        clusters = self._scratch.address
        lists = clusters + 2 * CLUSTER_BYTES * sum(counts)
        records = np.zeros(len(jobs), BUILD_DTYPE)
        for record, (tree, read), count in zip(records, jobs, counts, strict=True):
            made = {"nodes": tree.address, "slot_count": tree.slot_count, "clusters": clusters, "lists": lists}
            for name, value in (read | made).items():
                record[name] = value
            clusters += 2 * CLUSTER_BYTES * count
            lists += 3 * PLACE_BYTES * count
        if jobs:
            self._records.upload(records)

    def record(self, commands: raw.CData) -> None:
        """Record the builds, after all earlier and before all later work."""
        _record_groups(
            self._device, commands, self._kernel, len(self.trees), BUILD_DTYPE.itemsize, builds=self._records.address
        )

    def mark_built(self) -> None:
        """Note that the builds were submitted."""
        for tree in self.trees:
            tree.built = True

    def destroy(self) -> None:
        """Free the scratch when the work submitted so far is done."""
        self._scratch.destroy()
        self._records.destroy()


class TreeRefits:
    """Refits of trees over meshes that have moved, a workgroup each. pairs: trees, and those from which their nodes are
    taken: built ones of the same meshes."""

    def __init__(self, device: Device, pairs: Sequence[tuple[MeshTree, MeshTree]]) -> None:
        self._device = device
        self._pairs = pairs
        rows = []
        for tree, source in pairs:
            geometry = tree.geometry
            addresses = geometry.positions, geometry.indices, source.address, tree.address
            rows.append((*addresses, tree.slot_count, geometry.triangle_count))
        records = np.array(rows, REFIT_DTYPE)
        with device.undone_on_error():
            self._kernel = _kernel(device, "refit")
            self._records = device.buffer(max(records.nbytes, 16), "refits of trees")
        if pairs:
            self._records.upload(records)

    def record(self, commands: raw.CData) -> None:
        """Record the refits, after all earlier and before all later work."""
        _record_groups(
            self._device, commands, self._kernel, len(self._pairs), REFIT_DTYPE.itemsize, refits=self._records.address
        )
        for tree, _ in self._pairs:
            tree.built = True

    def destroy(self) -> None:
        """Free the records when the work submitted so far is done."""
        self._records.destroy()


def build_meshes(device: Device, trees: Sequence[MeshTree], budget: int = SCRATCH_BUDGET) -> None:
    """Submit builds of trees over meshes, as many at a time as have room in a budget of scratch bytes."""
    part: list[MeshTree] = []
    for tree in trees:
        if SCRATCH_BYTES * sum(one.slot_count for one in (*part, tree)) > budget and part:
            _submit(device, part)
            part = []
        part.append(tree)
    if part:
        _submit(device, part)


def refit_meshes(device: Device, pairs: Sequence[tuple[MeshTree, MeshTree]]) -> None:
    """Submit refits: `TreeRefits`."""
    if not pairs:
        return
    refits = TreeRefits(device, pairs)
    device.start(refits.record, "refit trees")
    refits.destroy()


def _submit(device: Device, trees: Sequence[MeshTree]) -> None:
    builds = TreeBuilds(device, [(tree, tree.job) for tree in trees])
    device.start(builds.record, "build trees")
    builds.mark_built()
    builds.destroy()


class SceneBuilds:
    """Builds of trees over instances, recorded once and submitted whenever the records have changed.

    instances: the device address of the records, `stride` for each tree, one after the other, of which it has the first
    of these `counts`.
    """

    def __init__(self, trees: Sequence[SceneTree], instances: int, stride: int, counts: Sequence[int]) -> None:
        device = trees[0].device
        record_bytes = 64  # INSTANCE_DTYPE
        jobs: list[tuple[Tree, dict[str, int]]] = []
        for index, (tree, count) in enumerate(zip(trees, counts, strict=True)):
            first = instances + index * stride * record_bytes
            jobs.append((tree, {"instances": first, "count": count, "is_of_instances": 1}))
        self._builds = TreeBuilds(device, jobs)
        self._commands = Recorded(device, self._builds.record, "build scene trees")

    def submit(self) -> None:
        """Have the builds run just before the next submission."""
        self._commands.submit_with_next()
        self._builds.mark_built()

    def destroy(self) -> None:
        """Free the commands and the scratch when the work submitted so far is done. Safe to call twice."""
        self._commands.destroy()
        self._builds.destroy()


class SceneBuild(SceneBuilds):
    """The build of one tree over `count` records at an address."""

    def __init__(self, tree: SceneTree, instances: int, count: int) -> None:
        super().__init__([tree], instances, 0, [count])


class SceneCopy:
    """A copy of a tree to another one of the same size, recorded once and submitted as often as needed."""

    def __init__(self, source: SceneTree, target: SceneTree) -> None:
        self.made_for = source, target
        vk = source.device.vk

        def record(commands: raw.CData) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            source.buffer.record_copy(commands, target.buffer.handle, size=source.buffer.size)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())

        self._commands = Recorded(source.device, record, "copy scene tree")

    def submit(self) -> None:
        """Have the copy run just before the next submission."""
        self._commands.submit_with_next()
        self.made_for[1].built = True

    def destroy(self) -> None:
        """Free the commands when the work submitted so far is done. Safe to call twice."""
        self._commands.destroy()
