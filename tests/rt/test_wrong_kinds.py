"""Arguments of a wrong type are refused at once, with an error that names them and says what to give instead."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from support.structures import quad, shifted

import solari_vk as sv
from solari_vk import rt
from solari_vk import tracer as tracer_module
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.geometry import AabbGeometry, TriangleGeometry

HUGE = 1 << 70


def refused(message):
    return pytest.raises(sv.SolariError, match=message)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda w: rt.TlasInstance("x"), r"the Blas is 'x': give what rt\.create_blas makes"),
        (lambda w: rt.TlasInstance(None), "the Blas is None"),
        (lambda w: rt.TlasInstance(w.blas(), flags=1.5), r"flags must be rt\.InstanceFlags, not float64"),
        (lambda w: rt.TlasInstance(w.blas(), flags="x"), "flags must be .* not <U1"),
        (lambda w: rt.TlasInstance(w.blas(), flags=HUGE), "flags must be .* not object"),
        (lambda w: rt.TlasInstance(w.blas(), custom_data="x"), "custom_data must be a whole number .* not <U1"),
        (lambda w: rt.TlasInstance(w.blas(), custom_data=True), "custom_data must be a whole number .* not bool"),
        (lambda w: rt.TlasInstance(w.blas(), custom_data=HUGE), "custom_data must be a whole number .* not object"),
        (lambda w: rt.TlasInstance(w.blas(), mask=1.0), "mask must be a whole number .* not float64"),
        (lambda w: rt.TlasInstance(w.blas(), "x"), "the transform's elements must be numbers, not 'x'"),
        (lambda w: rt.TlasInstance(w.blas(), [[1, 2], [3]]), "the transform's elements must be numbers in rows"),
        (lambda w: rt.TlasInstance(w.blas(), shifted() * 1j), "must be numbers, not an array .* of complex"),
        (lambda w: rt.TlasInstance(w.blas(), [[None] * 4] * 3), "None is not a number"),
        (lambda w: rt.TlasInstances("x", [shifted()]), "the Blases: number 0 is 'x': give what rt.create_blas makes"),
        (lambda w: rt.TlasInstances([w.blas(), 5], [shifted()] * 2), "the Blases: number 1 is 5"),
        (lambda w: rt.TlasInstances(5, [shifted()]), "the Blases are 5: give a list"),
        (lambda w: rt.TlasInstances(w.blas(), [shifted()], flags=[0.5]), "flags must be"),
        (lambda w: rt.BlasBuildEntry("x", []), "the Blas is 'x'"),
        (lambda w: rt.BlasBuildEntry(w.blas(), 5), "build entry of Blas blas: the geometries are 5: give a list"),
        (lambda w: rt.BlasBuildEntry(w.blas(), rt.Triangles(quad())), "the geometries are .*: give a list"),
        (lambda w: rt.BlasBuildEntry(w.blas(), [rt.TriangleSize(6)]), "number 0 is TriangleSize.*: give rt.Triangles"),
        (lambda w: rt.TlasPackage("x"), "the Tlas is 'x'"),
        (lambda w: rt.TlasPackage(w.tlas(), 5), "package of Tlas tlas: the list of instances is 5"),
        (lambda w: rt.TlasPackage(w.tlas(), [w.blas()]), "the instances: number 0 is <Blas blas"),
        (lambda w: w.build(5), "the Blases are 5: give a list; give rt.BlasBuildEntry"),
        (lambda w: w.build([w.blas()]), "the Blases: number 0 is <Blas blas"),
        (lambda w: w.build((), ["x"]), "the Tlases: number 0 is 'x': give rt.TlasPackage"),
        (lambda w: rt.build_acceleration_structures("x"), "the device is 'x': give a solari_vk.Device"),
        (lambda w: w.blas().prepare_compaction("x"), "the callback is 'x': give a function"),
        (lambda w: w.blas().compact(5), "the name is 5"),
    ],
)
def test_instances_and_builds(world, make, message):
    before = world.device.submitted
    with refused(message):
        make(world)
    assert world.device.submitted == before


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda d: rt.create_tlas(d, 1.5), "Tlas tlas: max_instances is 1.5: give a whole number"),
        (lambda d: rt.create_tlas(d, "4"), "max_instances is '4'"),
        (lambda d: rt.create_tlas(d, True), "max_instances is True"),
        (lambda d: rt.create_tlas(d, None), "max_instances is None"),
        (lambda d: rt.create_tlas(d, HUGE), "this device takes 0 to"),
        (lambda d: rt.create_tlas("x", 1), "Tlas: the device is 'x'"),
        (lambda d: rt.create_tlas(d, 1, update_mode="build"), "update_mode is 'build': give rt.UpdateMode.BUILD"),
        (lambda d: rt.create_tlas(d, 1, rebuild_after=1.5), "rebuild_after is 1.5: give a whole number, at least 0"),
        (lambda d: rt.create_tlas(d, 1, rebuild_after=-1), "rebuild_after is -1"),
        (lambda d: rt.create_tlas(d, 1, low_memory=2), "low_memory is 2: give True or False"),
        (lambda d: rt.create_tlas(d, 1, prefer_fast_trace="no"), "prefer_fast_trace is 'no'"),
        (lambda d: rt.create_tlas(d, 1, name=5), "the name is 5: give a string"),
        (lambda d: rt.create_blas("x", []), "Blas: the device is 'x'"),
        (lambda d: rt.create_blas(d, 5), "Blas blas: the geometries are 5"),
        (lambda d: rt.create_blas(d, rt.TriangleSize(3)), "the geometries are TriangleSize.*: give a list"),
        (lambda d: rt.create_blas(d, [quad()]), r"number 0 is an array \(6, 3\) of float32: give rt.Triangles"),
        (lambda d: rt.create_blas(d, [rt.TriangleSize(3)], update_mode=1), "update_mode is 1"),
        (lambda d: rt.create_blas(d, [rt.TriangleSize(3)], allow_compaction=3), "allow_compaction is 3"),
        (lambda d: rt.TriangleSize(3.5), "vertex_count is 3.5"),
        (lambda d: rt.TriangleSize(3, "3"), "index_count is '3'"),
        (lambda d: rt.TriangleSize(-3), "vertex_count is -3"),
        (lambda d: rt.TriangleSize(3, 3, "zz"), "index_dtype must be uint16 or uint32, not 'zz'"),
        (lambda d: rt.TriangleSize(3, opaque="no"), "opaque is 'no'"),
        (lambda d: rt.TriangleSize(3, has_transform=shifted()), r"has_transform is an array \(3, 4\)"),
        (lambda d: rt.AabbSize(None), "boxes: count is None"),
        (lambda d: rt.AabbSize(1, no_duplicate_any_hit=1), "no_duplicate_any_hit is 1"),
        (lambda d: rt.Triangles("x"), "positions must be numbers, not 'x'"),
        (lambda d: rt.Triangles([[0, 0, 0], [1, 0]]), "positions must be numbers in rows"),
        (lambda d: rt.Triangles(quad() * 1j), "positions must be numbers, not an array"),
        (lambda d: rt.Triangles(quad(), "x"), "indices must be numbers, not 'x'"),
        (lambda d: rt.Triangles(quad(), [[0, 1], [2]]), "indices must be numbers in rows"),
        (lambda d: rt.Triangles(quad(), transform="x"), "transform must be numbers, not 'x'"),
        (lambda d: rt.Triangles(quad(), index_dtype=int), "index_dtype must be .*, not <class 'int'>"),
        (lambda d: rt.Triangles(quad(), opaque=2), "opaque is 2"),
        (lambda d: rt.Aabbs([1, 2, 3, 4, 5]), r"boxes: the shape is \(5,\), not \(N, 6\)"),
        (lambda d: rt.Aabbs("x"), "boxes must be numbers, not 'x'"),
        (lambda d: rt.Aabbs([[0, 0, 0, 1, 1, 1]], opaque=None), "opaque is None"),
        (lambda d: rt.BufferSlice("x", 1), "the buffer is 'x': give what Device.buffer makes"),
        (lambda d: Blas(d, ["x"]), "Blas blas, geometry 0 is 'x'"),
        (lambda d: Blas(d, [TriangleGeometry(0, 1.5, 0)]), "geometry 0: position_count is 1.5"),
        (lambda d: Blas(d, [TriangleGeometry(0, 3, 1, index_dtype=float)]), "index_dtype must be uint16 or uint32"),
        (lambda d: Blas(d, [AabbGeometry("x", 1)]), "geometry 0: boxes is 'x'"),
        (lambda d: sv.RayTracer("x", sv.Scene()), "RayTracer: the device is 'x': give a solari_vk.Device"),
        (lambda d: sv.RayTracer(d, "x"), "RayTracer: the scene is 'x': give a solari_vk.Scene"),
        (lambda d: sv.SceneFrame(d, None, []), "SceneFrame: the scene is None"),
    ],
)
def test_structures_geometry_and_tracers(world, make, message):
    before = world.device.objects_in_use
    with refused(message):
        make(world.device)
    assert world.device.objects_in_use == before


def test_slices(world):
    buffer = world.buffer(quad())
    for options in ({"count": 1.5}, {"count": 1, "offset": "x"}, {"count": 1, "stride": None}):
        with refused("slice of buffer data: .* give a whole number"):
            rt.BufferSlice(buffer, **options)


def test_numbers_of_numpy_are_numbers(world):
    tlas = world.tlas(np.int64(3), rebuild_after=np.uint8(2))
    assert tlas.max_instances == 3
    blas = world.blas([rt.TriangleSize(np.int32(6), opaque=np.True_)])
    instances = rt.TlasInstances([blas, None], [shifted()] * 2, np.arange(2, dtype=np.uint8), flags=np.uint8(1))
    world.build([world.entry(blas)], [rt.TlasPackage(tlas, instances)])
    world.build((), [rt.TlasPackage(tlas, rt.TlasInstances([], np.zeros((0, 3, 4)), [], []))])


def test_an_edited_instance_is_refused_before_anything_is_built(world):
    blas, tlas = world.blas(), world.tlas()
    for name, value, message in (("blas", "x", "the Blas is 'x'"), ("custom_data", 1 << 24, "custom_data")):
        instance = rt.TlasInstance(blas)
        setattr(instance, name, value)
        with refused(message):
            world.build([world.entry(blas)], [rt.TlasPackage(tlas, [instance])])
    package = rt.TlasPackage(tlas, [None])
    call = rt.BuildCall(world.device, [world.entry(blas)], [package])
    package.instances[0] = "x"
    with refused("instances: number 0 is 'x': give rt.TlasInstance"):
        call.submit()
    assert not blas.built


def test_what_was_checked_in_arrays_stays(world):
    """Changing the caller's arrays or the public attributes of `TlasInstances` doesn't change what is built."""
    blas, blases, transforms = world.blas(), [world.blas()], np.array([shifted()], np.float32)
    instances = rt.TlasInstances(blases, transforms)
    transforms[:], blases[0] = np.nan, "x"
    assert np.isfinite(instances.records["transform"]).all()
    assert isinstance(instances.blases[0], rt.Blas)
    with pytest.raises(ValueError, match="read-only"):
        instances.records["transform"] = np.nan
    with pytest.raises(ValueError, match="WRITEABLE"):
        instances.records.setflags(write=True)
    with pytest.raises(TypeError):
        instances.blases[0] = blas  # type: ignore[index]
    for name in ("records", "blases"):
        with pytest.raises(AttributeError):
            setattr(instances, name, None)
    geometries = [rt.Triangles(quad())]
    entry = rt.BlasBuildEntry(blas, geometries)
    geometries[0] = "x"
    world.build([entry])


# ---- the tracer -------------------------------------------------------------------------------------


def test_numbers_beyond_float32_are_infinite_without_a_warning(device):
    up = np.array([0.0, 0.0, 1.0])
    huge = 10**300
    with sv.RayTracer(device, sv.builtin("closed_box")) as tracer, warnings.catch_warnings():
        warnings.simplefilter("error")
        endless = tracer.trace((0, 0, 0), up)
        assert endless["instance"] >= 0
        for t_max in (1e300, huge, [1e300], 1e39):
            assert (tracer.trace((0, 0, 0), up, t_max=t_max)["t"] == endless["t"]).all()
        wrong = [((0, 0, 0), up, 1e300), ((0, 0, 0), up, -1e300), ((0, 0, -1e300), up, 0), ((0, 0, 0), up * 1e300, 0)]
        for origin, direction, t_min in wrong:
            assert tracer.trace(origin, direction, t_min=t_min, t_max=np.inf)["instance"] == -1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"t_max": None}, "trace: t_max must be numbers"),
        ({"t_max": 1j}, "trace: t_max must be numbers, not 1j"),
        ({"t_min": "1"}, "trace: t_min must be numbers, not '1'"),
        ({"t_max": 10**400}, "trace: t_max must be numbers"),
        ({"t_max": [[1], [2, 3]]}, "trace: t_max must be numbers in rows"),
        ({"any_hit": "no"}, "trace: any_hit is 'no': give True or False"),
    ],
)
def test_limits_that_are_none(device, options, message):
    with sv.RayTracer(device, sv.Scene()) as tracer, refused(message):
        tracer.trace((0, 0, 0), (0, 0, 1), **options)


@pytest.mark.parametrize("stage", ["compile_shader", "reflect", "_host_type", "buffer"])
def test_a_tracer_that_fails_leaves_nothing(device, monkeypatch, stage):
    device.wait_idle()
    before = device.live_objects
    owner = device if stage == "buffer" else tracer_module
    real, calls = getattr(owner, stage), []

    def fail(*arguments, **options):
        calls.extend([1] if stage != "buffer" or arguments[1] in tracer_module.ARRAYS else [])
        if len(calls) == 3 or stage in ("compile_shader", "reflect"):
            raise RuntimeError("no more")
        return real(*arguments, **options)

    monkeypatch.setattr(owner, stage, fail)
    with pytest.raises(RuntimeError, match="no more"):
        sv.RayTracer(device, sv.builtin("cornell_box"))
    device.wait_idle()
    assert device.live_objects - before <= 4  # staging chunks stay in their pool
