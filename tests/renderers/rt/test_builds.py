"""Build calls: rays hit what was built, and structures are refitted or rebuilt as requested."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import ABOVE_QUAD, quad_corners, translation

from solari_vk import rt
from solari_vk.gpu.acceleration.structure import UpdateMode
from solari_vk.gpu.device import raw

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)


def top_of(world, geometries, **instance):
    """A Tlas over one Blas, built."""
    blas, tlas = world.blas(geometries), world.tlas(1)
    world.build([rt.BlasBuildEntry(blas, geometries)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas, **instance)])])
    return tlas


def test_several_geometries_of_every_format(world):
    index = np.array([[0, 1, 2], [0, 2, 3]])
    strided = np.full((4, 7), np.nan, np.float32)
    strided[:, :3] = CORNERS + np.array([6, 0, 0])
    up = rt.BufferSlice(world.buffer(translation(0, 0, 1)), 1)
    geometries = [
        rt.Triangles(quad_corners()),
        rt.Triangles(CORNERS + np.array([2, 0, 0]), index.astype(np.uint16)),
        rt.Triangles(CORNERS, index.astype(np.uint32), transform=translation(4, 0, -0.5)),
        rt.Triangles(
            rt.BufferSlice(world.buffer(strided), 4, stride=28),
            rt.BufferSlice(world.buffer([9, *index.ravel()], np.uint16), 6, offset=2),
            index_dtype=np.uint16,
        ),
        rt.Triangles(rt.BufferSlice(world.buffer(quad_corners(8)), 6), transform=up),
    ]
    hits = world.trace(top_of(world, geometries, custom_data=0xFFFFFF), [[2 * i + 0.6, 0.3, 5] for i in range(6)])
    assert hits["t"] == pytest.approx([5, 5, 5.5, 5, 4, -1])
    assert hits["geometry"][:5].tolist() == [0, 1, 2, 3, 4]
    assert (hits["custom_data"][:5] == 0xFFFFFF).all()


def test_geometry_flags(world):
    geometries = [
        rt.Triangles(quad_corners(), opaque=False),
        rt.Triangles(quad_corners(2), opaque=False, no_duplicate_any_hit=True),
    ]
    tlas = top_of(world, geometries)
    origins = [ABOVE_QUAD, ABOVE_QUAD + np.array([2, 0, 0])]
    assert world.trace(tlas, origins)["t"].tolist() == [5, 5]
    assert world.trace(tlas, origins, flags=rt.RayFlags.CULL_NO_OPAQUE)["t"].tolist() == [-1, -1]


def test_boxes_with_a_stride(world):
    table = np.full((3, 8), 7, np.float32)
    table[:, :6] = [[2 * i, 0, 0, 2 * i + 1, 1, 1] for i in range(3)]
    strided = rt.BufferSlice(world.buffer(table), 3, stride=32)
    geometries = [rt.Aabbs([[20, 0, 0, 21, 1, 1]]), rt.Aabbs(strided, opaque=False)]
    origins = [[x, 0.5, 5] for x in (0.5, 2.5, 4.5, 20.5, 30)]
    hits = world.trace(top_of(world, geometries), origins, box_t=4.5)
    assert hits["t"].tolist() == [4.5] * 4 + [-1]
    assert hits["primitive"][:4].tolist() == [0, 1, 2, 0]
    assert hits["geometry"][:4].tolist() == [1, 1, 1, 0]


def test_instances(world):
    blas, tlas = world.blas(), world.tlas(9)
    world.build([world.entry(blas)])
    items = [
        rt.TlasInstance(blas, translation(2 * i), custom_data=10 * i, mask=1 << i, flags=rt.InstanceFlags.NONE)
        for i in range(7)
    ]
    # None is the last, for Mesa 26.2; tests of docs/driver_faults.md have it before others.
    world.build((), [rt.TlasPackage(tlas, [*items, rt.TlasInstance(blas, translation(16)), None])])
    origins = ABOVE_QUAD + np.array([[2 * i, 0, 0] for i in range(9)])
    hits = world.trace(tlas, origins)
    assert hits["t"].tolist() == [5] * 7 + [-1, 5]
    there = hits["t"] > 0
    assert hits["instance"][there].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert hits["custom_data"][there].tolist() == [0, 10, 20, 30, 40, 50, 60, 0]
    for bit in range(8):  # no instance and no ray has a bit more than it was given
        seen = [bit, 8] if bit < 7 else [8]
        assert np.flatnonzero(world.trace(tlas, origins, cull_mask=1 << bit)["t"] > 0).tolist() == seen


def test_instances_in_arrays_are_the_same(world):
    blas, tops = world.blas(), [world.tlas(50), world.tlas(50)]
    transforms = np.array([translation(2 * i, 0, 0.1 * i) for i in range(50)])
    one_by_one = [rt.TlasInstance(blas, transform, i, 0xF0 | i % 16) for i, transform in enumerate(transforms)]
    arrays = rt.TlasInstances(blas, transforms, np.arange(50), 0xF0 | np.arange(50) % 16)
    world.build([world.entry(blas)], map(rt.TlasPackage, tops, [one_by_one, arrays]))
    hits = [world.trace(top, ABOVE_QUAD + transforms[:, :, 3]) for top in tops]
    assert (hits[0]["t"] > 0).all()
    assert np.array_equal(hits[0], hits[1])


def test_facing_flags_of_instances(world):
    blas, tlas = world.blas(), world.tlas(4)
    flags = rt.InstanceFlags
    kinds = [flags.NONE, flags.FACING_CULL_DISABLE, flags.FLIP_FACING, flags.FORCE_NO_OPAQUE]
    items = [rt.TlasInstance(blas, translation(2 * i), flags=kind) for i, kind in enumerate(kinds)]
    world.build([world.entry(blas)], [rt.TlasPackage(tlas, items)])
    origins = ABOVE_QUAD + np.array([[2 * i, 0, 0] for i in range(4)])
    for ray_flags, seen in (
        (rt.RayFlags.CULL_FRONT_FACING, [False, True, True, False]),
        (rt.RayFlags.CULL_BACK_FACING, [True, True, False, True]),
        (rt.RayFlags.CULL_NO_OPAQUE, [True, True, True, False]),
    ):
        assert (world.trace(tlas, origins, flags=ray_flags)["t"] > 0).tolist() == seen


# ---- refits -----------------------------------------------------------------------------------------


@pytest.fixture
def modes(device, monkeypatch):
    """The modes of all recorded builds: 0 is a build, 1 an update."""
    seen = []
    original = device.vk.vkCmdBuildAccelerationStructuresKHR

    def note(cmd, count, infos, ranges):
        seen.extend(infos[i].mode for i in range(count))
        original(cmd, count, infos, ranges)

    monkeypatch.setattr(device.vk, "vkCmdBuildAccelerationStructuresKHR", note)
    return seen


def test_update_modes_and_the_rebuild_hint(world, modes):
    prefer = UpdateMode.PREFER_UPDATE
    blas = world.blas(update_mode=prefer, rebuild_after=2)
    tlas = world.tlas(update_mode=prefer, rebuild_after=3)
    for i in range(6):
        height = float(i)
        world.build(
            [world.entry(blas, rt.Triangles(quad_corners(0, 0, height)))],
            [rt.TlasPackage(tlas, [rt.TlasInstance(blas, translation(3 * i))])],
        )
        hits = world.trace(tlas, [[3 * i + 0.6, 0.3, 9], [3 * i + 3.6, 0.3, 9]])
        assert hits["t"] == pytest.approx([9 - height, -1])
    assert modes[::2] == [0, 1, 1, 0, 1, 1]
    assert modes[1::2] == [0, 1, 1, 1, 0, 1]
    assert (blas.refit_count, tlas.refit_count) == (2, 1)
    del modes[:]
    plain, tlas = world.blas(), world.tlas()
    for _ in range(3):
        world.build([world.entry(plain)], [rt.TlasPackage(tlas, [rt.TlasInstance(plain)])])
    assert modes == [0] * 6


def test_a_refit_needs_the_same_counts_and_indices(world, modes):
    blas = world.blas([rt.TriangleSize(8, 12)], update_mode=UpdateMode.PREFER_UPDATE)
    tlas = world.tlas(3, update_mode=UpdateMode.PREFER_UPDATE)
    for indices in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]], [[0, 1, 3]]):
        world.build([world.entry(blas, rt.Triangles(CORNERS, indices))])
    assert modes == [0, 1, 0, 0]
    del modes[:]
    other = world.blas()
    world.build([world.entry(other)])
    for blases in ([blas, blas], [blas, blas], [blas, other], [blas]):
        world.build((), [rt.TlasPackage(tlas, [rt.TlasInstance(item) for item in blases])])
    assert modes == [0, 0, 1, 0, 0]


def test_fewer_and_none(world):
    blas = world.blas([rt.TriangleSize(60)])
    tlas = world.tlas(2)
    for count in (10, 1, 0, 10):
        positions = np.concatenate([quad_corners(2 * i) for i in range(10)])[: 6 * count]
        instances = [rt.TlasInstance(blas)] if count else []
        world.build([world.entry(blas, rt.Triangles(positions))], [rt.TlasPackage(tlas, instances)])
        hits = world.trace(tlas, [[2 * i + 0.6, 0.3, 1] for i in range(10)])
        assert np.array_equal(hits["t"] > 0, np.arange(10) < count)


# ---- compaction -------------------------------------------------------------------------------------


def test_compaction_by_callback_and_by_polling(world, device, monkeypatch):
    """The new structure has the size that the device tells, and stays as it is when the old one changes."""
    blas = world.blas(name="quad")
    tlas = world.tlas()
    told = []
    needed = blas.size
    blas.create(needed + 50_000)  # lavapipe never saves anything, so that the storage is enlarged first
    get_results = device.vk.vkGetQueryPoolResults

    def report(handle, pool, first, count, size, target, *rest):
        get_results(handle, pool, first, count, size, target, *rest)
        np.frombuffer(raw.ffi.buffer(target), np.uint64)[:] = needed

    monkeypatch.setattr(device.vk, "vkGetQueryPoolResults", report)
    world.build([world.entry(blas)])
    assert not blas.ready_for_compaction
    blas.prepare_compaction(lambda: told.append("ready"))
    device.wait_idle()
    assert blas.ready_for_compaction
    assert told == ["ready"]
    compacted = world.keep(blas.compact())
    assert (compacted.compacted, blas.compacted) == (True, False)
    assert (compacted.size, compacted.built_size, blas.size) == (needed, needed, needed + 50_000)
    assert repr(blas).count("quad") == repr(blas).count(f"{blas.size:,} bytes") == 1
    world.build([world.entry(blas, rt.Triangles(quad_corners(40)))])
    assert not blas.ready_for_compaction
    blas.destroy()
    world.build((), [rt.TlasPackage(tlas, [rt.TlasInstance(compacted, translation(1))])])
    assert world.trace(tlas, ABOVE_QUAD + np.array([1, 0, 0]))["t"] == pytest.approx([5])


@pytest.mark.parametrize("mode", UpdateMode)
def test_a_rebuild_or_refit_cancels_a_pending_compaction(world, built, monkeypatch, mode):
    blas, _ = built(update_mode=mode)
    told = []
    with monkeypatch.context() as slow:
        slow.setattr(world.device, "collect", lambda: None)  # as if the device were still busy
        blas.prepare_compaction(lambda: told.append("called"))
        assert not blas.ready_for_compaction
        world.build([world.entry(blas)])
    world.device.wait_idle()
    assert not blas.ready_for_compaction
    assert told == []
    blas.prepare_compaction()
    world.device.wait_idle()
    assert blas.ready_for_compaction
    world.build([world.entry(blas)])  # also one that is ready: the size may have changed
    assert not blas.ready_for_compaction
    assert blas.refit_count == 2 * (mode is UpdateMode.PREFER_UPDATE)
