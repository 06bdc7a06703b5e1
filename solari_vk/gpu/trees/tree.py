"""Trees of boxes over the triangles of a mesh, or over instances, and builds by glsl/scene/trees/build.comp.

They take the place of acceleration structures on devices whose rays are traced by compute: a MeshTree that of a Blas, a
SceneTree that of a Tlas, of whose interface they have what scenes need.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import DeviceError, SolariError
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
SLOT_BYTES = 64
TAG_DTYPE = np.dtype([("number", "<u4"), ("slot", "<u4")])
"""TriangleTags of build.comp."""
CLUSTER_BYTES = 48
PLACE_BYTES = 4
# Scratch for each primitive: the primitive itself and a node above it, and a place in four lists.
SCRATCH_BYTES = 2 * CLUSTER_BYTES + 4 * PLACE_BYTES
# A large scene is built in parts, of which only one at a time needs scratch.
SCRATCH_BUDGET = 256 << 20
# While a tree is built, 26 bits count its leaves, of which there are half as many as triangles.
MAX_PRIMITIVES = 1 << 27
GROUP_SIZE = 256  # threads of a workgroup
MAX_GROUPS = 65535  # of one dispatch, on any device
# Of a large tree each workgroup clusters up to 2^(LEFT_HALVINGS + STAGE_HALVINGS) neighbors until 2^LEFT_HALVINGS are
# left, then of the clusters of 2^STAGE_HALVINGS workgroups one does so in the next stage.
LEFT_HALVINGS = 6  # a workgroup has a thread for each of these clusters
STAGE_HALVINGS = 5
IMPROVING_STAGES = 1 << 30
WRITING_STEP = 5  # of reinsertion.glsl, the last one
# Trees over more instances aren't improved, since a step would take more than a millisecond.
MAX_IMPROVED = 1 << 15
# Rounds of reinsertion when trees over triangles that stay are built. Many triangles at once get fewer: of the trees
# that are built together, rounds times triangles are at most MOST_IMPROVED. A processor takes 4 microseconds for a
# triangle in a round.
IMPROVING_ROUNDS = 12
MOST_IMPROVED = 1 << 22
MOST_IMPROVED_BY_CPU = 1 << 16
# Trees over fewer triangles aren't improved: that gained nothing.
FEWEST_IMPROVED = 1 << 9
SORTING_STAGES = 1 << 31
SORTING_STEPS = 30  # the stage of this number stands for all of a small tree
WRITING_STAGE = 0xFFFFFFFF
PART_BYTES = 8
BUILD_DTYPE = np.dtype(
    [(name, "<u8") for name in ("corners", "indices", "tags", "instances", "flat_tree", "nodes", "clusters", "lists")]
    + [(name, "<u4") for name in ("count", "slot_count", "is_of_instances", "keeps_all", "halvings", "sorts_first")]
)
"""TreeBuild of build.comp."""

_kernels: WeakKeyDictionary[Device, dict[str, Kernel]] = WeakKeyDictionary()


def _memory(device: Device, size: int, name: str) -> Buffer:
    """Memory for trees, or to build them. Raises DeviceError with the remedy where there isn't enough."""
    try:
        return device.buffer(size, name, use="trees")
    except DeviceError as error:
        if device.lost or device.closed:
            raise
        each = f"{NODE_BYTES // 2 + TRIANGLE_BYTES} bytes a triangle, and {SCRATCH_BYTES} more while they are built"
        raise DeviceError(f"{error}; trees take {each}: simplify large meshes, or split them") from error


def tree_kernel(device: Device, name: str) -> Kernel:
    """The shader of this name in glsl/scene/trees/."""
    made = _kernels.setdefault(device, {})
    if name not in made:
        made[name] = Kernel(device, f"scene/trees/{name}.comp")
    return made[name]


def halvings_of(count: int) -> int:
    """How often so many primitives are halved into chunks."""
    return (max(count - 1, 0) >> LEFT_HALVINGS + STAGE_HALVINGS).bit_length()


class Tree:
    """Memory for a tree over at most `capacity` primitives in `leaves` leaves. leaf_bytes: of each primitive."""

    def __init__(self, device: Device, capacity: int, leaves: int, leaf_bytes: int, name: str) -> None:
        if capacity > MAX_PRIMITIVES:
            raise SolariError(f"{name}: a tree holds {MAX_PRIMITIVES:,} primitives, not {capacity:,}: split it")
        self.device = device
        self.name = name
        self.built = False
        self.destroyed = False
        # Slot 0 is there for an empty tree too.
        self.slot_count = max(leaves, 1)
        self._size = NODE_BYTES * self.slot_count + leaf_bytes * max(capacity, 1)
        self._buffer: Buffer | None = None

    @property
    def buffer(self) -> Buffer:
        """The memory, once `ensure_memory` was called."""
        assert self._buffer is not None
        return self._buffer

    @property
    def address(self) -> int:
        """Where the memory is; 0 if there is none."""
        return 0 if self._buffer is None else self._buffer.address

    def ensure_memory(self) -> None:
        """Make the memory before the first build."""
        if self._buffer is None:
            self._buffer = _memory(self.device, self._size, self.describe())

    def take_memory(self) -> Buffer:
        """The memory, which is the caller's to free; the tree can be built again in another one."""
        taken = self.buffer
        self._buffer = None
        self.built = False
        return taken

    def describe(self) -> str:
        """Its name in messages."""
        return f"tree {self.name}"

    def mark_built(self) -> None:
        """Note that a build was submitted."""
        self.built = True

    def destroy(self) -> None:
        """Free the memory when the work submitted so far is done. Safe to call twice."""
        self.destroyed = True
        if self._buffer is not None:
            self._buffer.destroy()


class Topology:
    """What a tree that was built has in common with those that were refitted from it. newest: of them."""

    def __init__(self, newest: MeshTree) -> None:
        self.newest = newest


class MeshTree(Tree):
    """A tree over the triangles of a mesh in device memory, which come in spatial order. moves: it can be refitted, and
    has memory from the start."""

    def __init__(self, device: Device, geometry: TriangleGeometry, name: str, *, moves: bool = False) -> None:
        count = geometry.triangle_count
        # build.comp gives each of its chunks no more leaves than half its triangles, rounded up.
        super().__init__(device, count, (count + (1 << halvings_of(count))) // 2, TRIANGLE_BYTES, name)
        self.geometry = geometry
        self.moves = moves
        self.topology = Topology(self)
        if moves:
            self.ensure_memory()
            self.buffer.fill()  # what refits pass from child to child

    def mark_built(self) -> None:
        """Note that a build was submitted."""
        super().mark_built()
        self.topology = Topology(self)

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


class FlatTree(MeshTree):
    """A tree over the triangles of several instances in world space.

    tags: the address of a TAG_DTYPE record of each triangle. instance_count: of which the slots are below it.
    """

    def __init__(self, device: Device, geometry: TriangleGeometry, tags: int, instance_count: int) -> None:
        super().__init__(device, geometry, "static instances")
        self.instance_count = instance_count
        self._tags = tags

    @property
    def job(self) -> dict[str, int]:
        return super().job | {"tags": self._tags}


class SceneTree(Tree):
    """A tree over up to `max_instances` INSTANCE_DTYPE records, whose blas_address are those of MeshTrees.

    The offset in a record is one more than the instance's slot in the flat tree, or 0 if it isn't there.
    """

    def __init__(self, device: Device, max_instances: int, *, name: str = "scene") -> None:
        super().__init__(device, max_instances, max_instances, INSTANCE_BYTES + SLOT_BYTES, name)
        self.ensure_memory()
        self.max_instances = max_instances

    def record_clear(self, commands: raw.CData) -> None:
        """Record that no instance is in the flat tree, as it is before each build."""
        size = SLOT_BYTES * self.slot_count
        self.device.vk.vkCmdFillBuffer(commands, self.buffer.handle, self.buffer.size - size, size, 0)


def parts_of(records: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.uint32]:
    """The work of workgroups (G, 2): the numbers of records, each as often as it has parts, and the parts."""
    begins = np.cumsum(counts) - counts
    numbers = np.arange(counts.sum()) - np.repeat(begins, counts)
    return np.stack([np.repeat(records, counts), numbers], axis=1).astype(np.uint32)


def record_parts(device: Device, commands: raw.CData, kernel: Kernel, count: int, parts: int, **pushed: int) -> None:
    """Record a workgroup for each of `count` parts, which are at an address, after all earlier and before all later
    work."""
    vk = device.vk
    vk.vkCmdPipelineBarrier2(commands, full_barrier())
    for first in range(0, count, MAX_GROUPS):
        groups = min(count - first, MAX_GROUPS)
        kernel.record(commands, (GROUP_SIZE * groups, 1), parts=parts + PART_BYTES * first, **pushed)
    vk.vkCmdPipelineBarrier2(commands, full_barrier())


def _sorting_stages(trees: NDArray[np.int64], halvings: NDArray[np.int64]) -> list[tuple[int, NDArray[np.uint32]]]:
    """The stages that sort the primitives of these trees, and their parts: glsl/scene/trees/sort.glsl."""
    small, large = trees[halvings == 0], trees[halvings > 0]
    stages = []
    if len(small):
        stages.append((SORTING_STAGES + SORTING_STEPS, parts_of(small, np.ones_like(small))))
    if len(large):
        of_chunks = parts_of(large, 1 << halvings[halvings > 0])
        of_trees = parts_of(large, np.ones_like(large))
        # Of three steps one puts together what chunks have counted.
        for step in range(SORTING_STEPS):
            stages.append((SORTING_STAGES + step, of_trees if step % 3 == 1 else of_chunks))
    return stages


def _stages(halvings: NDArray[np.int64], sorts_first: NDArray[np.bool_]) -> list[tuple[int, NDArray[np.uint32]]]:
    """The stages of builds of trees whose primitives are halved so often into chunks, and the parts of each.
    sorts_first: whether primitives must be sorted first."""
    every = np.arange(len(halvings))
    stages = _sorting_stages(every[sorts_first], halvings[sorts_first])
    stages.append((0, parts_of(every, 1 << halvings)))
    large = every[halvings > 0]
    left = large
    while len(left):
        stage = stages[-1][0] + 1
        chunks = 1 << np.maximum(halvings[left] - STAGE_HALVINGS * stage, 0)
        stages.append((stage, parts_of(left, chunks)))
        left = left[chunks > 1]
    if len(large):
        stages.append((WRITING_STAGE, parts_of(large, 1 << halvings[large])))
    return stages


class TreeBuilds:
    """Builds of trees, which can be recorded and submitted again. jobs: trees, and what their builds read by the names
    of BUILD_DTYPE."""

    def __init__(self, device: Device, jobs: Sequence[tuple[Tree, dict[str, int]]]) -> None:
        self._device = device
        self.trees = [tree for tree, _ in jobs]
        counts = [max(read["count"], 1) for _, read in jobs]  # chunks of nothing write their length too
        halvings = list(map(halvings_of, counts))
        records = np.zeros(len(jobs), BUILD_DTYPE)
        records["halvings"] = halvings
        records["sorts_first"] = [read.get("sorts_first", 0) for _, read in jobs]
        self._stages = _stages(records["halvings"].astype(np.int64), records["sorts_first"] > 0)
        of_instances = np.array([read.get("is_of_instances", 0) for _, read in jobs], bool)
        improved = np.array(counts)
        improved[of_instances & (improved > MAX_IMPROVED)] = 0
        improved[~of_instances & (improved < FEWEST_IMPROVED)] = 0
        # Refits compare the costs of trees that move, and improving overwrites these.
        improved[np.array([read.get("keeps_all", 0) for _, read in jobs], bool)] = 0
        self._improving = parts_of(np.arange(len(jobs)), -(-2 * improved // GROUP_SIZE))
        self._rounds = 0
        if improved.any() and not of_instances.any():
            most = MOST_IMPROVED_BY_CPU if device.properties.kind == "cpu" else MOST_IMPROVED
            self._rounds = min(IMPROVING_ROUNDS, most // int(improved.sum()))
        parts = np.concatenate([*(parts for _, parts in self._stages), self._improving])
        for tree in self.trees:
            tree.ensure_memory()
        names = ", ".join(tree.name for tree in self.trees[:3]) + (", ..." if len(jobs) > 3 else "")
        with device.undone_on_error():
            self._kernel = tree_kernel(device, "build")
            size = max(SCRATCH_BYTES * sum(counts), 16)
            self._scratch = _memory(device, size, f"that builds trees of {names}")
            self._records = device.buffer(max(BUILD_DTYPE.itemsize * len(jobs), 16), "builds of trees")
            self._parts = device.buffer(max(parts.nbytes, 16), "parts of builds")
        clusters = self._scratch.address
        lists = clusters + 2 * CLUSTER_BYTES * sum(counts)
        for record, (tree, read), count in zip(records, jobs, counts, strict=True):
            made = {"nodes": tree.address, "slot_count": tree.slot_count, "clusters": clusters, "lists": lists}
            for name, value in (read | made).items():
                record[name] = value
            clusters += 2 * CLUSTER_BYTES * count
            lists += 4 * PLACE_BYTES * count
        if jobs:
            self._records.upload(records)
            self._parts.upload(parts)

    def record(self, commands: raw.CData) -> None:
        """Record the builds, after all earlier and before all later work."""
        at = self._parts.address
        for stage, parts in self._stages:
            pushed = {"stage": stage, "stage_halvings": STAGE_HALVINGS, "left_halvings": LEFT_HALVINGS}
            record_parts(self._device, commands, self._kernel, len(parts), at, builds=self._records.address, **pushed)
            at += parts.nbytes
        self.record_improvement(commands, self._rounds)

    def record_improvement(self, commands: raw.CData, rounds: int = 1) -> None:
        """Record rounds that improve the trees, which were built, by reinsertion.glsl."""
        at = self._parts.address + sum(parts.nbytes for _, parts in self._stages)
        steps = [*range(WRITING_STEP)] * rounds + [WRITING_STEP] * min(rounds, 1)
        for step in steps:
            pushed = {"stage": IMPROVING_STAGES + step, "stage_halvings": 0, "left_halvings": 0}
            builds = self._records.address
            record_parts(self._device, commands, self._kernel, len(self._improving), at, builds=builds, **pushed)

    def mark_built(self) -> None:
        """Note that the builds were submitted."""
        for tree in self.trees:
            tree.mark_built()

    def destroy(self) -> None:
        """Free the scratch when the work submitted so far is done."""
        for owned in (self._scratch, self._records, self._parts):
            owned.destroy()


def build_meshes(
    device: Device, trees: Sequence[MeshTree], budget: int = SCRATCH_BUDGET, *, moved: bool = False
) -> None:
    """Submit builds of trees over meshes, as many at a time as have room in a budget of scratch bytes. moved: their
    triangles, which may be in no spatial order any more; the trees were refitted."""
    part: list[MeshTree] = []
    for tree in trees:
        if SCRATCH_BYTES * sum(one.geometry.triangle_count for one in (*part, tree)) > budget and part:
            _submit(device, part, moved)
            part = []
        part.append(tree)
    if part:
        _submit(device, part, moved)


def _submit(device: Device, trees: Sequence[MeshTree], moved: bool) -> None:
    builds = TreeBuilds(device, [(tree, tree.job | {"sorts_first": int(moved)}) for tree in trees])
    device.start(builds.record, "build trees")
    builds.mark_built()
    builds.destroy()


class SceneBuilds:
    """Builds of trees over instances, recorded once and submitted whenever the records have changed.

    instances: the device address of the records, `stride` for each tree, one after the other, of which it has the first
    of these `counts`. flat_tree: of the instances with slots, if there is one.
    """

    def __init__(
        self,
        trees: Sequence[SceneTree],
        instances: int,
        stride: int,
        counts: Sequence[int],
        flat_tree: FlatTree | None = None,
    ) -> None:
        device = trees[0].device
        self._scene_trees = trees
        self._has_slots = flat_tree is not None
        record_bytes = 64  # INSTANCE_DTYPE
        jobs: list[tuple[Tree, dict[str, int]]] = []
        for index, (tree, count) in enumerate(zip(trees, counts, strict=True)):
            first = instances + index * stride * record_bytes
            flat = 0 if flat_tree is None else flat_tree.address
            jobs.append((tree, {"instances": first, "count": count, "flat_tree": flat, "is_of_instances": 1}))
        self._builds = TreeBuilds(device, jobs)
        self._device = device
        self._commands = Recorded(device, self._record, "build scene trees")
        self._improvement: Recorded | None = None

    def _record(self, commands: raw.CData) -> None:
        if self._has_slots:
            self._scene_trees[0].device.vk.vkCmdPipelineBarrier2(commands, full_barrier())
            for tree in self._scene_trees:
                tree.record_clear(commands)
        self._builds.record(commands)

    def submit(self) -> None:
        """Have the builds run just before the next submission."""
        self._commands.submit_with_next()
        self._builds.mark_built()

    def improve(self) -> None:
        """Have a step that improves the trees run just before the next submission."""
        if self._improvement is None:
            self._improvement = Recorded(self._device, self._builds.record_improvement, "improve scene trees")
        self._improvement.submit_with_next()

    def destroy(self) -> None:
        """Free the commands and the scratch when the work submitted so far is done. Safe to call twice."""
        for owned in (self._commands, self._builds, self._improvement):
            if owned is not None:
                owned.destroy()


class SceneBuild(SceneBuilds):
    """The build of one tree over `count` records at an address."""

    def __init__(self, tree: SceneTree, instances: int, count: int, flat_tree: FlatTree | None = None) -> None:
        super().__init__([tree], instances, 0, [count], flat_tree)


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
