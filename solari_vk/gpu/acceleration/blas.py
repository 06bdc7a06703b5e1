"""Bottom-level acceleration structures: built over geometry, refitted, compacted."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

from solari_vk.errors import SolariError
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
from solari_vk.gpu.acceleration.structure import Structure, build_flags
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device


class Blas(Structure):
    """A bottom-level structure over one or more geometries of one kind. It has an address once built.

    `size` is its storage in bytes, `built_size` what it was before compaction. The memory that geometries
    point to is needed while it builds, not later. Raises SolariError for geometry that can't be built.
    """

    def __init__(
        self,
        device: Device,
        geometries: Sequence[Geometry],
        *,
        prefer_fast_trace: bool = True,
        low_memory: bool = False,
        allow_update: bool = False,
        allow_compaction: bool = True,
        name: str = "blas",
    ) -> None:
        self.geometries = tuple(geometries)
        self.compacted = False
        check_switch(allow_compaction, f"Blas {name}: allow_compaction")
        check_geometries(device, self.geometries, name)
        flags = build_flags(device, prefer_fast_trace, low_memory, allow_update)
        flags |= raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR * allow_compaction
        super().__init__(
            device,
            raw.VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
            flags,
            [geometry_struct(geometry) for geometry in self.geometries],
            [geometry.primitive_count for geometry in self.geometries],
            name,
        )
        self.built_size = self.size
        self.made_for = self.geometries
        self._built_from: tuple[Geometry, ...] = ()
        self._preparation: Preparation | None = None
        self.ranges = build_ranges(self.geometries)

    @property
    def allow_compaction(self) -> bool:
        """Whether it can be compacted."""
        return bool(self.flags & raw.VK_BUILD_ACCELERATION_STRUCTURE_ALLOW_COMPACTION_BIT_KHR)

    # ---- building -----------------------------------------------------------------------------------

    def set_geometries(self, geometries: Sequence[Geometry]) -> None:
        """What the next build takes: like those it was made for, with as many vertices and primitives at most.

        Raises SolariError where they differ.
        """
        check_geometries(self.device, geometries, self.name)
        check_fit(self.made_for, geometries, self.describe())
        self.geometries = tuple(geometries)
        self._geometries = raw.array("VkAccelerationStructureGeometryKHR", list(map(geometry_struct, geometries)))
        self.ranges = build_ranges(geometries)

    @property
    def refits(self) -> bool:
        """Whether a build call would refit it now: it is to, and only positions differ from what it was built from."""
        return self.prefers_update and refit_keys(self.geometries) == refit_keys(self._built_from)

    def ensure_storage(self) -> None:
        """Make storage before the first build. Raises SolariError when it was destroyed."""
        self.check_alive("build")
        if self.handle is None:
            self.create(self.size)

    def note_build(self, at: int, *, update: bool = False) -> None:
        """Remember a build; a compaction that was being prepared is over."""
        super().note_build(at, update=update)
        self._built_from = self.geometries
        self._drop_preparation()

    # ---- compaction ---------------------------------------------------------------------------------

    def prepare_compaction(self, callback: Callable[[], None] | None = None) -> None:
        """Find out, once all builds submitted so far are done, how small it can be; then it is `ready_for_compaction`.

        The callback is called then, at the end of the next `wait`, `wait_idle` or `poll` of the device, where what it
        raises comes out as a CallbackError. Building or destroying it before that ends the preparation, and the
        callback is never called. Raises SolariError for a structure that was not built, was made without
        allow_compaction, or is compacted.
        """
        self.check_alive("compaction")
        if callback is not None and not callable(callback):
            raise SolariError(f"compaction of {self.describe()}: the callback is {show(callback)}: give a function")
        if not self.built or self.compacted or not self.allow_compaction:
            why = "it was made without allow_compaction" if not self.allow_compaction else "it was never built"
            raise SolariError(f"compaction of {self.describe()}: {'it is compacted' if self.compacted else why}")
        self._drop_preparation()
        self._preparation = Preparation(self.device, self.handle, self.describe(), callback)
        self._preparation.start()

    @property
    def ready_for_compaction(self) -> bool:
        """Whether `compact` may be called now. Asking calls no callback."""
        return self._preparation is not None and self._preparation.ready

    def compact(self, name: str = "") -> Blas:
        """A new structure of just the size that this one's content needs, independent of this one.

        It can be neither built nor compacted again. Raises SolariError when not `ready_for_compaction`.
        """
        self.check_alive("compaction")
        check_kind(name, str, f"compaction of {self.describe()}: the name", "give a string")
        if not self.ready_for_compaction:
            raise SolariError(f"compaction of {self.describe()}, which isn't ready: call prepare_compaction and wait")
        assert self._preparation is not None
        compacted = copy.copy(self)
        compacted.name = name or f"{self.name} compacted"
        compacted.compacted = True
        compacted._preparation = None
        compacted.create(self._preparation.size)
        copy_compacted(self.device, [(self.handle, compacted.handle)])
        return compacted

    def move_to(self, size: int) -> Callable[[], None]:
        """New storage of that size for a compacted copy; returns what frees the old one."""
        storage, token = self._storage, self._token
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
