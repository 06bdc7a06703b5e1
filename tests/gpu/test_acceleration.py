"""Acceleration structures: built, batched, compacted, refitted and traced against closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from tracing import GENERATED, NONE, TRIANGLE, Tracer

from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration import blas_builds, structure
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import AabbGeometry, TriangleGeometry
from solari_vk.gpu.acceleration.tlas import INSTANCE_DTYPE, Tlas, TlasBuild
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def acceleration_device(any_device: None) -> Iterator[Device]:
    with Device(validation=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def tracer(acceleration_device: Device) -> Tracer:
    return Tracer(acceleration_device)


@pytest.fixture
def made(acceleration_device: Device) -> Iterator[Callable[[Any], Any]]:
    """Remembers resources, destroys them after the test, and checks that nothing else was left alive."""
    device = acceleration_device
    device.wait_idle()
    before = device.live_objects
    resources: list[Any] = []

    def remember(resource: Any) -> Any:
        resources.append(resource)
        return resource

    yield remember
    for resource in resources:
        resource.destroy()
    device.wait_idle()
    # Staging chunks that stay in their pool are no leak.
    assert device.live_objects - before <= 4


def upload(device: Device, made: Callable[[Any], Any], array: np.ndarray, name: str = "data") -> Buffer:
    buffer = made(device.buffer(array.nbytes, name))
    buffer.upload(array)
    return buffer


def quad(x: float, y: float, z: float, size: float = 1.0) -> np.ndarray:
    """Two triangles without indices, facing +z, from (x, y) to (x + size, y + size)."""
    a, b, c, d = ((x, y, z), (x + size, y, z), (x + size, y + size, z), (x, y + size, z))
    return np.array([a, b, c, a, c, d], np.float32)


def quad_geometry(device: Device, made: Callable[[Any], Any], *corner: float, **options: Any) -> TriangleGeometry:
    return TriangleGeometry(upload(device, made, quad(*corner)).address, 6, 2, **options)


def instances(blases: Sequence[Blas], transforms: np.ndarray | None = None, mask: int = 0xFF) -> np.ndarray:
    records = np.zeros(len(blases), INSTANCE_DTYPE)
    records["transform"] = np.eye(4, dtype=np.float32)[:3] if transforms is None else transforms
    records["custom_index_and_mask"] = np.arange(len(blases)) * 3 + 1 | mask << 24
    records["blas_address"] = [blas.address for blas in blases]
    return records


def translations(offsets: np.ndarray) -> np.ndarray:
    matrices = np.tile(np.eye(4, dtype=np.float32)[:3], (len(offsets), 1, 1))
    matrices[:, :, 3] = offsets
    return matrices


def build_tlas(device: Device, made: Callable[[Any], Any], records: np.ndarray, **options: Any) -> Tlas:
    tlas = made(Tlas(device, len(records), name="test", **options))
    address = upload(device, made, records, "instances").address if len(records) else 0
    device.run(lambda cmd: tlas.record_build(cmd, address, len(records)))
    return tlas


def test_geometries_indices_strides_and_transforms(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    strided = np.full((4, 7), np.nan, np.float32)
    strided[:, :3] = corners + np.array([2, 0, 0], np.float32)
    matrix = np.array([[1, 0, 0, 6], [0, 1, 0, 0], [0, 0, 1, -0.5]], np.float32)
    index = np.array([0, 1, 2, 0, 2, 3])
    plain = upload(device, made, corners)
    geometries = [
        quad_geometry(device, made, 0.0, 0.0, 0.0),
        TriangleGeometry(
            upload(device, made, strided).address,
            4,
            2,
            indices=upload(device, made, index.astype(np.uint16)).address,
            index_dtype=np.uint16,
            position_stride=28,
        ),
        TriangleGeometry(
            upload(device, made, corners + np.array([4, 0, 0], np.float32)).address,
            4,
            1,
            indices=upload(device, made, index.astype(np.uint32)).address + 12,
        ),
        TriangleGeometry(
            plain.address,
            4,
            2,
            indices=upload(device, made, index.astype(np.uint32)).address,
            transform=upload(device, made, matrix).address,
        ),
    ]
    blas = made(Blas(device, geometries))
    build_blases(device, [blas])
    tlas = build_tlas(device, made, instances([blas]))
    origins = np.array([[0.75, 0.25, 1], [2.75, 0.25, 1], [4.25, 0.75, 1], [6.25, 0.75, 1], [8, 8, 1]])
    hits = tracer.trace(tlas, origins, DOWN)
    assert hits["kind"].tolist() == [TRIANGLE] * 4 + [NONE]
    assert hits["geometry"][:4].tolist() == [0, 1, 2, 3]
    assert hits["primitive"][:4].tolist() == [0, 0, 0, 1]
    assert hits["t"][:4] == pytest.approx([1, 1, 1, 1.5])
    assert (hits["custom_index"][:4] == 1).all()
    # Barycentrics of (0.75, 0.25) in triangle (0,0) (1,0) (1,1): u = 0.5, v = 0.25.
    assert hits["barycentrics"][1] == pytest.approx([0.5, 0.25], abs=1e-6)


def test_instances_transforms_masks_and_indices(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    blas = made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)]))
    build_blases(device, [blas])
    offsets = np.array([[2.0 * i, 0, 0.1 * i] for i in range(100)])
    records = instances([blas] * 100, translations(offsets))
    records["custom_index_and_mask"][7] &= 0xFFFFFF  # mask 0: never hit
    records["blas_address"][8] = 0  # inactive
    records["custom_index_and_mask"][9] |= 0xFFFFFF
    tlas = build_tlas(device, made, records)
    hits = tracer.trace(tlas, offsets + np.array([0.5, 0.25, 10.0]), DOWN)
    expected = np.full(100, TRIANGLE)
    expected[[7, 8]] = NONE
    assert np.array_equal(hits["kind"], expected)
    there = expected == TRIANGLE
    assert np.array_equal(hits["instance"][there], np.arange(100)[there])
    assert hits["custom_index"][9] == 0xFFFFFF
    assert np.array_equal(hits["custom_index"][10:], np.arange(10, 100) * 3 + 1)
    assert hits["t"][there] == pytest.approx(10, rel=1e-5)


def test_opaque_flag_and_ray_flags(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    blases = [
        made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0, opaque=opaque)])) for opaque in (True, False)
    ]
    build_blases(device, blases)
    tlas = build_tlas(device, made, instances(blases, translations(np.array([[0, 0, 0], [2, 0, 0]]))))
    origins = np.array([[0.5, 0.25, 1], [2.5, 0.25, 1]])
    cull_opaque, cull_no_opaque = 0x40, 0x80
    assert tracer.trace(tlas, origins, DOWN)["kind"].tolist() == [TRIANGLE, TRIANGLE]
    assert tracer.trace(tlas, origins, DOWN, flags=cull_opaque)["kind"].tolist() == [NONE, TRIANGLE]
    assert tracer.trace(tlas, origins, DOWN, flags=cull_no_opaque)["kind"].tolist() == [TRIANGLE, NONE]


def test_boxes(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    boxes = np.zeros((3, 8), np.float32)  # a stride of 32 bytes
    boxes[:, :6] = [[i * 2, 0, 0, i * 2 + 1, 1, 1] for i in range(3)]
    blas = made(Blas(device, [AabbGeometry(upload(device, made, boxes).address, 3, stride=32)]))
    build_blases(device, [blas])
    tlas = build_tlas(device, made, instances([blas]))
    origins = np.array([[0.5, 0.5, 2], [2.5, 0.5, 2], [4.5, 0.5, 2], [1.5, 0.5, 2]])
    hits = tracer.trace(tlas, origins, DOWN)
    assert hits["kind"].tolist() == [GENERATED] * 3 + [NONE]
    assert hits["primitive"][:3].tolist() == [0, 1, 2]


def grid(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and triangles of a wavy square of 2 * cells^2 triangles over [0, 1]^2."""
    side = np.linspace(0, 1, cells + 1)
    x, y = (part.ravel() for part in np.meshgrid(side, side))
    positions = np.stack([x, y, 0.1 * np.sin(9 * x) * np.cos(7 * y)], -1).astype(np.float32)
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    below = first + cells + 1
    triangles = np.concatenate([np.stack([first, first + 1, below], -1), np.stack([first + 1, below + 1, below], -1)])
    return positions, triangles.astype(np.uint32)


def grid_geometry(device: Device, made: Any, cells: int) -> TriangleGeometry:
    positions, triangles = grid(cells)
    return TriangleGeometry(
        upload(device, made, positions).address,
        len(positions),
        len(triangles),
        indices=upload(device, made, triangles).address,
    )


def test_compaction_shrinks_and_changes_no_hit(
    acceleration_device: Device, tracer: Tracer, made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = acceleration_device
    geometry = grid_geometry(device, made, 40)
    loose, tight = made(Blas(device, [geometry], name="loose")), made(Blas(device, [geometry], name="tight"))
    # Lavapipe reports the storage's size as the compacted one, so storage and report are made to differ here.
    needed, wasteful = tight.size, tight.size + 100_000
    tight.create(wasteful)
    get_results = device.vk.vkGetQueryPoolResults

    def report(handle: Any, pool: Any, first: int, count: int, size: int, target: Any, *rest: int) -> None:
        get_results(handle, pool, first, count, size, target, *rest)
        sizes = np.frombuffer(raw.ffi.buffer(target), np.uint64)
        assert sizes.tolist() in ([wasteful], [needed])
        sizes[:] = needed

    monkeypatch.setattr(device.vk, "vkGetQueryPoolResults", report)
    build_blases(device, [loose], compact=False)
    before = device.memory.bytes_used
    build_blases(device, [tight], compact=True)
    assert not loose.compacted
    assert tight.compacted
    assert loose.size == loose.built_size
    assert tight.size == needed
    assert tight.handle is not None
    device.wait_idle()
    assert device.memory.bytes_used <= before - 90_000
    rng = np.random.default_rng(4)
    origins = np.concatenate([rng.random((2000, 2)), np.full((2000, 1), 3.0)], 1)
    hits = [tracer.trace(build_tlas(device, made, instances([blas])), origins, DOWN) for blas in (loose, tight)]
    assert (hits[0]["kind"] == TRIANGLE).all()
    assert np.array_equal(hits[0], hits[1])
    heights = 0.1 * np.sin(9 * origins[:, 0]) * np.cos(7 * origins[:, 1])
    assert np.abs(3.0 - hits[1]["t"] - heights).max() < 2e-3
    with pytest.raises(SolariError, match="Blas tight, which was compacted"):
        build_blases(device, [tight])


def test_driver_sizes_before_and_after_compaction(acceleration_device: Device, made: Any) -> None:
    device = acceleration_device
    blases = [made(Blas(device, [grid_geometry(device, made, n)])) for n in (4, 16, 64)]
    built = [blas.built_size for blas in blases]
    build_blases(device, blases)
    assert all(0 < blas.size <= size for blas, size in zip(blases, built, strict=True))
    assert sorted(built) == built
    plain = made(Blas(device, [grid_geometry(device, made, 4)], allow_compaction=False))
    build_blases(device, [plain])
    assert not plain.compacted


def test_a_thousand_small_structures_in_batches(
    acceleration_device: Device, tracer: Tracer, made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = acceleration_device
    count = 1000
    corners = np.concatenate([quad(2.0 * i, 0, 0.01 * i) for i in range(count)])
    positions = upload(device, made, corners)
    blases = [
        made(Blas(device, [TriangleGeometry(positions.address + 72 * i, 6, 2)], name=f"small {i}"))
        for i in range(count)
    ]
    budget = 50 * blas_builds.scratch_size(device, blases[0], False)
    scratch_sizes: list[int] = []
    make_scratch = blas_builds.make_scratch

    def note(device: Device, size: int, name: str) -> Any:
        scratch_sizes.append(size)
        return make_scratch(device, size, name)

    monkeypatch.setattr(blas_builds, "make_scratch", note)
    build_blases(device, blases, scratch_budget=budget)
    assert len(scratch_sizes) >= count // 50
    assert max(scratch_sizes) <= budget
    assert device.memory.allocation_count < 20
    tlas = build_tlas(device, made, instances(blases))
    origins = np.array([[2 * i + 0.5, 0.25, 100.0] for i in range(count)])
    hits = tracer.trace(tlas, origins, DOWN)
    assert np.array_equal(hits["instance"], np.arange(count))
    assert hits["t"] == pytest.approx(100 - 0.01 * np.arange(count), rel=1e-5)


def test_one_structure_above_the_budget_is_built_alone(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    blases = [made(Blas(device, [grid_geometry(device, made, n)])) for n in (2, 30, 2)]
    builds = [blas_builds.BlasBuild(blas) for blas in blases]
    assert [len(batch) for batch in blas_builds.batches(builds, 1)] == [1, 1, 1]
    assert [len(batch) for batch in blas_builds.batches(builds, 1 << 30)] == [3]
    build_blases(device, blases, scratch_budget=1)
    tlas = build_tlas(device, made, instances(blases, translations(np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0]]))))
    hits = tracer.trace(tlas, np.array([[0.4, 0.4, 1], [2.4, 0.4, 1], [4.4, 0.4, 1]]), DOWN)
    assert hits["instance"].tolist() == [0, 1, 2]
    assert (hits["kind"] == TRIANGLE).all()


def test_scratch_is_aligned(acceleration_device: Device, made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    device = acceleration_device
    monkeypatch.setattr(structure, "_alignment", lambda _: 4096)
    blases = [made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)])) for _ in range(5)]
    seen: list[int] = []
    build_info = Blas.build_info

    def note(self: Blas, scratch: int = 0, *, update: bool = False) -> raw.CData:
        seen.append(scratch)
        return build_info(self, scratch, update=update)

    monkeypatch.setattr(Blas, "build_info", note)
    build_blases(device, blases)
    assert len(set(seen)) == 5
    assert all(address % 4096 == 0 for address in seen)


def test_empty_structures(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    nothing = build_tlas(device, made, instances([]))
    assert tracer.trace(nothing, np.zeros((5, 3)), DOWN)["kind"].tolist() == [NONE] * 5
    data = upload(device, made, quad(0, 0, 0))
    empty = made(Blas(device, [TriangleGeometry(data.address, 6, 0)]))
    build_blases(device, [empty])
    assert empty.address
    tlas = build_tlas(device, made, instances([empty]))
    assert tracer.trace(tlas, np.array([[0.5, 0.25, 1]]), DOWN)["kind"].tolist() == [NONE]
    build_blases(device, [])


def test_tlas_shrinks_to_nothing_and_grows_again(acceleration_device: Device, tracer: Tracer, made: Any) -> None:
    device = acceleration_device
    blas = made(Blas(device, [quad_geometry(device, made, 0.0, 0.0, 0.0)]))
    build_blases(device, [blas])
    records = upload(device, made, instances([blas] * 10, translations(np.array([[2 * i, 0, 0] for i in range(10)]))))
    tlas = made(Tlas(device, 10))
    origins = np.array([[2 * i + 0.5, 0.25, 1] for i in range(10)])
    for count in (10, 0, 3, 10):
        device.run(lambda cmd, count=count: tlas.record_build(cmd, records.address, count))
        hits = tracer.trace(tlas, origins, DOWN)
        assert np.array_equal(hits["kind"] == TRIANGLE, np.arange(10) < count)


def test_refit_equals_rebuild(
    acceleration_device: Device, tracer: Tracer, made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = acceleration_device
    modes: list[tuple[int, bool]] = []
    record_build = device.vk.vkCmdBuildAccelerationStructuresKHR

    def note(cmd: Any, count: int, infos: Any, ranges: Any) -> None:
        info = infos[0]
        modes.append((info.mode, info.srcAccelerationStructure == info.dstAccelerationStructure))
        record_build(cmd, count, infos, ranges)

    monkeypatch.setattr(device.vk, "vkCmdBuildAccelerationStructuresKHR", note)
    positions, triangles = grid(20)
    data = upload(device, made, positions)
    geometry = TriangleGeometry(
        data.address, len(positions), len(triangles), indices=upload(device, made, triangles).address
    )
    refitted = made(Blas(device, [geometry], allow_update=True))
    build_blases(device, [refitted], compact=False)
    positions[:, 2] += 0.3 * positions[:, 0]
    data.upload(positions)
    build_blases(device, [refitted], update=True)
    assert modes == [(0, False), (1, True)]
    rebuilt = made(Blas(device, [geometry]))
    build_blases(device, [rebuilt])
    rng = np.random.default_rng(9)
    origins = np.concatenate([rng.random((1000, 2)), np.full((1000, 1), 3.0)], 1)
    hits = [tracer.trace(build_tlas(device, made, instances([blas])), origins, DOWN) for blas in (refitted, rebuilt)]
    assert (hits[0]["kind"] == TRIANGLE).all()
    assert np.array_equal(hits[0]["primitive"], hits[1]["primitive"])
    assert np.array_equal(hits[0]["t"], hits[1]["t"])
    records = instances([rebuilt])
    tlas = made(Tlas(device, 1, allow_update=True))
    buffer = upload(device, made, records)
    device.run(lambda cmd: tlas.record_build(cmd, buffer.address, 1))
    records["transform"][0, :, 3] = [5, 0, 1]
    buffer.upload(records)
    device.run(lambda cmd: tlas.record_build(cmd, buffer.address, 1, update=True))
    assert modes[-2:] == [(0, False), (1, True)]
    moved = tracer.trace(tlas, origins + np.array([5, 0, 1]), DOWN)
    assert np.array_equal(moved["primitive"], hits[1]["primitive"])
    assert (tracer.trace(tlas, origins, DOWN)["kind"] == NONE).all()


def test_a_build_made_again_counts_when_it_is_submitted(acceleration_device: Device, made: Any) -> None:
    tlas = made(Tlas(acceleration_device, 1))
    build = made(TlasBuild(tlas, 0, 0))
    with pytest.raises(SolariError, match="never built"):
        tlas.check_usable()
    for count in (1, 2):
        build.submit()
        tlas.check_usable()
        assert tlas.build_count == count
    acceleration_device.wait_idle()


def test_repeated_builds_leave_nothing_behind(acceleration_device: Device, made: Any) -> None:
    device = acceleration_device
    geometry = quad_geometry(device, made, 0.0, 0.0, 0.0)
    counts = []
    for _ in range(6):
        for _ in range(20):
            blas, tlas = Blas(device, [geometry]), Tlas(device, 3)
            build_blases(device, [blas])
            device.start(lambda cmd, tlas=tlas: tlas.record_build(cmd, 0, 0))
            blas.destroy()
            tlas.destroy()
            tlas.destroy()
        device.wait_idle()
        counts.append((device.live_objects, device.memory.bytes_used, device.memory.allocation_count))
    assert len(set(counts)) == 1


def test_mistakes_are_refused_before_vulkan_sees_them(acceleration_device: Device, made: Any) -> None:
    device = acceleration_device
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
        (r"geometry 0: -1 primitives", [TriangleGeometry(good.positions, 6, -1)]),
        (r"primitives; this device takes", [TriangleGeometry(good.positions, 6, 1 << 30, indices=good.positions)]),
    ]
    for message, geometries in wrong:
        with pytest.raises(SolariError, match=rf"Blas wrong.*{message}"):
            Blas(device, geometries, name="wrong")
    blas = made(Blas(device, [good], name="fixed"))
    with pytest.raises(SolariError, match="refit of Blas fixed: it was made without allow_update"):
        build_blases(device, [blas], update=True)
    flexible = made(Blas(device, [good], name="flexible", allow_update=True))
    with pytest.raises(SolariError, match="refit of Blas flexible: it was never built"):
        build_blases(device, [flexible], update=True)
    with pytest.raises(SolariError, match="twice"):
        build_blases(device, [blas, blas])
    blas.destroy()
    with pytest.raises(SolariError, match="build of Blas fixed, which was destroyed"):
        build_blases(device, [blas])


def test_tlas_mistakes_are_refused(acceleration_device: Device, made: Any) -> None:
    device = acceleration_device
    limit = device.properties.acceleration.maxInstanceCount
    for count in (-1, limit + 1):
        with pytest.raises(SolariError, match=f"Tlas many of {count:,} instances"):
            Tlas(device, count, name="many")
    tlas = made(Tlas(device, 4, name="four", allow_update=True))
    cases: list[tuple[str, tuple[int, int], bool]] = [
        ("5 instances, made for 4", (64, 5), False),
        ("-1 instances", (64, -1), False),
        ("not a 16-byte aligned address", (8, 1), False),
        ("not a 16-byte aligned address", (0, 1), False),
        ("it was never built", (64, 1), True),
    ]
    for message, (address, count), update in cases:
        with pytest.raises(SolariError, match=f"of Tlas four: .*{message}"):
            tlas.record_build(raw.NULL, address, count, update=update)
    device.run(lambda cmd: tlas.record_build(cmd, 0, 0))
    with pytest.raises(SolariError, match="refit of Tlas four: 1 instances, but it was built with 0"):
        tlas.record_build(raw.NULL, 64, 1, update=True)
    tlas.destroy()
    with pytest.raises(SolariError, match="build of Tlas four, which was destroyed"):
        tlas.record_build(raw.NULL, 0, 0)
