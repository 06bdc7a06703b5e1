"""Invalid calls are refused before Vulkan sees them, with an error that names the object and the rule."""

from __future__ import annotations

import numpy as np
import pytest
from support.structures import quad, shifted

from solari_vk import rt
from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration import instances
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage


def refused(message):
    return pytest.raises(SolariError, match=message)


def top(blas, tlas):
    return [rt.TlasPackage(tlas, [rt.TlasInstance(blas) if blas else None])]


# ---- the order of builds ----------------------------------------------------------------------------


def test_build_over_what_was_never_built(world):
    blas, other, tlas = world.blas(name="bare"), world.blas(), world.tlas(name="top")
    with refused("use of Tlas top, which was never built"):
        world.trace(tlas)
    with refused("build of Tlas top over Blas bare, which was not built"):
        world.build([world.entry(other)], top(blas, tlas))
    assert not other.built  # nothing of the call took place
    world.build([world.entry(blas)], top(blas, tlas))
    assert world.is_hit(tlas)


def test_calls_out_of_order(world):
    blas, tlas = world.blas(name="late"), world.tlas(name="top")
    first = rt.BuildCall(world.device, [world.entry(blas)])
    second = rt.BuildCall(world.device, (), top(blas, tlas))
    with refused("build of Tlas top over Blas late, which was not built"):
        second.submit()
    first.submit()
    second.submit()
    assert world.is_hit(tlas)
    first.submit()
    with refused("use of Tlas top, built over Blas late, which was built again since"):
        world.trace(tlas)
    second.submit()
    assert world.is_hit(tlas)


@pytest.mark.parametrize("mode", rt.UpdateMode)
def test_rebuilt_under_an_old_top(world, built, mode):
    blas, tlas = built(update_mode=mode)
    assert world.is_hit(tlas)
    world.build([world.entry(blas)])
    assert blas.refit_count == (mode == rt.UpdateMode.PREFER_UPDATE)
    with refused("use of Tlas top, built over Blas quad, which was built again since: build the Tlas again"):
        world.trace(tlas)
    world.build([world.entry(blas)], top(blas, tlas))  # in one call
    assert world.is_hit(tlas)


def test_a_frame_checks_every_time(world, built):
    blas, tlas = built()
    stage = Stage("trace", buffers={"rays": 1, "hits": 1}, passes=[Pass("conformance/trace", 1)])
    with Frame(world.device, [stage], external={"tlas": tlas}) as frame:
        for _ in range(3):
            frame.submit()
        world.build([world.entry(blas)])
        with refused("built again since"):
            frame.submit()
        world.build((), top(blas, tlas))
        frame.submit()
        blas.destroy()
        with refused("use of Tlas top, built over Blas quad, which was destroyed"):
            frame.submit()
        tlas.destroy()
        with refused("use of Tlas top, which was destroyed"):
            frame.submit()


# ---- freed objects ----------------------------------------------------------------------------------


def test_freed_structures(world, built):
    blas, tlas = built()
    call = rt.BuildCall(world.device, [world.entry(blas)])
    blas.destroy()
    with refused("use of Tlas top, built over Blas quad, which was destroyed"):
        world.trace(tlas)
    with refused("build of Tlas top over an instance of Blas quad, which was destroyed"):
        world.build((), top(blas, tlas))
    before = world.device.objects_in_use
    for build in (call.submit, lambda: world.build([world.entry(blas)]), blas.ensure_storage):
        with refused("build of Blas quad, which was destroyed"):
            build()
    assert world.device.objects_in_use == before
    world.build((), top(None, tlas))
    assert not world.is_hit(tlas)
    tlas.destroy()
    with refused("build of Tlas top, which was destroyed"):
        world.build((), top(None, tlas))
    with refused("destroyed"):
        world.trace(tlas)


def test_freed_buffers(world):
    buffer = world.buffer(quad())
    blas = world.blas([rt.TriangleSize(6)])
    entry = world.entry(blas, rt.Triangles(rt.BufferSlice(buffer, 6)))
    buffer.destroy()
    with refused("positions: buffer data was destroyed"):
        world.build([entry])
    assert not blas.built


def test_another_device(world, built):
    blas, tlas = built()
    with Device(validation=True) as other:
        foreign = rt.create_blas(other, [rt.TriangleSize(6)], name="foreign")
        rt.build_acceleration_structures(other, [world.entry(foreign)])
        with refused("Blas foreign, which belongs to another device"):
            world.build((), top(foreign, tlas))
        with refused("build of Blas quad, which belongs to another device"):
            rt.build_acceleration_structures(other, [world.entry(blas)])
        with refused("build of Tlas top, which belongs to another device"):
            rt.build_acceleration_structures(other, (), top(None, tlas))
        data = other.buffer(72, "theirs")
        with refused("positions: buffer theirs belongs to another device"):
            world.build([world.entry(blas, rt.Triangles(rt.BufferSlice(data, 6)))])


def test_seeded_bugs_in_the_order_are_noticed(world, built, monkeypatch):
    """Rebuilt Blases are accepted, custom data has 25 bits, and a rebuild doesn't cancel a compaction."""
    usable = rt.Tlas.check_usable

    def lenient(tlas):
        if not tlas.built or tlas.destroyed or any(blas.destroyed for blas in tlas.blases):
            usable(tlas)

    monkeypatch.setattr(rt.Tlas, "check_usable", lenient)
    monkeypatch.setattr(instances, "CUSTOM_DATA_BITS", 25)
    monkeypatch.setattr(rt.Blas, "_drop_preparation", lambda blas: None)
    checks = (
        lambda: test_rebuilt_under_an_old_top(world, built, rt.UpdateMode.BUILD),
        lambda: test_compaction_of_what_cannot_be(world, built),
        lambda: test_instances_that_make_no_sense(world, {"custom_data": 1 << 24}, "custom_data"),
    )
    for check in checks:
        with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
            check()


# ---- compaction -------------------------------------------------------------------------------------


def test_compaction_of_what_cannot_be(world, built):
    bare = world.blas(name="bare")
    with refused("compaction of Blas bare: it was never built"):
        bare.prepare_compaction()
    with refused("compaction of Blas bare, which isn't ready"):
        bare.compact()
    loose = world.blas(name="loose", allow_compaction=False)
    world.build([world.entry(loose)])
    with refused("compaction of Blas loose: it was made without allow_compaction"):
        loose.prepare_compaction()
    blas, _ = built()
    blas.prepare_compaction()
    world.device.wait_idle()
    compacted = world.keep(blas.compact("tight"))
    with refused("compaction of Blas tight: it is already compacted"):
        compacted.prepare_compaction()
    with refused("compaction of Blas tight, which isn't ready"):
        compacted.compact()
    with refused("build of Blas tight, which was compacted"):
        world.build([world.entry(compacted)])
    world.build([world.entry(blas)])
    with refused("compaction of Blas quad, which isn't ready"):
        blas.compact()
    blas.destroy()
    with refused("compaction of Blas quad, which was destroyed"):
        blas.prepare_compaction()


# ---- arguments --------------------------------------------------------------------------------------


def test_twice_and_too_many(world, built):
    blas, tlas = built()
    with refused("the same Blas twice in one build: quad"):
        world.build([world.entry(blas), world.entry(blas)])
    with refused("the same Tlas twice in one build: top"):
        world.build((), [*top(blas, tlas), *top(blas, tlas)])
    with refused("build of Tlas top: 5 instances, but it was made for 4"):
        world.build([world.entry(blas)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas)] * 5)])
    with refused("made for"):
        world.build([world.entry(blas, rt.Triangles(np.concatenate([quad(), quad()])))])
    assert blas.build_count == 1  # nothing of these calls took place
    assert world.is_hit(tlas)
    world.build([world.entry(blas)], top(blas, tlas))
    assert world.is_hit(tlas)
    with refused("Tlas tlas of -1 instances"):
        world.tlas(-1)
    with refused("0 geometries"):
        rt.create_blas(world.device, [])
    with refused("triangles and boxes can't be in one Blas"):
        rt.create_blas(world.device, [rt.TriangleSize(3), rt.AabbSize(1)])


@pytest.mark.parametrize(
    ("size", "given", "message"),
    [
        (rt.TriangleSize(6), [rt.Triangles(quad())] * 2, "2 geometries, but it was made for 1"),
        (rt.TriangleSize(6), [rt.Aabbs(np.zeros((1, 6)))], "geometry 0: kind is boxes, but it was made for triangles"),
        (rt.AabbSize(1), [rt.Triangles(quad())], "geometry 0: kind is triangles, but it was made for boxes"),
        (rt.AabbSize(1), [rt.Aabbs(np.zeros((2, 6)))], "geometry 0: count is 2, but it was made for 1"),
        (rt.TriangleSize(3), [rt.Triangles(quad())], "geometry 0: position_count is 6, but it was made for 3"),
        (rt.TriangleSize(6), [rt.Triangles(quad(), opaque=False)], "geometry 0: opaque is False, but"),
        (rt.TriangleSize(6), [rt.Triangles(quad(), no_duplicate_any_hit=True)], "no_duplicate_any_hit is True"),
        (rt.TriangleSize(6), [rt.Triangles(quad(), [[0, 1, 2]])], "indices is uint32, but it was made for none"),
        (rt.TriangleSize(6, 3), [rt.Triangles(quad())], "indices is none, but it was made for uint32"),
        (rt.TriangleSize(6, 3, np.uint16), [rt.Triangles(quad(), [[0, 1, 2]])], "indices is uint32, but"),
        (rt.TriangleSize(6, 3), [rt.Triangles(quad(), [[0, 1, 2]] * 2)], "triangle_count is 2, but it was made for 1"),
        (rt.TriangleSize(6), [rt.Triangles(quad(), transform=shifted())], "transform is given, but"),
    ],
)
def test_data_that_does_not_fit_the_sizes(world, size, given, message):
    blas = world.blas([size], name="fixed")
    with refused(f"build of Blas fixed.*{message}"):
        rt.BuildCall(world.device, [rt.BlasBuildEntry(blas, given)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rt.Triangles(np.zeros((3, 2))), r"positions: the shape is \(3, 2\), not \(N, 3\)"),
        (lambda: rt.Triangles(np.full((3, 3), np.nan)), r"positions: element \(0, 0\) is not finite"),
        (lambda: rt.Triangles(np.full((3, 3), 1e39)), "positions: .* not finite"),
        (lambda: rt.Triangles(np.zeros((4, 3))), "the number of corners must be a multiple of 3, not 4"),
        (lambda: rt.Triangles(quad(), [[0, 1, 6]]), "6 is out of range: there are 6 positions"),
        (lambda: rt.Triangles(quad(), [[0, 1, -1]]), "whole numbers from 0"),
        (lambda: rt.Triangles(quad(), [[0.0, 1, 2]]), "whole numbers from 0 .* not float64"),
        (lambda: rt.Triangles(quad(), [0, 1, 2]), r"indices: the shape is \(3,\), not \(N, 3\)"),
        (lambda: rt.Triangles(quad(), transform=np.eye(3)), r"transform: the shape is \(3, 3\)"),
        (lambda: rt.Aabbs([[1, 0, 0, 0, 1, 1]]), "boxes: number 0 has a minimum beyond its maximum"),
        (lambda: rt.Aabbs([[np.inf] * 6]), "boxes: .* not finite"),
    ],
)
def test_geometry_that_makes_no_sense(make, message):
    with refused(message):
        make()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"custom_data": 1 << 24}, "custom_data must be 0 to 16,777,215, not 16777216"),
        ({"custom_data": -1}, "custom_data .* not -1"),
        ({"custom_data": 1.5}, "custom_data .* not float64"),
        ({"mask": 256}, "mask must be 0 to 255, not 256"),
        ({"mask": -1}, "mask .* not -1"),
        ({"transform": np.eye(3)}, "the transform must be 3x4"),
        ({"transform": np.ones((4, 4))}, "the transform must be 3x4, or an affine 4x4"),
        ({"transform": shifted(np.nan)}, "the transform is not finite"),
        ({"transform": np.eye(4)[:3] * 1e39}, "the transform is not finite"),
        ({"transform": np.zeros((3, 4))}, "the transform is not invertible"),
        ({"flags": 16}, "are unknown or contradict"),
        ({"flags": 12}, "FORCE_OPAQUE|FORCE_NO_OPAQUE.* are unknown or contradict"),
    ],
)
def test_instances_that_make_no_sense(world, options, message):
    blas = world.blas()
    with refused(message):
        rt.TlasInstance(blas, **options)


def test_instances_in_arrays_name_the_wrong_one(world):
    blas = world.blas()
    transforms = np.array([shifted()] * 5)
    with refused(r"custom_data .* not 16777216 \(number 3\)"):
        rt.TlasInstances(blas, transforms, [0, 1, 2, 1 << 24, 4])
    transforms[2, 0, 0] = 0
    with refused(r"not invertible \(number 2\)"):
        rt.TlasInstances(blas, transforms)
    with refused("one value for all, or a sequence of 4"):
        rt.TlasInstances([blas] * 4, transforms)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 9}, "ends at byte 108 of buffer data, which has 72"),
        ({"count": 6, "offset": 4}, "ends at byte 76"),
        ({"count": 6, "stride": 8}, "stride 8 of 12-byte records"),
        ({"count": 6, "offset": -4}, "offset -4"),
        ({"count": 3, "offset": 2}, "geometry 0: positions .* not a multiple of 4"),
        ({"count": 3, "stride": 14}, "geometry 0: position_stride .* not a multiple of 4"),
    ],
)
def test_slices_outside_of_their_buffer(world, options, message):
    blas = world.blas([rt.TriangleSize(99)])
    with refused(message):
        world.build([world.entry(blas, rt.Triangles(rt.BufferSlice(world.buffer(quad()), **options)))])
    assert not blas.built


def test_arrays_are_copied_when_they_are_checked():
    """Later changes of the caller's arrays never reach the device."""
    positions, indices = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.uint32)
    triangles = rt.Triangles(positions, indices)
    boxes = np.array([[0, 0, 0, 1, 1, 1]], np.float32)
    aabbs = rt.Aabbs(boxes)
    positions[0], indices[0], boxes[0] = np.nan, 5_000_000, np.nan
    held = [value for thing in (triangles, aabbs) for value in vars(thing).values() if isinstance(value, np.ndarray)]
    assert len(held) == 3
    for array in held:
        assert np.isfinite(array).all()
        assert array.max() <= 2
        assert not array.flags.writeable
