"""Bottom-level acceleration structures: built over geometry, refitted, compacted."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.checks import check_kind, check_switch, show
from solari_vk.gpu.acceleration.compaction import Preparation, copy_compacted
from solari_vk.gpu.acceleration.geometry import (
    Geometry,
    build_ranges,
    check_fit,
    check_geometries,
    geometry_struct,
    refit_keys,
)
from solari_vk.gpu.acceleration.structure import BuildOptions, Structure
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device


class Blas(Structure):
    """A bottom-level structure over geometries that are all triangles or all boxes. It has an address once built.

    `size` is its storage in bytes, `built_size` the size before compaction. A build reads the memory that geometries
    point to; it isn't needed later. options: those of `BuildOptions`. Raises SolariError for geometry that can't be
    built.
    """

    def __init__(
        self,
        device: Device,
        geometries: Sequence[Geometry],
        *,
        allow_compaction: bool = True,
        name: str = "blas",
        **options: Any,
    ) -> None:
        self.geometries = tuple(geometries)
        self.compacted = False
        check_switch(allow_compaction, f"Blas {name}: allow_compaction")
        check_geometries(device, self.geometries, name)
        super().__init__(
            device,
            raw.VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
            BuildOptions(**options),
            [geometry_struct(geometry) for geometry in self.geometries],
            [geometry.primitive_count for geometry in self.geometries],
            name,
            more_flags=raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR * allow_compaction,
        )
        self.allow_compaction = allow_compaction
        self.built_size = self.size
        self.made_for = self.geometries
        self._built_from: tuple[Geometry, ...] = ()
        self._preparation: Preparation | None = None
        self.ranges = build_ranges(self.geometries)

    # ---- building -----------------------------------------------------------------------------------

    def set_geometries(self, geometries: Sequence[Geometry]) -> None:
        """Set the geometries of the next build.

        Raises SolariError unless they are like those that the structure was created for, and no larger.
        """
        check_geometries(self.device, geometries, self.name)
        check_fit(self.made_for, geometries, self.describe())
        self.geometries = tuple(geometries)
        self._geometries = raw.array("VkAccelerationStructureGeometryKHR", list(map(geometry_struct, geometries)))
        self.ranges = build_ranges(geometries)

    @property
    def refits(self) -> bool:
        """Whether a build call would refit it now: if it prefers updates and only positions and transforms changed."""
        return self.prefers_update and refit_keys(self.geometries) == refit_keys(self._built_from)

    def ensure_storage(self) -> None:
        """Make storage before the first build. Raises SolariError if the structure was destroyed."""
        self.check_alive("build")
        if self.handle is None:
            self.create(self.size)

    def mark_built(self, at: int, *, update: bool = False) -> None:
        """Record a build, which ends a preparation of compaction."""
        super().mark_built(at, update=update)
        self._built_from = self.geometries
        self._drop_preparation()

    # ---- compaction ---------------------------------------------------------------------------------

    def prepare_compaction(self, callback: Callable[[], None] | None = None) -> None:
        """Ask for its compacted size. It is `ready_for_compaction` once all work submitted so far is done.

        The callback is then called at the end of the device's next `wait`, `wait_idle` or `poll`, which raise its
        exceptions as a CallbackError. Building or destroying the structure before that ends the preparation without
        calling the callback. Raises SolariError for a structure that was never built, was made without
        allow_compaction, or is compacted.
        """
        self.check_alive("compaction")
        if callback is not None and not callable(callback):
            raise SolariError(f"compaction of {self.describe()}: the callback is {show(callback)}: give a function")
        if not self.built or self.compacted or not self.allow_compaction:
            why = "it was made without allow_compaction" if not self.allow_compaction else "it was never built"
            raise SolariError(
                f"compaction of {self.describe()}: {'it is already compacted' if self.compacted else why}"
            )
        self._drop_preparation()
        self._preparation = Preparation(self.device, self.handle, self.describe(), callback)

    @property
    def ready_for_compaction(self) -> bool:
        """Whether `compact` may be called now. Calls no callback."""
        return self._preparation is not None and self._preparation.ready

    def compact(self, name: str = "") -> Blas:
        """A compacted copy, independent of this structure.

        The copy can be neither built nor compacted. Raises SolariError unless `ready_for_compaction`.
        """
        self.check_alive("compaction")
        check_kind(name, str, f"compaction of {self.describe()}: the name", "give a string")
        if not self.ready_for_compaction:
            raise SolariError(f"compaction of {self.describe()}, which isn't ready: call prepare_compaction and wait")
        assert self._preparation is not None
        # The copy shares what describes the geometry, and gets storage, handle and address of its own.
        compacted = copy.copy(self)
        compacted.name = name or f"{self.name} compacted"
        compacted.compacted = True
        compacted._preparation = None
        compacted.create(self._preparation.size)
        copy_compacted(self.device, [(self.handle, compacted.handle)])
        return compacted

    def move_to(self, size: int) -> Callable[[], None]:
        """Replace the storage by one of this size, for a compacted copy; returns a function that frees the old one."""
        # The old storage is read by the compacting copy, so the caller frees it after that is submitted.
        storage = self._storage
        token = self._token
        self.create(size)
        self.compacted = True

        def free() -> None:
            self.device.release(token)
            storage.destroy()

        return free

    def _drop_preparation(self) -> None:
        if self._preparation is not None:
            self._preparation.cancel()
            self._preparation = None

    def destroy(self) -> None:
        """Destroy it when the work submitted so far is done. Safe to call twice."""
        self._drop_preparation()
        super().destroy()
