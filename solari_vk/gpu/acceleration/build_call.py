"""Build calls: several structures at once, after a check of the wgpu document's rules on the order of builds.

A Blas must be built in the same call as any Tlas over it, or in an earlier one. Calls take effect in the order of their
submission.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import BlasBuild, batches, check_builds, submit_batch
from solari_vk.gpu.acceleration.checks import check_items, check_kind
from solari_vk.gpu.acceleration.geometry import check_fit
from solari_vk.gpu.acceleration.instances import TlasInstance, TlasInstances, gather
from solari_vk.gpu.acceleration.sources import Aabbs, Source, Triangles, Uploader
from solari_vk.gpu.acceleration.structure import clock
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device


@dataclass(frozen=True, eq=False)
class BlasBuildEntry:
    """A Blas and the geometries to build it from, which must be like those that it was created for."""

    blas: Blas
    geometries: Sequence[Source]

    def __post_init__(self) -> None:
        check_kind(self.blas, Blas, "build entry: the Blas", "give what rt.create_blas makes")
        what = f"build entry of {self.blas.describe()}: the geometries"
        geometries = check_items(self.geometries, (Triangles, Aabbs), what, "give rt.Triangles or rt.Aabbs")
        object.__setattr__(self, "geometries", tuple(geometries))


@dataclass(frozen=True, eq=False)
class TlasPackage:
    """A Tlas and the instances to build it over. None takes an index but is never hit."""

    tlas: Tlas
    instances: Sequence[TlasInstance | None] | TlasInstances = field(default=())

    def __post_init__(self) -> None:
        check_kind(self.tlas, Tlas, "package: the Tlas", "give what rt.create_tlas makes")
        what = f"package of {self.tlas.describe()}"
        remedy = "give a list of rt.TlasInstance objects"
        check_kind(self.instances, (Sequence, TlasInstances), f"{what}: the list of instances", remedy)
        if not isinstance(self.instances, TlasInstances):
            check_items(self.instances, (TlasInstance, type(None)), f"{what}: the instances", remedy)


class BuildCall:
    """A build call that is prepared now and submitted later, once or several times.

    Raises SolariError for entries that can't be built together. `submit` raises it for a wrong order of builds.
    """

    def __init__(
        self, device: Device, blases: Iterable[BlasBuildEntry] = (), tlases: Iterable[TlasPackage] = ()
    ) -> None:
        check_kind(device, Device, "build: the device", "give a solari_vk.Device")
        self._device = device
        self._entries = check_items(blases, BlasBuildEntry, "build: the Blases", "give rt.BlasBuildEntry objects")
        self._packages = check_items(tlases, TlasPackage, "build: the Tlases", "give rt.TlasPackage objects")
        self._check()
        for entry in self._entries:
            check_fit(entry.blas.made_for, [s.geometry() for s in entry.geometries], entry.blas.describe())
        names: set[int] = set()
        for package in self._packages:
            if id(package.tlas) in names:
                raise SolariError(f"the same Tlas twice in one build: {package.tlas.name}")
            names.add(id(package.tlas))

    def _check(self) -> None:
        """The checks that are made when the call is prepared, and again when it is submitted."""
        check_builds(self._device, [BlasBuild(entry.blas) for entry in self._entries])
        for package in self._packages:
            tlas = package.tlas
            count = len(package.instances)
            tlas.check_alive("build", self._device)
            if count > tlas.max_instances:
                raise SolariError(
                    f"build of {tlas.describe()}: {count:,} instances, but it was made for {tlas.max_instances:,}"
                )

    def _check_order(self, blases: Iterable[Blas], tlas: Tlas) -> None:
        built_here = {id(entry.blas) for entry in self._entries}
        for blas in blases:
            blas.check_alive(f"build of {tlas.describe()} over an instance", self._device)
            if not blas.built and id(blas) not in built_here:
                raise SolariError(
                    f"build of {tlas.describe()} over {blas.describe()}, which was not built: "
                    "build it in the same call or an earlier one"
                )

    def submit(self) -> int:
        """Submit the builds; returns the timeline value of their completion. Later work sees the results."""
        self._check()
        gathered = [gather(package.instances) for package in self._packages]
        # Each Blas once, whatever number of instances it has.
        used = [{id(b): b for b in blases if b is not None}.values() for blases, _ in gathered]
        for package, below in zip(self._packages, used, strict=True):
            self._check_order(below, package.tlas)
        uploader = Uploader(self._device)
        try:
            self._build(uploader, gathered, [list(below) for below in used])
        finally:
            uploader.free()
        return self._device.submitted

    def _build(
        self,
        uploader: Uploader,
        gathered: Sequence[tuple[Sequence[Blas | None], NDArray[Any]]],
        used: Sequence[Sequence[Blas]],
    ) -> None:
        # Blases and Tlases of one call get the same time, so that a Tlas may refer to a Blas of its own call.
        at = clock.tick()
        with uploader.uploads:
            placed = [[source.place(uploader) for source in entry.geometries] for entry in self._entries]
            for entry, geometries in zip(self._entries, placed, strict=True):
                entry.blas.set_geometries(geometries)
                entry.blas.ensure_storage()
            records = []
            for blases, table in gathered:
                # Addresses are final only now: `ensure_storage` has made the structures.
                addresses = [0 if blas is None else blas.address for blas in blases]
                table["blas_address"] = np.array(addresses, np.uint64)
                records.append((uploader.place("instances", table, table.itemsize)[0] if len(table) else 0, table))
        for batch in batches([BlasBuild(entry.blas, entry.blas.refits) for entry in self._entries]):
            submit_batch(self._device, batch, at)

        def record(cmd: raw.CData) -> None:
            for package, (address, table), blases in zip(self._packages, records, used, strict=True):
                tlas = package.tlas
                update = tlas.refits(table)
                tlas.record_build(cmd, address, len(table), update=update, blases=blases, at=at)
                # What the next call compares with to see whether a refit is enough.
                tlas.built_records = table

        if self._packages:
            self._device.start(record, "build tlases")
