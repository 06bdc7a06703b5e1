"""Invalid calls are refused before Vulkan sees them, with an error that names the object and what to give instead."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from support.scenes import quad_corners, translation

import solari_vk as sv
from solari_vk import rt
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.sampler import Sampler
from solari_vk.gpu.frame.descriptors import BufferRange
from solari_vk.gpu.frame.frame import Frame, Pass, Stage

SIX = rt.TriangleSize(6)


def refused(message):
    return pytest.raises(sv.SolariError, match=message)


def top(tlas, *blases):
    return [rt.TlasPackage(tlas, [rt.TlasInstance(blas) for blas in blases])]


# ---- arguments --------------------------------------------------------------------------------------

VALID = [  # a call and its valid arguments, of which each is replaced by one of a wrong kind
    (rt.TlasInstance, lambda s: {"blas": s.blas, "transform": translation(), "custom_data": 0, "mask": 0, "flags": 0}),
    (rt.TlasInstances, lambda s: {"blases": s.blas, "transforms": [translation()], "custom_data": 0, "flags": 0}),
    (rt.BlasBuildEntry, lambda s: {"blas": s.blas, "geometries": [rt.Triangles(quad_corners())]}),
    (rt.TlasPackage, lambda s: {"tlas": s.tlas, "instances": ()}),
    (rt.build_acceleration_structures, lambda s: {"device": s.device, "blases": (), "tlases": ()}),
    (rt.create_blas, lambda s: {"device": s.device, "geometries": [SIX], "allow_compaction": False, **OPTIONS}),
    (rt.create_tlas, lambda s: {"device": s.device, "max_instances": 1, **OPTIONS}),
    (rt.TriangleSize, lambda s: {"vertex_count": 3, "index_count": 3, "index_dtype": "u2", "has_transform": True}),
    (rt.AabbSize, lambda s: {"count": 1, **FLAGS}),
    (
        rt.Triangles,
        lambda s: {"positions": quad_corners(), "indices": None, "transform": None, "index_dtype": "u2", **FLAGS},
    ),
    (rt.Aabbs, lambda s: {"boxes": [[0, 0, 0, 1, 1, 1]], **FLAGS}),
    (rt.BufferSlice, lambda s: {"buffer": s.data, "count": 1, "offset": 0, "stride": 12}),
    (rt.Blas.prepare_compaction, lambda s: {"self": s.blas, "callback": None}),
    (rt.Blas.compact, lambda s: {"self": s.blas, "name": ""}),
    (sv.RayTracer, lambda s: {"device": s.device, "scene": sv.Scene()}),
    (sv.SceneFrame, lambda s: {"device": s.device, "scene": sv.Scene(), "stages": []}),
]
OPTIONS = {
    "prefer_fast_trace": True,
    "low_memory": False,
    "update_mode": rt.UpdateMode.BUILD,
    "rebuild_after": 1,
    "name": "new",
}
FLAGS = {"opaque": True, "no_duplicate_any_hit": True}
ARGUMENTS = [  # what is wrong about a value; `s` are the structures of `states`
    (lambda s: rt.TlasInstance("x"), r"the Blas is 'x': give what rt\.create_blas makes"),
    (lambda s: rt.TlasInstance(s.blas, flags=1.5), r"flags must be rt\.InstanceFlags, not float64"),
    (lambda s: rt.TlasInstance(s.blas, flags=16), "are unknown or contradict"),
    (lambda s: rt.TlasInstance(s.blas, flags=12), "FORCE_OPAQUE|FORCE_NO_OPAQUE.* are unknown or contradict"),
    (lambda s: rt.TlasInstance(s.blas, custom_data=True), "custom_data must be a whole number .* not bool"),
    (lambda s: rt.TlasInstance(s.blas, custom_data=1 << 24), "custom_data must be 0 to 16,777,215, not 16777216"),
    (lambda s: rt.TlasInstance(s.blas, custom_data=-1), "custom_data .* not -1"),
    (lambda s: rt.TlasInstance(s.blas, mask=256), "mask must be 0 to 255, not 256"),
    (lambda s: rt.TlasInstance(s.blas, "x"), "the transform's elements must be numbers, not 'x'"),
    (lambda s: rt.TlasInstance(s.blas, [[1, 2], [3]]), "the transform's elements must be numbers in rows"),
    (lambda s: rt.TlasInstance(s.blas, translation() * 1j), "must be numbers, not an array .* of complex"),
    (lambda s: rt.TlasInstance(s.blas, [[None] * 4] * 3), "None is not a number"),
    (lambda s: rt.TlasInstance(s.blas, np.eye(3)), "the transform must be 3x4"),
    (lambda s: rt.TlasInstance(s.blas, np.ones((4, 4))), "the transform must be 3x4, or an affine 4x4"),
    (lambda s: rt.TlasInstance(s.blas, translation(np.nan)), "the transform is not finite"),
    (lambda s: rt.TlasInstance(s.blas, np.eye(4)[:3] * 1e39), "the transform is not finite"),
    (lambda s: rt.TlasInstance(s.blas, np.zeros((3, 4))), "the transform is not invertible"),
    (
        lambda s: rt.TlasInstances([s.blas, 5], [translation()] * 2),
        "the Blases: number 1 is 5: give what rt.create_blas",
    ),
    (lambda s: rt.TlasInstances(s.blas, [translation()] * 3, [0, 1 << 24, 2]), r"not 16777216 \(number 1\)"),
    (lambda s: rt.TlasInstances(s.blas, [translation(), np.zeros((3, 4))]), r"not invertible \(number 1\)"),
    (lambda s: rt.TlasInstances([s.blas] * 4, [translation()] * 5), "one value for all, or a sequence of 4"),
    (
        lambda s: rt.BlasBuildEntry(s.blas, rt.Triangles(quad_corners())),
        "of Blas quad: the geometries are .*: give a list",
    ),
    (lambda s: rt.BlasBuildEntry(s.blas, [SIX]), "number 0 is TriangleSize.*: give rt.Triangles"),
    (lambda s: rt.TlasPackage(s.tlas, [s.blas]), "the instances: number 0 is <Blas quad"),
    (lambda s: s.build([s.blas]), "the Blases: number 0 is <Blas quad"),
    (lambda s: s.build((), ["x"]), "the Tlases: number 0 is 'x': give rt.TlasPackage"),
    (lambda s: s.new_tlas(1.5), "Tlas tlas: max_instances is 1.5: give a whole number"),
    (lambda s: s.new_tlas(True), "max_instances is True"),
    (lambda s: s.new_tlas(1, rebuild_after=-1), "rebuild_after is -1: give a whole number, at least 0"),
    (lambda s: s.new_blas([quad_corners()]), r"number 0 is an array \(6, 3\) of float32: give rt.Triangles"),
    (lambda s: rt.TriangleSize(-3), "vertex_count is -3"),
    (lambda s: rt.Triangles(np.zeros((3, 2))), r"positions: the shape is \(3, 2\), not \(N, 3\)"),
    (lambda s: rt.Triangles(np.full((3, 3), np.nan)), r"positions: element \(0, 0\) is not finite"),
    (lambda s: rt.Triangles(np.full((3, 3), 1e39)), "positions: .* not finite"),
    (lambda s: rt.Triangles(np.zeros((4, 3))), "the number of corners must be a multiple of 3, not 4"),
    (lambda s: rt.Triangles(quad_corners(), [[0, 1, 6]]), "6 is out of range: there are 6 positions"),
    (lambda s: rt.Triangles(quad_corners(), [[0, 1, -1]]), "whole numbers from 0"),
    (lambda s: rt.Triangles(quad_corners(), [[0.0, 1, 2]]), "whole numbers from 0 .* not float64"),
    (lambda s: rt.Triangles(quad_corners(), [0, 1, 2]), r"indices: the shape is \(3,\), not \(N, 3\)"),
    (lambda s: rt.Triangles(quad_corners(), transform=np.eye(3)), r"transform: the shape is \(3, 3\)"),
    (lambda s: rt.Aabbs([1, 2, 3, 4, 5]), r"boxes: the shape is \(5,\), not \(N, 6\)"),
    (lambda s: rt.Aabbs([[1, 0, 0, 0, 1, 1]]), "boxes: number 0 has a minimum beyond its maximum"),
    (lambda s: rt.Aabbs([[np.inf] * 6]), "boxes: .* not finite"),
    (lambda s: Blas(s.device, ["x"]), "Blas blas, geometry 0 is 'x'"),
]
SIZES = [  # what a Blas was made for, what it is given, and the error
    (SIX, [rt.Triangles(quad_corners())] * 2, "2 geometries, but it was made for 1"),
    (SIX, [rt.Aabbs(np.zeros((1, 6)))], "geometry 0: kind is boxes, but it was made for triangles"),
    (rt.AabbSize(1), [rt.Triangles(quad_corners())], "geometry 0: kind is triangles, but it was made for boxes"),
    (rt.AabbSize(1), [rt.Aabbs(np.zeros((2, 6)))], "geometry 0: count is 2, but it was made for 1"),
    (rt.TriangleSize(3), [rt.Triangles(quad_corners())], "geometry 0: position_count is 6, but it was made for 3"),
    (SIX, [rt.Triangles(quad_corners(), opaque=False)], "geometry 0: opaque is False, but"),
    (SIX, [rt.Triangles(quad_corners(), no_duplicate_any_hit=True)], "no_duplicate_any_hit is True"),
    (SIX, [rt.Triangles(quad_corners(), [[0, 1, 2]])], "indices is uint32, but it was made for none"),
    (rt.TriangleSize(6, 3), [rt.Triangles(quad_corners())], "indices is none, but it was made for uint32"),
    (rt.TriangleSize(6, 3, np.uint16), [rt.Triangles(quad_corners(), [[0, 1, 2]])], "indices is uint32, but"),
    (
        rt.TriangleSize(6, 3),
        [rt.Triangles(quad_corners(), [[0, 1, 2]] * 2)],
        "triangle_count is 2, but it was made for 1",
    ),
    (SIX, [rt.Triangles(quad_corners(), transform=translation())], "transform is given, but"),
]
SLICES = [  # of a buffer of 72 bytes
    ({"count": 9}, "ends at byte 108 of buffer data, which has 72"),
    ({"count": 6, "offset": 4}, "ends at byte 76"),
    ({"count": 6, "stride": 8}, "stride 8 of 12-byte records"),
    ({"count": 6, "offset": -4}, "offset -4"),
    ({"count": 3, "offset": 2}, "geometry 0: positions .* not a multiple of 4"),
    ({"count": 3, "stride": 14}, "geometry 0: position_stride .* not a multiple of 4"),
]


def test_data_that_does_not_fit(world):
    for size, given, message in SIZES:
        with refused(f"build of Blas fixed.*{message}"):
            rt.BuildCall(world.device, [rt.BlasBuildEntry(world.blas([size], name="fixed"), given)])
    blas, buffer = world.blas([rt.TriangleSize(99)]), world.buffer(quad_corners())
    for options, message in SLICES:
        with refused(message):
            world.build([world.entry(blas, rt.Triangles(rt.BufferSlice(buffer, **options)))])
    assert not blas.built


def test_numbers_of_numpy_are_numbers(world):
    tlas = world.tlas(np.int64(3), rebuild_after=np.uint8(2))
    assert tlas.max_instances == 3
    blas = world.blas([rt.TriangleSize(np.int32(6), opaque=np.True_)])
    instances = rt.TlasInstances([blas, None], [translation()] * 2, np.arange(2, dtype=np.uint8), flags=np.uint8(1))
    world.build([world.entry(blas)], [rt.TlasPackage(tlas, instances)])
    world.build((), [rt.TlasPackage(tlas, rt.TlasInstances([], np.zeros((0, 3, 4)), [], []))])


# ---- states -----------------------------------------------------------------------------------------

USES = {  # which Tlases rays can't be traced through
    "unbuilt": "use of Tlas unbuilt, which was never built",
    "stale": "use of Tlas stale, built over Blas again, which was built again since: build the Tlas again",
    "orphan": "use of Tlas orphan, built over Blas gone, which was destroyed",
    "ended": "Tlas ended: destroyed",
}
STATES = [  # which structures can't be built or compacted
    (lambda s: s.build([s.entry(s.blas)], top(s.tlas, s.blas, s.bare)), "Tlas top over Blas bare, which was not built"),
    (lambda s: s.build((), top(s.tlas, s.blas, s.gone)), "Tlas top over an instance of Blas gone, which was destroyed"),
    (lambda s: s.build([s.entry(s.gone)]), "build of Blas gone, which was destroyed"),
    (lambda s: s.call.submit(), "build of Blas gone, which was destroyed"),
    (lambda s: s.gone.ensure_storage(), "build of Blas gone, which was destroyed"),
    (lambda s: s.build((), top(s.ended)), "build of Tlas ended, which was destroyed"),
    (lambda s: s.build([s.entry(s.tight)]), "build of Blas tight, which was compacted"),
    (lambda s: s.build([s.lost]), "positions: buffer data was destroyed"),
    (lambda s: s.build((), top(s.tlas, s.foreign)), "Blas foreign, which belongs to another device"),
    (lambda s: rt.BuildCall(s.other, [s.entry(s.blas)]).submit(), "Blas quad, which belongs to another device"),
    (lambda s: rt.BuildCall(s.other, (), top(s.tlas)).submit(), "build of Tlas top, which belongs to another device"),
    (lambda s: s.build([s.theirs]), "positions: buffer theirs belongs to another device"),
    (lambda s: s.build([s.entry(s.blas)] * 2), "the same Blas twice in one build: quad"),
    (lambda s: s.build((), top(s.tlas, s.blas) * 2), "the same Tlas twice in one build: top"),
    (lambda s: s.build([s.entry(s.blas)], top(s.tlas, *[s.blas] * 5)), "Tlas top: 5 instances, but it was made for 4"),
    (lambda s: s.build([s.entry(s.blas, rt.Triangles(np.tile(quad_corners(), (2, 1))))]), "made for"),
    (lambda s: s.bare.prepare_compaction(), "compaction of Blas bare: it was never built"),
    (lambda s: s.bare.compact(), "compaction of Blas bare, which isn't ready"),
    (lambda s: s.loose.prepare_compaction(), "compaction of Blas loose: it was made without allow_compaction"),
    (lambda s: s.tight.prepare_compaction(), "compaction of Blas tight: it is already compacted"),
    (lambda s: s.tight.compact(), "compaction of Blas tight, which isn't ready"),
    (lambda s: s.again.compact(), "compaction of Blas again, which isn't ready"),
    (lambda s: s.gone.prepare_compaction(), "compaction of Blas gone, which was destroyed"),
]


@pytest.fixture
def states(world, built):
    """Structures in all states, on two devices: a built Blas and Tlas, and others named by what is wrong with them."""
    device, entry = world.device, world.entry
    blas, tlas = built()
    data, freed = world.buffer(quad_corners()), world.buffer(quad_corners())
    bare, gone, again = (world.blas(name=name) for name in ("bare", "gone", "again"))
    loose = world.blas(name="loose", allow_compaction=False)
    unbuilt, stale, orphan, ended = (world.tlas(name=name) for name in ("unbuilt", "stale", "orphan", "ended"))
    # What is wrong is below the second instance, so that checks of the first one alone find nothing.
    world.build(map(entry, (loose, gone, again)), top(stale, blas, again) + top(orphan, blas, gone) + top(ended, blas))
    for one in (blas, again):
        one.prepare_compaction()
    device.wait_idle()
    tight = world.keep(blas.compact("tight"))
    world.build([entry(again)])
    call = rt.BuildCall(device, [entry(gone)])
    lost = entry(world.blas(), rt.Triangles(rt.BufferSlice(freed, 6)))
    for one in (gone, ended, freed):
        one.destroy()
    with sv.Device(validation=True) as other:
        foreign = rt.create_blas(other, [SIX], name="foreign")
        rt.build_acceleration_structures(other, [entry(foreign)])
        theirs = entry(world.blas(), rt.Triangles(rt.BufferSlice(other.buffer(72, "theirs"), 6)))
        made = {name: value for name, value in locals().items() if name not in ("world", "built")}
        yield SimpleNamespace(**made, build=world.build, new_blas=world.blas, new_tlas=world.tlas)


def test_wrong_calls_are_refused_and_change_nothing(world, states):
    device = world.device
    before = device.submitted, device.objects_in_use, states.blas.build_count

    def check(message, call, *arguments, **options):
        with refused(message):
            call(*arguments, **options)
        assert (device.submitted, device.objects_in_use, states.blas.build_count) == before, message

    for call, message in ARGUMENTS + STATES:
        check(message, call, states)
    for call, make in VALID:
        right = make(states)
        for name in right.keys() - {"self", "stages"}:
            for wrong in ("x", object()) if name not in ("name", "index_dtype") else (5,):
                check(f"(?i){name.rstrip('s')}", call, **right | {name: wrong})
    for name, message in USES.items():
        with refused(message):
            world.trace(getattr(states, name))
    assert world.is_hit(states.tlas)
    world.build((), top(states.orphan))
    assert not world.is_hit(states.orphan)


def test_calls_out_of_order(world):
    blas, tlas = world.blas(name="late"), world.tlas(name="top")
    first = rt.BuildCall(world.device, [world.entry(blas)])
    second = rt.BuildCall(world.device, (), top(tlas, blas))
    with refused("build of Tlas top over Blas late, which was not built"):
        second.submit()
    for _ in range(2):
        first.submit()
        second.submit()
        assert world.is_hit(tlas)


def test_a_frame_checks_every_time(world, built):
    blas, tlas = built(update_mode=rt.UpdateMode.PREFER_UPDATE)
    stage = Stage("trace", buffers={"rays": 1, "hits": 1}, passes=[Pass("conformance/trace", 1)])
    with Frame(world.device, [stage], external={"tlas": tlas}) as frame:
        for _ in range(3):
            frame.submit()
        world.build([world.entry(blas)])
        assert blas.refit_count == 1
        with refused("built again since"):
            frame.submit()
        world.build([world.entry(blas)], top(tlas, blas))
        frame.submit()
        tlas.destroy()
        with refused("use of Tlas top, which was destroyed"):
            frame.submit()


TWO = """#version 460
#extension GL_EXT_ray_query : require
layout(local_size_x = 1) in;
layout(set = 0, binding = 0) uniform accelerationStructureEXT first;
layout(set = 0, binding = 1) uniform accelerationStructureEXT second;
layout(set = 0, binding = 2) buffer HitBlock { float at[]; } hits;
void main() {
    rayQueryEXT query;
    rayQueryInitializeEXT(query, first, 1u, 0xFFu, vec3(0.5, 0.5, 5.0), 0.0, vec3(0.0, 0.0, -1.0), 9.0);
    rayQueryProceedEXT(query);
    hits.at[0] = rayQueryGetIntersectionTypeEXT(query, true) != 0u ? 1.0 : 0.0;
    rayQueryInitializeEXT(query, second, 1u, 0xFFu, vec3(0.5, 0.5, 5.0), 0.0, vec3(0.0, 0.0, -1.0), 9.0);
    rayQueryProceedEXT(query);
    hits.at[1] = rayQueryGetIntersectionTypeEXT(query, true) != 0u ? 1.0 : 0.0;
}
"""


def test_a_frame_checks_each_of_its_structures(world, built, tmp_path):
    blas, tlas = built()
    other, late = world.blas(name="other"), world.tlas(name="late")
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/two.comp").write_text(TWO)
    stage = Stage("two", buffers={"hits": 2}, passes=[Pass("two", 1)])
    for first, second in ((tlas, late), (late, tlas)):
        with Frame(world.device, [stage], external={"first": first, "second": second}, glsl_root=tmp_path) as frame:
            world.build([world.entry(other)], top(late, blas, other))
            frame.submit()
            assert (frame["hits"] == 1).all()
            world.build([world.entry(other)])
            with refused("use of Tlas late, built over Blas other, which was built again since"):
                frame.submit()


# ---- later changes ----------------------------------------------------------------------------------


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


def test_what_was_checked_stays(world):
    """Changing the caller's arrays or the attributes of what was made of them doesn't change what is built."""
    blas = world.blas()
    blases = [world.blas()]
    transforms = np.array([translation()], np.float32)
    positions = quad_corners()
    indices = np.array([[0, 1, 2]], np.uint32)
    boxes = np.array([[0, 0, 0, 1, 1, 1]], np.float32)
    instances = rt.TlasInstances(blases, transforms)
    triangles, aabbs = rt.Triangles(positions, indices), rt.Aabbs(boxes)
    positions[0] = np.nan
    indices[0] = 5_000_000
    boxes[0] = np.nan
    transforms[:] = np.nan
    blases[0] = "x"
    held = [value for thing in (triangles, aabbs) for value in vars(thing).values() if isinstance(value, np.ndarray)]
    assert len(held) == 3
    for array in (*held, instances.records["transform"]):
        assert np.isfinite(array).all()
        assert array.max() <= 2
        assert not array.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        instances.records.setflags(write=True)
    assert isinstance(instances.blases[0], rt.Blas)
    with pytest.raises(TypeError):
        instances.blases[0] = blas  # type: ignore[index]
    for name in ("records", "blases"):
        with pytest.raises(AttributeError):
            setattr(instances, name, None)
    geometries = [rt.Triangles(quad_corners())]
    entry = rt.BlasBuildEntry(blas, geometries)
    geometries[0] = "x"
    world.build([entry])


BINDERS = {
    "PathTracer": lambda device, scene: sv.PathTracer(device, scene, (8, 8)),
    "Renderer": lambda device, scene: sv.Renderer(device, scene, (8, 8)),
    "RayTracer": lambda device, scene: sv.RayTracer(device, scene),
    "SceneFrame": lambda device, scene: sv.SceneFrame(device, scene, []),
    "Batch": lambda device, scene: sv.Batch(device, scene, (8, 8), 1),
    "illuminance": lambda device, scene: sv.illuminance(device, scene, (0, 0, 0)),
}


def test_what_belongs_to_another_device_is_refused(device, tmp_path):
    """Whatever takes things of a device: frames, also in lists and ranges and when bound later, and all renderers."""
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/copy.comp").write_text(
        """#version 460
        #include "scene/ray_query.glsl"
        layout(local_size_x = 1) in;
        layout(set = 1) uniform accelerationStructureEXT tlas;
        layout(set = 1) uniform sampler2D picture;
        layout(set = 1, scalar) buffer DataBlock { vec4 at[]; } data;
        void main() {
            RAY_QUERY(query);
            rayQueryInitialize(query, tlas, RayDesc(0u, 255u, 0.0, 9.0, vec3(0.0), vec3(0.0, 0.0, 1.0)));
            while (rayQueryProceed(query)) {}
            data.at[0] = textureLod(picture, vec2(0.5), 0.0);
        }"""
    )
    with sv.Device() as other:

        def made_by(one):
            image = one.image(1, 1, raw.VK_FORMAT_R32G32B32A32_SFLOAT, "image", usage=raw.VK_IMAGE_USAGE_SAMPLED_BIT)
            sampled = image, Sampler(one)
            buffer = one.buffer(16, "data")
            return {"tlas": rt.create_tlas(one, 1), "picture": sampled, "data": buffer}

        mine, theirs = made_by(device), made_by(other)
        theirs["data "] = BufferRange(theirs["data"], 0, 16)
        theirs["picture "] = mine["picture"][0], theirs["picture"][1]
        stage = Stage("copy", passes=[Pass("copy", 1)])
        with Frame(device, [stage], external=mine, glsl_root=tmp_path) as frame:
            for name, foreign in theirs.items():
                for use in (lambda one: Frame(device, [stage], external=mine | one, glsl_root=tmp_path), frame.bind):
                    with refused(f"{name.strip()}: .* belongs to another device: make it with the one that uses it"):
                        use({name.strip(): foreign})
        binder = sv.SceneBinder(other, sv.builtin("cornell_box"))
        for make in BINDERS.values():
            with refused("the SceneBinder belongs to another device"):
                make(device, binder)
        binder.destroy()
        for one in (mine, theirs):
            for item in (one["tlas"], one["data"], *one["picture"]):
                item.destroy()


def test_a_tlas_is_refused_in_a_process_that_has_built_none(tmp_path):
    program = """
import solari_vk as sv
from solari_vk import rt
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
with sv.Device() as device:
    stage = Stage("trace", buffers={"rays": 1, "hits": 1}, passes=[Pass("conformance/trace", 1)])
    with Frame(device, [stage], external={"tlas": rt.create_tlas(device, 1)}) as frame:
        for _ in range(2):
            try:
                frame.submit()
            except sv.SolariError as error:
                print(error)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == ["use of Tlas tlas, which was never built"] * 2
