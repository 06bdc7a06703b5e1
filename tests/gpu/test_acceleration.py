"""Acceleration structures: batches, scratch, compaction, refits and refused mistakes.

That rays hit what was built, in all formats and however it was built, is proved by the conformance suite.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from support.frames import leaves_nothing

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration import blas_builds, structure
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import AabbGeometry, TriangleGeometry
from solari_vk.gpu.acceleration.structure import UpdateMode
from solari_vk.gpu.acceleration.tlas import Tlas, TlasBuild
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.lab.structures import REFITTED, Placement, Structures, Triangles


@pytest.fixture
def made(device: Device) -> Iterator[Callable[[Any], Any]]:
    """made(resource) destroys a resource after the test, which fails if other objects are left alive."""
    resources: list[Any] = []

    def remember(resource: Any) -> Any:
        resources.append(resource)
        return resource

    with leaves_nothing(device):
        yield remember
        for resource in resources:
            resource.destroy()


def upload(device: Device, made: Callable[[Any], Any], array: np.ndarray, name: str = "data") -> Buffer:
    buffer = made(device.buffer(array.nbytes, name))
    buffer.upload(array)
    return buffer


def quad(x: float, y: float, z: float, size: float = 1.0) -> np.ndarray:
    """Two triangles without indices, facing +z, from (x, y) to (x + size, y + size)."""
    a = (x, y, z)
    b = (x + size, y, z)
    c = (x + size, y + size, z)
    d = (x, y + size, z)
    return np.array([a, b, c, a, c, d], np.float32)


def quad_geometry(device: Device, made: Callable[[Any], Any], *corner: float, **options: Any) -> TriangleGeometry:
    return TriangleGeometry(upload(device, made, quad(*corner)).address, 6, 2, **options)


def test_compaction_gives_memory_back(device, made, monkeypatch):
    """That rays hit the same: the conformance suite."""
    geometry = quad_geometry(device, made, 0.0, 0.0, 0.0)
    tight, plain = (
        made(Blas(device, [geometry], name=name, allow_compaction=name == "tight")) for name in ("tight", "plain")
    )
    # Lavapipe 25.0 reports the storage size as the compacted size, so the test makes the two differ.
    needed, wasteful = tight.size, tight.size + 100_000
    tight.create(wasteful)
    get_results = device.vk.vkGetQueryPoolResults

    def report(handle: Any, pool: Any, first: int, count: int, size: int, target: Any, *rest: int) -> None:
        get_results(handle, pool, first, count, size, target, *rest)
        np.frombuffer(raw.ffi.buffer(target), np.uint64)[:] = needed

    monkeypatch.setattr(device.vk, "vkGetQueryPoolResults", report)
    before = device.memory.bytes_used
    build_blases(device, [tight, plain], compact=True)
    assert (tight.compacted, plain.compacted) == (True, False)
    assert tight.size == needed
    device.wait_idle()
    assert device.memory.bytes_used <= before + plain.size - 90_000
    with pytest.raises(SolariError, match="Blas tight, which was compacted"):
        build_blases(device, [tight])


def test_batches_stay_within_the_scratch_budget(device, made, monkeypatch):
    small = [made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)])) for _ in range(40)]
    large = made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)]))
    budget = 10 * blas_builds.scratch_size(device, small[0], False)
    large.build_scratch_size = 2 * budget  # lavapipe reports the same scratch size for all
    batches: list[int] = []
    make_scratch = blas_builds.make_scratch

    def note(device: Device, size: int, name: str) -> Any:
        batches.append(size)
        return make_scratch(device, size, name)

    monkeypatch.setattr(blas_builds, "make_scratch", note)
    blases = [*small[:20], large, *small[20:]]
    build_blases(device, blases, scratch_budget=budget, compact=False)
    assert batches == [budget, budget, 2 * budget, budget, budget]
    build_blases(device, blases, compact=False)
    build_blases(device, [])
    assert len(batches) == 6


def test_scratch_is_aligned(device: Device, made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(structure, "_alignment", lambda _: 4096)
    blases = [made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)])) for _ in range(5)]
    seen: list[int] = []
    build_info = Blas.build_info

    def note(self: Blas, scratch: int = 0, **options: Any) -> raw.CData:
        seen.append(scratch)
        return build_info(self, scratch, **options)

    monkeypatch.setattr(Blas, "build_info", note)
    build_blases(device, blases)
    assert len(set(seen)) == 5
    assert all(address % 4096 == 0 for address in seen)


def test_refitted_worlds_are_refitted_in_place(device, made, monkeypatch):
    """Builds are refits when they should be. The conformance suite compares the hits of refitted structures."""
    builds: list[tuple[str, int, bool]] = []
    record_build = device.vk.vkCmdBuildAccelerationStructuresKHR

    def note(cmd: Any, count: int, infos: Any, ranges: Any) -> None:
        info = infos[0]
        builds.append((info.type, info.mode, info.srcAccelerationStructure == info.dstAccelerationStructure))
        record_build(cmd, count, infos, ranges)

    monkeypatch.setattr(device.vk, "vkCmdBuildAccelerationStructuresKHR", note)
    with Structures(device, {"quad": [Triangles(quad(0, 0, 0).reshape(2, 3, 3))]}, [Placement("quad")], REFITTED):
        top, bottom = (
            raw.VK_ACCELERATION_STRUCTURE_TYPE_TOP_LEVEL_KHR,
            raw.VK_ACCELERATION_STRUCTURE_TYPE_BOTTOM_LEVEL_KHR,
        )
        assert builds == [(bottom, 0, False), (top, 0, False), (bottom, 1, True), (top, 1, True)]
    device.wait_idle()


def test_a_build_made_again_counts_when_it_is_submitted(device: Device, made: Any) -> None:
    tlas = made(Tlas(device, 1))
    build = made(TlasBuild(tlas, 0, 0))
    with pytest.raises(SolariError, match="never built"):
        tlas.check_usable()
    for count in (1, 2):
        build.submit()
        tlas.check_usable()
        assert tlas.build_count == count
    device.wait_idle()


def test_mistakes_are_refused_before_vulkan_sees_them(device: Device, made: Any) -> None:
    good = quad_geometry(device, made, 0.0, 0.0, 0.0)
    box = AabbGeometry(upload(device, made, np.zeros(6, np.float32)).address, 1)
    wrong: list[tuple[str, list[Any]]] = [
        (r"0 geometries", []),
        (r"triangles and boxes", [good, box]),
        (r"geometry 1: positions is .* not a multiple of 4", [good, TriangleGeometry(good.positions + 2, 6, 2)]),
        (r"geometry 0: position_stride", [TriangleGeometry(good.positions, 6, 2, position_stride=13)]),
        (r"geometry 0: transform", [TriangleGeometry(good.positions, 6, 2, transform=good.positions + 4)]),
        (r"geometry 0: indices", [TriangleGeometry(good.positions, 6, 2, indices=good.positions + 2)]),
        (r"geometry 0: index_dtype", [TriangleGeometry(good.positions, 6, 2, index_dtype=np.uint8)]),
        (r"geometry 0: stride", [AabbGeometry(box.boxes, 1, stride=28)]),
        (r"need 9 positions, not 6", [TriangleGeometry(good.positions, 6, 3)]),
        (r"geometry 0: .* must not be negative", [TriangleGeometry(good.positions, 6, -1)]),
        (r"primitives; this device takes", [TriangleGeometry(good.positions, 6, 1 << 30, indices=good.positions)]),
    ]
    for message, geometries in wrong:
        with pytest.raises(SolariError, match=rf"Blas wrong.*{message}"):
            Blas(device, geometries, name="wrong")
    blas = made(Blas(device, [good], name="fixed"))
    with pytest.raises(SolariError, match="refit of Blas fixed: it was made without UpdateMode"):
        build_blases(device, [blas], update=True)
    flexible = made(Blas(device, [good], name="flexible", update_mode=UpdateMode.PREFER_UPDATE))
    with pytest.raises(SolariError, match="refit of Blas flexible: it was never built"):
        build_blases(device, [flexible], update=True)
    with pytest.raises(SolariError, match="twice"):
        build_blases(device, [blas, blas])
    blas.destroy()
    with pytest.raises(SolariError, match="build of Blas fixed, which was destroyed"):
        build_blases(device, [blas])


def test_tlas_mistakes_are_refused(device: Device, made: Any) -> None:
    limit = device.properties.acceleration.maxInstanceCount
    for count in (-1, limit + 1):
        with pytest.raises(SolariError, match=f"Tlas many of {count:,} instances"):
            Tlas(device, count, name="many")
    tlas = made(Tlas(device, 4, name="four", update_mode=UpdateMode.PREFER_UPDATE))
    for message, address, count, update in (
        ("5 instances, but it was made for 4", 64, 5, False),
        ("-1 instances", 64, -1, False),
        ("is not a multiple of 16", 8, 1, False),
        ("is not a multiple of 16", 0, 1, False),
        ("it was never built", 64, 1, True),
    ):
        with pytest.raises(SolariError, match=f"of Tlas four: .*{message}"):
            tlas.record_build(raw.NULL, address, count, update=update)
    device.run(lambda cmd: tlas.record_build(cmd, 0, 0))
    with pytest.raises(SolariError, match="refit of Tlas four: 1 instances, but it was built with 0"):
        tlas.record_build(raw.NULL, 64, 1, update=True)
    tlas.destroy()
    with pytest.raises(SolariError, match="build of Tlas four, which was destroyed"):
        tlas.record_build(raw.NULL, 0, 0)
