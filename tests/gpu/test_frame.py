"""Frames run on the device: layouts, history, barriers, indirect passes, rebuilding, errors, lifetime."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.frames import leaves_nothing

from solari_vk.base.errors import SolariError, ValidationError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame import slot
from solari_vk.gpu.frame.frame import Aliased, Counter, Frame, History, IfUsed, Pass, Stage, Step
from solari_vk.gpu.frame.in_parts import Interrupted
from solari_vk.gpu.shaders.compiler import CompilationError

BINDINGS = """#ifndef BINDINGS
#define BINDINGS
layout(set = 1, binding = 0, scalar) uniform UniformsBlock {
    mat4 clip_from_world; mat4x3 world_from_object; vec3 place; uint frame; float gain;
} uniforms;
layout(set = 1, binding = 1, scalar) buffer ABlock { uint at[]; } a;
layout(set = 1, binding = 2, scalar) buffer BBlock { uint at[]; } b;
layout(set = 1, binding = 3, scalar) buffer CBlock { uint total; uint at[]; } c;
layout(set = 1, binding = 4, rgba32f) uniform image2D picture;
layout(set = 1, binding = 5, rgba32f) uniform image2D previous_picture;
layout(set = 1, binding = 6, scalar) buffer ArgumentsBlock { uvec3 groups; } arguments;
#endif
"""
COUNT = 1024
ONE = "layout(local_size_x = 64) in;\n"
START = '#include "passes/bindings.glsl"\n' + ONE
INDEX = "uint i = gl_GlobalInvocationID.x; "
PASSES = {
    "fill_a": "void main() { " + INDEX + "a.at[i] = i + uniforms.frame; }\n",
    "a_to_b": "void main() { " + INDEX + "b.at[i] = a.at[a.at.length() - 1 - i] * 2u; }\n",
    "b_to_c": "void main() { " + INDEX + "c.at[i] = b.at[b.at.length() - 1 - i] + 1u; }\n",
    "add_to_c": "void main() { atomicAdd(c.total, 1u); }\n",
    "accumulate": """void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.x % 16u, gl_GlobalInvocationID.x / 16u);
    imageStore(picture, at, imageLoad(previous_picture, at) + vec4(1, uniforms.gain, at));
}
""",
    "arguments": "layout(constant_id = 0) const uint GROUPS = 1;\n"
    "void main() { if (gl_GlobalInvocationID.x == 0u) arguments.groups = uvec3(GROUPS, 1, 1); }\n",
}


@pytest.fixture
def root(shaders):
    shaders.write("passes/bindings.glsl", BINDINGS)
    for name, text in PASSES.items():
        shaders.write(name, START + text)
    return shaders.root


def test_an_image_that_is_declared_if_used(device, root, shaders):
    """It is made when a shader begins to use it, and freed when none does any more."""
    shaders.write("sometimes", START + PASSES["fill_a"])
    stage = Stage("sometimes", buffers={"a": 64}, images={"picture": IfUsed((16, 4))}, passes=[Pass("sometimes", 64)])
    with Frame(device, [stage], glsl_root=root) as frame:
        assert "picture" not in frame
        frame.submit()
        uses = "imageStore(picture, ivec2(gl_GlobalInvocationID.x, 0), vec4(2.0)); a.at[0] = uniforms.frame;"
        shaders.write("sometimes", START + "void main() { " + uses + " }\n")
        frame.rebuild()
        frame.submit()
        assert frame["picture"].shape == (4, 16, 4)
        assert (frame["picture"][0] == 2).all()
        shaders.write("sometimes", START + PASSES["fill_a"])
        frame.rebuild()
        assert "picture" not in frame


def test_a_buffer_within_another(device, root, shaders):
    """It has the other's memory, so that passes which write both have a barrier between them."""
    shaders.write("fill_b", START + "void main() { " + INDEX + "if (i < 16u) b.at[i] = 100u + i; }\n")
    passes = [Pass("fill_a", threads=64), Pass("fill_b", threads=64)]
    stage = Stage("x", buffers={"a": 64, "b": Aliased("a", 16)}, passes=passes)
    with Frame(device, [stage], glsl_root=root) as frame:
        frame.submit()
        np.testing.assert_array_equal(frame["b"], 100 + np.arange(16))
        np.testing.assert_array_equal(frame["a"], [*range(100, 116), *range(16, 64)])
        assert [row.barrier for row in frame.describe()] == ["", "WAW a (fill_a)"]
        assert frame.memory == {"a": 256}
        frame.rebuild([Stage("x", buffers={"a": 64, "b": Aliased("c", 16)}, passes=passes)])  # there is no c
        assert frame.memory == {"a": 256, "b": 64}
        frame.submit()
        np.testing.assert_array_equal(frame["a"], np.arange(64))
        np.testing.assert_array_equal(frame["b"], 100 + np.arange(16))


def test_a_buffer_within_that_of_the_previous_frame(device, root, shaders):
    declared = START + "layout(set = 1, scalar) buffer PreviousABlock { uint at[]; } previous_a;\n"
    shaders.write("swap", declared + "void main() { " + INDEX + "a.at[i] = previous_a.at[i] + 1u; }\n")
    shaders.write("fill_b", START + "void main() { " + INDEX + "b.at[i] = 100u; }\n")
    stage = Stage(
        "x",
        buffers={"a": History(64), "b": Aliased("previous_a", 64)},
        passes=[Pass("swap", threads=64), Pass("fill_b", threads=64)],
    )
    with Frame(device, [stage], glsl_root=root) as frame:
        for expected_a in (1, 2, 3):
            frame.submit()
            assert (frame["a"] == expected_a).all()
            assert (frame["b"] == 100).all()
            assert [row.barrier for row in frame.describe()] == ["", "WAR previous_a (swap)"]


def chain(size: int = COUNT) -> Stage:
    """Each pass reads what the previous one wrote, in reverse order, so that a missing barrier gives wrong results."""
    passes = [Pass(name, threads=size) for name in ("fill_a", "a_to_b", "b_to_c")]
    return Stage("chain", buffers={"a": size, "b": size, "c": size}, passes=passes)


def expected(frame: int) -> np.ndarray:
    return (np.arange(COUNT, dtype=np.uint32) + frame) * 2 + 1


def test_chain_gives_the_right_numbers_every_frame(device, root):
    with Frame(device, [chain()], glsl_root=root) as frame:
        for number in range(3):
            frame.uniforms["uniforms.frame"] = number
            frame.submit()
            np.testing.assert_array_equal(frame["c"], expected(number))
        rows = frame.describe()
    assert [(row.name, row.reads, row.writes, row.barrier) for row in rows] == [
        ("fill_a", (), ("a",), ""),
        ("a_to_b", ("a",), ("b",), "RAW a (fill_a)"),
        ("b_to_c", ("b",), ("c",), "RAW b (a_to_b)"),
    ]
    assert all(row.milliseconds is not None for row in rows)


def test_derived_barriers_are_these(device, root):
    counts = {"arguments": 1, "a": COUNT, "b": COUNT, "c": COUNT}
    passes = [
        Pass("fill_a", threads=COUNT),
        Pass("arguments", threads=1, constants={"GROUPS": 2}),
        Pass("add_to_c", indirect="arguments"),
        Pass("a_to_b", threads=COUNT),
        Pass("fill_a", threads=COUNT),
        Pass("b_to_c", threads=COUNT),
        Pass("b_to_c", threads=COUNT),
        Step("outside", lambda _: None, reads=["c"], writes=["a"]),
    ]
    with Frame(device, [Stage("all", buffers=counts, passes=passes)], glsl_root=root) as frame:
        frame.submit()
        rows = {row.name: row.barrier for row in frame.describe()}
        assert rows == {
            "fill_a #1": "",
            "arguments": "",
            "add_to_c": "RAW arguments (arguments)",
            "a_to_b": "",  # the barrier before add_to_c has ordered fill_a
            "fill_a #2": "WAR a (a_to_b)",
            "b_to_c #1": "",
            "b_to_c #2": "WAW c (b_to_c #1)",
            "outside": "RAW c (b_to_c #2)",
        }
        np.testing.assert_array_equal(frame["arguments"]["groups"], [2, 1, 1])
        assert frame.resource("c").read(np.uint32, 1)[0] == 2 * 64, "as many workgroups as the buffer says"
        assert frame["c"].shape == (COUNT,)
        assert set(frame.timings) == set(rows)
        assert all(milliseconds >= 0 for milliseconds in frame.timings.values())
    apart = Stage("apart", buffers={"a": COUNT, "c": COUNT}, passes=[passes[0], Pass("add_to_c", threads=1)])
    with Frame(device, [apart], glsl_root=root, barrier_every_pass=True) as frame:
        frame.submit()
        assert [row.barrier for row in frame.describe()] == ["", "every pass"]


@pytest.mark.provokes_validation
def test_synchronization_validation_sees_a_missing_barrier(device, root):
    with Frame(device, [chain()], glsl_root=root) as frame:
        frame._barriers = [None] * len(frame._barriers)
        with pytest.raises(ValidationError, match=r"(?i)hazard"):
            frame.submit()


def picture_stage(width: int = 16, height: int = 16) -> Stage:
    return Stage("picture", images={"picture": History((width, height))}, passes=[Pass("accumulate", threads=256)])


def test_history_swaps_with_the_slots(device, root):
    with Frame(device, [picture_stage()], glsl_root=root) as frame:
        frame.uniforms["uniforms.gain"] = 0.5
        for number in range(1, 6):
            frame.submit()
            np.testing.assert_array_equal(frame["picture"][3, 5], [number, number * 0.5, 5 * number, 3 * number])
            np.testing.assert_array_equal(frame["previous_picture"][0, 0, 0], number - 1)
        assert frame.resource("picture") is not frame.resource("previous_picture")


def test_frames_in_flight_keep_their_own_uniforms(device, root, shaders):
    body = "if (gl_GlobalInvocationID.x == 0u) a.at[uniforms.frame] = uniforms.frame;"
    shaders.write("note", START + "void main() { " + body + " }\n")
    with Frame(device, [Stage("x", buffers={"a": 50}, passes=[Pass("note", threads=1)])], glsl_root=root) as frame:
        for number in range(50):
            frame.uniforms["uniforms.frame"] = number
            frame.submit()
        np.testing.assert_array_equal(frame["a"], np.arange(50))


def test_a_frame_in_parts_is_the_same_and_can_be_given_up(device, root, shaders, monkeypatch):
    """On a software device dispatches are divided too."""
    monkeypatch.setattr(slot, "PART_GROUPS", 2)
    body = "b.at[gl_GlobalInvocationID.y * 8u + gl_GlobalInvocationID.x] += gl_GlobalInvocationID.y + 1u;"
    rows = START.replace("local_size_x = 64", "local_size_x = 8, local_size_y = 8") + "void main() { " + body + " }\n"
    shaders.write("rows", rows)
    passes = [Pass("rows", threads=(8, 40)), Pass("rows", threads=(8, 40))]
    calls = []
    with Frame(device, [Stage("x", buffers={"b": 320}, passes=passes)], glsl_root=root) as frame:
        frame.submit()
        whole = frame["b"].copy()
        frame.between = lambda: bool(calls.append(0))
        frame.submit()
        np.testing.assert_array_equal(frame["b"], 2 * whole)
        np.testing.assert_array_equal(whole.reshape(40, 8)[:, 0], 2 * np.arange(1, 41))
        assert len(calls) == (5 if device.properties.kind == "cpu" else 1)
        frame.between = lambda: True
        count = frame.frame_count
        with pytest.raises(Interrupted):
            frame.submit()
        assert frame.frame_count == count
        frame.between = None
        frame.submit()
        assert frame["b"][-1] > 2 * whole[-1]


def test_a_frame_that_is_given_up_leaves_counters_at_zero(device, root, shaders):
    shaders.write("count", START + "void main() { atomicAdd(a.at[0], 1u); atomicAdd(b.at[0], 1u); }\n")
    shaders.write("end", START + "void main() { a.at[0] = b.at[0] = 0u; }\n")
    stage = Stage("x", buffers={"a": Counter(1), "b": 1}, passes=[Pass("count", threads=1), Pass("end", threads=1)])
    with Frame(device, [stage], glsl_root=root) as frame:
        frame.between = lambda: True
        with pytest.raises(Interrupted):
            frame.submit()
        device.submit([])  # what fills them runs before it
        assert (frame["a"][0], frame["b"][0]) == (0, 64)


def test_a_step_that_takes_long_leaves_time_for_something_else(device, root, shaders, monkeypatch):
    """Twice for each of two steps, which then are done."""
    assert device.reaches(device.submit([]), 10.0)
    assert not device.reaches(device.submitted + 1, 0.01)
    answers = iter([False, False, True] * 2)
    shaders.write("note", START + "void main() { a.at[0] = 1u; }\n")
    stage = Stage("x", buffers={"a": 50}, passes=[Pass("note", threads=1)] * 2)
    calls = []
    with Frame(device, [stage], glsl_root=root) as frame:
        frame.meanwhile = lambda: calls.append(0)
        frame.submit()
        assert not calls, "a frame that isn't in parts waits for nothing"
        frame.between = lambda: False
        monkeypatch.setattr(type(device), "reaches", lambda *_: next(answers))
        frame.submit()
        assert (len(calls), frame["a"][0]) == (4, 1)


def test_a_step_of_the_caller_has_barriers_like_a_pass(device, root):
    frame_holder: list[Frame] = []

    def fill(cmd):
        device.vk.vkCmdFillBuffer(cmd, frame_holder[0].resource("a").handle, 0, raw.VK_WHOLE_SIZE, 7)

    passes = [Pass("fill_a", threads=COUNT), Step("sevens", fill, writes=["a"]), Pass("a_to_b", threads=COUNT)]
    with Frame(device, [Stage("x", buffers={"a": COUNT, "b": COUNT}, passes=passes)], glsl_root=root) as frame:
        frame_holder.append(frame)
        frame.submit()
        assert (frame["b"] == 14).all()
        assert [row.barrier for row in frame.describe()] == ["", "WAW a (fill_a)", "RAW a (sevens)"]


def test_work_before_the_frame_is_ordered(device, root):
    buffer = device.buffer(4 * COUNT, "a")
    filling = Recorded(
        device, lambda cmd: device.vk.vkCmdFillBuffer(cmd, buffer.handle, 0, raw.VK_WHOLE_SIZE, 5), "fill a"
    )
    stage = Stage("x", buffers={"b": COUNT}, passes=[Pass("a_to_b", threads=COUNT), Pass("fill_a", threads=COUNT)])
    with Frame(device, [stage], external={"a": buffer}, glsl_root=root) as frame:
        for _ in range(3):
            frame.submit(before=[filling.commands])
        assert (frame["b"] == 10).all()
    filling.destroy()
    buffer.destroy()


# ---- layouts ----------------------------------------------------------------------------------------

LAYOUT = """#extension GL_EXT_shader_explicit_arithmetic_types : require
layout(local_size_x = 1) in;
struct Inner { vec3 position; uint64_t big; };
struct Record {
    float scalar; vec2 two; vec3 three; vec4 four; int whole; ivec3 wholes; uint number;
    mat2 m2; mat3 m3; mat4 m4; mat4x3 m43; mat2x3 m23; float list[5]; vec3 places[2]; Inner inner; Inner inners[3];
    mat3x4 transforms[2];
};
struct Small { uint8_t byte; uint16_t small; i8vec3 bytes; uint16_t last; };
layout(set = 1, binding = 0, scalar) readonly buffer RecordsBlock { uint count; Record at[]; } records;
layout(set = 1, binding = 1, scalar) buffer ResultsBlock { float at[]; } results;
layout(set = 1, binding = 2, scalar) readonly buffer SmallBlock { Small at[]; } smalls;
layout(set = 1, binding = 3, scalar) uniform UniformsBlock { Record record; } uniforms;
uint n = 0u;
void put(float x) { results.at[n++] = x; }
void put_record(Record r) {
    put(r.scalar); put(r.two.y); put(r.three.z); put(r.four.w); put(float(r.whole)); put(float(r.wholes.z));
    put(float(r.number)); put(r.m2[1][0]); put(r.m3[2][1]); put(r.m4[3][2]); put(r.m43[3][1]);
    put(r.m23[1][2]); put(r.list[4]); put(r.places[1].y); put(r.inner.position.z);
    put(float(r.inner.big)); put(r.inners[2].position.x); put(float(r.inners[1].big)); put(r.transforms[1][2][3]);
}
void main() {
    put(float(records.count)); put_record(records.at[1]); put_record(uniforms.record);
    put(float(smalls.at[1].byte)); put(float(smalls.at[1].small)); put(float(smalls.at[1].bytes.z));
    put(float(smalls.at[1].last));
}
"""


def number_fields(records: np.ndarray, first: int) -> int:
    """Set the numbers in structured records to first, first + 1, ...; returns the next number."""
    if records.dtype.names is None:
        records[...] = np.arange(first, first + records.size).reshape(records.shape)
        return first + records.size
    for name in records.dtype.names:
        first = number_fields(records[name], first)
    return first


def picked(r: np.ndarray) -> list[float]:
    """The values that put_record writes."""
    values = [
        r["scalar"],
        r["two"][1],
        r["three"][2],
        r["four"][3],
        r["whole"],
        r["wholes"][2],
        r["number"],
        r["m2"][1, 0],
        r["m3"][2, 1],
        r["m4"][3, 2],
        r["m43"][3, 1],
        r["m23"][1, 2],
        r["list"][4],
        r["places"][1, 1],
        r["inner"]["position"][2],
        r["inner"]["big"],
        r["inners"][2]["position"][0],
        r["inners"][1]["big"],
        r["transforms"][1, 2, 3],
    ]
    assert len(set(values)) == len(values)
    return [float(value) for value in values]


def test_every_member_type_arrives_in_the_shader(device, shaders):
    shaders.write("layout_check", LAYOUT)
    counts = {"records": 2, "results": 64, "smalls": 2}
    stage = Stage("layout", buffers=counts, passes=[Pass("layout_check", threads=1)])
    with Frame(device, [stage], glsl_root=shaders.root) as frame:
        block = frame.uniforms.record("uniforms")
        number_fields(block["record"], 30)
        records = np.zeros(2, block.dtype["record"])
        number_fields(records, 1000)
        smalls = np.zeros(2, frame["smalls"].dtype)
        number_fields(smalls, 3)
        frame.resource("records").upload(np.uint32(2))
        frame.resource("records").upload(records, frame.binding("records").element_offset)
        frame.resource("smalls").upload(smalls)
        frame.submit()
        small = smalls[1]
        found = frame["results"]
        expected = [
            2,
            *picked(records[1]),
            *picked(frame.uniforms["uniforms.record"]),
            small["byte"],
            small["small"],
            small["bytes"][2],
            small["last"],
        ]
        np.testing.assert_array_equal(found[: len(expected)], expected)
        np.testing.assert_array_equal(frame["records"], records)


# ---- rebuilding -------------------------------------------------------------------------------------


def test_broken_shader_leaves_the_frame_as_it_was(device, root, shaders):
    with Frame(device, [chain()], glsl_root=root) as frame:
        frame.uniforms["uniforms.frame"] = 3
        frame.submit()
        with leaves_nothing(device):
            shaders.write("a_to_b", START + "void main() { b.at[0] = nonsense; }\n")
            with pytest.raises(CompilationError, match=r"a_to_b\.comp:5: .*nonsense"):
                frame.rebuild()
            shaders.write("a_to_b", START + PASSES["a_to_b"].replace("b.at[i]", "layout_conflict"))
            with pytest.raises(SolariError):
                frame.rebuild([chain(), Stage("more", buffers={"a": 5})])
        frame.submit()
        np.testing.assert_array_equal(frame["c"], expected(3))
        shaders.write("a_to_b", START + PASSES["a_to_b"].replace("* 2u", "* 4u"))
        frame.rebuild()
        frame.submit()
        assert frame["b"][0] == (COUNT - 1 + 3) * 4, "the uniforms are kept, the shader is the new one"


def test_rebuilding_keeps_resources_uniforms_and_pipelines(device, root, monkeypatch):
    """New stages may come in, and what gets another size is made anew, zeroed."""
    created, create = [], device.vk.vkCreateComputePipelines
    monkeypatch.setattr(device.vk, "vkCreateComputePipelines", lambda *a: (created.append(1), create(*a))[1])
    with Frame(device, [chain()], glsl_root=root) as frame:
        frame.uniforms["uniforms.frame"] = 2
        frame.submit()
        kept = frame.resource("a")
        frame.rebuild([chain(), picture_stage()])
        assert frame.resource("a") is kept
        np.testing.assert_array_equal(frame["a"], np.arange(COUNT) + 2)
        for number in (1, 2):
            frame.submit()
            assert frame["picture"][0, 0, 0] == number
        np.testing.assert_array_equal(frame["c"], expected(2))
        before = len(created)
        frame.rebuild([chain(), picture_stage(20, 16)])
        assert frame.resource("a") is kept
        frame.submit()
        assert frame["picture"].shape == (16, 20, 4)
        assert frame["picture"][2, 2, 0] == 1
        assert len(created) == before


def test_bound_resource_replaced_and_destroyed_at_once(device, root):
    buffers = []
    for value in (1, 2, 3):
        buffers.append(device.buffer(4 * COUNT, f"a {value}"))
        buffers[-1].upload(np.full(COUNT, value, np.uint32))
    stage = Stage("x", buffers={"b": COUNT}, passes=[Pass("a_to_b", threads=COUNT)])
    with Frame(device, [stage], external={"a": buffers[0]}, glsl_root=root) as frame:
        frame.submit()
        frame.submit()
        for old, new in itertools.pairwise(buffers):
            frame.bind({"a": new})
            old.destroy()
            frame.submit()
        assert (frame["b"] == 6).all()
    buffers[-1].destroy()


def test_nothing_grows(device, root):
    def one_life() -> None:
        with Frame(device, [chain(), picture_stage()], glsl_root=root) as frame:
            for width in (16, 17, 16):
                frame.rebuild([chain(), picture_stage(width)])
                frame.submit()
                frame.submit()
        device.wait_idle()

    one_life()
    used = device.memory.bytes_used
    with leaves_nothing(device):
        one_life()
    assert device.memory.bytes_used == used


# ---- errors -----------------------------------------------------------------------------------------


FILL = Pass("fill_a", threads=1)


def with_a(item: Pass) -> Stage:
    return Stage("s", buffers={"a": 4}, passes=[item])


@pytest.mark.parametrize(
    ("stage", "message"),
    [
        (Stage("s", passes=[FILL]), r"a \(storage_buffer\) is used by fill_a, but no stage declares it"),
        (Stage("s", buffers={"a": 4, "q": 4}, passes=[FILL]), "stage s declares q, which none"),
        (Stage("s", buffers={"a": 0}, passes=[FILL]), "a needs a whole number of elements above 0"),
        (Stage("s", buffers={"a": 4, "b": Aliased("a", 5)}, passes=[Pass("a_to_b", 1)]), "b needs 20 bytes within a"),
        (
            Stage("s", buffers={"a": History(4), "b": Aliased("a", 1)}, passes=[Pass("a_to_b", 1)]),
            "previous_NAME of one",
        ),
        (Stage("s", buffers={"a": 4}, images={"picture": 3}, passes=[FILL]), "declares picture"),
        (Stage("s", buffers={"picture": 4}, passes=[Pass("accumulate", threads=1)]), "picture is a storage_image"),
        (Stage("s", images={"picture": History((0, 4))}, passes=[Pass("accumulate", threads=1)]), "size of picture is"),
        (Stage("s", buffers={"arguments": 2}, passes=[Pass("arguments", threads=1)]), "has no runtime array"),
        *(
            (with_a(Pass("fill_a", threads=threads)), "pass fill_a: threads are one to three")
            for threads in (0, 1.5, (64, 1.0), "64", (), (1, 1, 1, 1))
        ),
        (Stage("s", images={"picture": (16.0, 16)}, passes=[Pass("accumulate", threads=1)]), "size of picture is"),
        (with_a(Pass("fill_a", threads=(1 << 40, 1))), "workgroups, but this device runs"),
        (with_a(Pass("fill_a", threads=1, constants={"X": 1})), "constant X; those it uses"),
        (with_a(Pass("fill_a", indirect="z")), "fill_a: there is no resource z; there are a"),
        (with_a(Pass("fill_a", indirect="a", indirect_offset=8)), "fill_a: .* buffer a has 16 bytes: give .* least 20"),
        (with_a(Pass("nothing", threads=1)), r"no shader passes/nothing\.comp"),
        (Stage("s", passes=[]), "at least one pass"),
    ],
)
def test_mistakes_are_told_plainly(device, root, stage, message):
    assert device.pipeline_cache.handle  # made for the first pipelines, and kept
    with leaves_nothing(device), pytest.raises(SolariError, match=message):
        Frame(device, [stage], glsl_root=root)


def test_unknown_names_and_passes_without_a_size(device, root):
    for given in ({}, {"threads": 1, "indirect": "a"}):
        with pytest.raises(SolariError, match="give either threads or indirect"):
            Pass("x", **given)
    for offset in (1.5, -4, 2):
        with pytest.raises(SolariError, match="indirect_offset is a whole number of bytes"):
            Pass("x", indirect="a", indirect_offset=offset)
    with Frame(device, [chain()], glsl_root=root) as frame:
        with pytest.raises(SolariError, match="no resource q; there are a, b, c"):
            frame["q"]
        assert frame.timings == {}


BESIDE = """layout(set = 1, binding = 1, scalar) buffer BBlock { uint at[]; } b;
layout(set = 1, binding = 2, scalar) buffer SmallBlock { uint first, second; uint at[]; } small;
layout(local_size_x = 64) in;
void main() { uint i = gl_GlobalInvocationID.x; b.at[i] = i; small.at[i * 64] = 7u; small.at[~i] = 7u; }
"""


@pytest.mark.parametrize("robust", [None, True])
def test_a_shader_that_writes_behind_a_small_buffer_harms_nothing(shaders, robust):
    """Also where the device's shaders get buffers by their addresses, which have no end."""
    shaders.write("beside", BESIDE)
    buffers = {"b": 4096, "small": 2}
    with Device(validation=False) as device:
        stage = Stage("x", buffers=buffers, passes=[Pass("beside", threads=4096)])
        with Frame(device, [stage], glsl_root=shaders.root, robust=robust) as frame:
            frame.submit()
            assert (frame["b"].view(np.uint32) == np.arange(4096)).all()
            assert [step.pipeline.addresses for step in frame._program.steps] == [()]
        if robust:
            device.features -= {"pipelineRobustness"}
            with pytest.raises(SolariError, match="robust=True needs VK_EXT_pipeline_robustness"):
                Frame(device, [stage], glsl_root=shaders.root, robust=True)


def test_a_buffer_is_no_smaller_than_the_shader_s_block(device, shaders):
    shaders.write("beside", BESIDE)
    stage = Stage("x", buffers={"b": 4096}, passes=[Pass("beside", threads=1)])
    small = device.buffer(4, "small")
    with pytest.raises(SolariError, match="small has 4 bytes, but the shaders' block takes 8"):
        Frame(device, [stage], external={"small": small}, glsl_root=shaders.root)
    small.destroy()
