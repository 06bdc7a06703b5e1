"""Builds of many bottom-level structures: batched by a scratch budget, compacted or refitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.compaction import SizeQuery, copy_compacted
from solari_vk.gpu.acceleration.structure import clock, make_scratch, scratch_size
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.device import Device

# A large scene is built in parts, of which only one at a time needs scratch and uncompacted storage.
SCRATCH_BUDGET = 256 << 20


@dataclass(frozen=True)
class BlasBuild:
    """A structure to build from its geometries or, with `update`, to refit to them. source: what the refit starts from,
    by default the structure as it is."""

    blas: Blas
    update: bool = False
    source: Blas | None = None

    @property
    def scratch(self) -> int:
        """Scratch bytes of the build."""
        return scratch_size(self.blas.device, self.blas, self.update)


def build_blases(
    device: Device,
    blases: Sequence[Blas],
    *,
    compact: bool = True,
    update: bool = False,
    scratch_budget: int = SCRATCH_BUDGET,
) -> None:
    """Build structures in as few batches as the scratch budget (bytes) allows, and compact them.

    Batches run after all earlier and before all later work. With `compact`, each batch is waited for, so that only one
    batch at a time is in memory uncompacted; addresses are final when this function returns. `update` refits structures
    that were made with allow_update. Raises SolariError for a structure that was destroyed or compacted.
    """
    builds = [BlasBuild(blas, update) for blas in blases]
    check_builds(device, builds)
    # One time for the call: all batches of it count as built together.
    at = clock.tick()
    for batch in batches(builds, scratch_budget):
        submit_batch(device, batch, at)
        # A refit writes to the storage that is there, so what is refitted keeps its size.
        shrinking = [build.blas for build in batch if compact and build.blas.allow_compaction and not update]
        if shrinking:
            compact_in_place(device, shrinking)


def check_builds(device: Device, builds: Sequence[BlasBuild]) -> None:
    """Raise SolariError unless these structures can be built or refitted, together in one call."""
    for build in builds:
        blas = build.blas
        blas.check_alive("build", device)
        if blas.compacted:
            raise SolariError(
                f"build of Blas {blas.name}, which was compacted and can't be built again: make a new one"
            )
        if build.update:
            blas.check_update()
    seen: set[int] = set()
    for build in builds:
        if id(build.blas) in seen:
            raise SolariError(f"the same Blas twice in one build: {build.blas.name}")
        seen.add(id(build.blas))


def batches(builds: Sequence[BlasBuild], budget: int = SCRATCH_BUDGET) -> list[list[BlasBuild]]:
    """Groups of consecutive structures whose scratch fits the budget; a larger structure is a group of its own."""
    found: list[list[BlasBuild]] = []
    scratch = storage = 0
    for build in builds:
        # Storage before compaction, which is several times the scratch, is bounded too.
        if not found or scratch + build.scratch > budget or storage + build.blas.size > 4 * budget:
            found.append([])
            scratch = storage = 0
        found[-1].append(build)
        scratch += build.scratch
        storage += build.blas.size
    return found


def submit_batch(device: Device, batch: Sequence[BlasBuild], at: int) -> None:
    """Build a batch for the build call at time `at`, after all earlier and before all later work."""
    # Builds of one call may run at the same time, so each has scratch of its own.
    scratch, address = make_scratch(device, sum(build.scratch for build in batch), "blas scratch")
    infos = []
    for build in batch:
        build.blas.ensure_storage()
        infos.append(build.blas.build_info(address, update=build.update, source=build.source))
        address += build.scratch
    infos_array = raw.array("VkAccelerationStructureBuildGeometryInfoKHR", infos)
    ranges = raw.array("VkAccelerationStructureBuildRangeInfoKHR*", [build.blas.ranges for build in batch])

    def record(cmd: raw.CData) -> None:
        vk = device.vk
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        vk.vkCmdBuildAccelerationStructuresKHR(cmd, len(batch), infos_array, ranges)
        vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    device.start(record, "build blases")
    for build in batch:
        build.blas.mark_built(at, update=build.update)
    # The buffer is freed when this submission is done.
    scratch.destroy()


def compact_in_place(device: Device, blases: Sequence[Blas]) -> None:
    """Move structures that were just built, and that nothing refers to yet, to storage of their compacted size."""
    sizes = SizeQuery(device, [blas.handle for blas in blases]).read()
    copies = []
    replaced = []
    for blas, size in zip(blases, sizes, strict=True):
        # A size of 0, or one that is no smaller, leaves the structure where it is: the copy would gain nothing.
        if 0 < size < blas.size:
            source = blas.handle
            replaced.append(blas.move_to(size))
            copies.append((source, blas.handle))
    copy_compacted(device, copies)
    for free in replaced:
        free()
