"""Reflection: bindings, layouts, sizes, constants, and the accesses of entry points."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shader_folder import ShaderFolder

from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders.compiler import compile_into_spirv, compile_shader
from solari_vk.gpu.shaders.spirv import Module, reflect

EXTENSIONS = """#extension GL_EXT_buffer_reference2 : require
#extension GL_EXT_shader_explicit_arithmetic_types : require
#extension GL_EXT_nonuniform_qualifier : require
#extension GL_EXT_ray_query : require
"""
BLOCKS = """layout(local_size_x = 8) in;
layout(set = 1, binding = 0, scalar) buffer A { uint at[]; } a;
layout(set = 1, binding = 1, scalar) buffer B { uint at[]; } b;
layout(set = 1, binding = 2, scalar) buffer C { uint total; vec4 wide; uint at[]; } c;
layout(set = 1, binding = 3, r32ui) uniform uimage2D image;
layout(set = 1, binding = 4) uniform sampler2D sampled;
layout(set = 1, binding = 5) uniform accelerationStructureEXT tlas;
layout(set = 1, binding = 6, scalar) uniform U { uint value; } u;
layout(set = 1, binding = 7, scalar) buffer D { uint at[]; };
layout(set = 1, binding = 8) uniform sampler2D many[];
"""


def module(shaders, body: str, optimization: str = "performance", before: str = "") -> Module:
    path = shaders.write("demo", EXTENSIONS + BLOCKS + before + body)
    return reflect(compile_into_spirv(path.read_bytes(), "comp", str(path), optimization=optimization), "demo")


FUNCTIONS = """
uint twice(uint x) { return 2u * x; }
void put(uint at, inout uint counter) { counter += 1u; a.at[at] = counter; }
void start(accelerationStructureEXT world, rayQueryEXT query) {
    rayQueryInitializeEXT(query, world, 0u, 255u, vec3(0), 0.0, vec3(1), 9.0);
}
vec4 look(sampler2D t) { return textureLod(t, vec2(0), 0.0); }
void never() { b.at[0] = 1u; }
struct Big { uint x[4]; };
Big copy() { Big big; for (int i = 0; i < 4; i++) big.x[i] = c.at[i]; return big; }
"""


@pytest.mark.parametrize("optimization", ["zero", "performance"])
@pytest.mark.parametrize(
    ("body", "reads", "writes"),
    [
        ("a.at[0] = 1u;", "", "a"),
        ("a.at[0] = b.at[1];", "b", "a"),
        ("a.at[0] += 1u;", "a", "a"),
        ("a.at[a.at.length() - 1] = 0u;", "", "a"),
        ("a.at[0] = atomicAdd(b.at[1], 2u);", "b", "a b"),
        ("a.at[0] = atomicLoad(b.at[1], 1, 0, 0);", "b", "a"),
        ("atomicStore(a.at[1], 3u, 1, 0, 0);", "", "a"),
        ("atomicMax(c.total, u.value);", "c u", "c"),
        ("c.wide.y = 1.0;", "", "c"),
        ("at[3] = c.at[2];", "c", "D"),
        ("imageStore(image, ivec2(0), uvec4(1));", "", "image"),
        ("a.at[0] = imageLoad(image, ivec2(0)).x;", "image", "a"),
        ("imageAtomicMax(image, ivec2(0), 3u);", "image", "image"),
        ("a.at[0] = uint(imageSize(image).x + textureSize(sampled, 0).x);", "", "a"),
        ("a.at[0] = uint(textureLod(sampled, vec2(0.5), 0.0).x);", "sampled", "a"),
        (
            "a.at[0] = uint(textureGather(sampled, vec2(0.5)).x + texelFetch(many[u.value], ivec2(0), 0).x);",
            "sampled many u",
            "a",
        ),
        (
            "rayQueryEXT q; rayQueryInitializeEXT(q, tlas, 0u, 255u, vec3(0), 0.0, vec3(1), 9.0); "
            "while (rayQueryProceedEXT(q)) {} a.at[0] = rayQueryGetIntersectionTypeEXT(q, true);",
            "tlas",
            "a",
        ),
        ("float whole; a.at[0] = uint(modf(c.wide.x, whole)) + uint(whole);", "c", "a"),
        ("for (uint i = 0u; i < b.at[0]; i++) { uint local[4]; local[i & 3u] = i; a.at[i] = local[0]; }", "b", "a"),
        ("if (u.value > 3u) { return; } else { a.at[0] = 1u; }", "u", "a"),
        ("uint n = twice(3u); put(0u, n);", "", "a"),
        ("put(0u, c.total);", "c", "a c"),
        ("rayQueryEXT query; start(tlas, query); a.at[0] = uint(rayQueryProceedEXT(query));", "tlas", "a"),
        ("a.at[0] = uint(look(sampled).x + look(many[1]).y);", "sampled many", "a"),
        ("Big big = copy(); big.x[1] = 3u; a.at[0] = big.x[u.value];", "c u", "a"),
    ],
)
def test_accesses(shaders, body, reads, writes, optimization):
    scoped = "atomicLoad" in body or "atomicStore" in body
    before = "#extension GL_KHR_memory_scope_semantics : require\n" if scoped else ""
    main = module(shaders, FUNCTIONS + "void main() {" + body + "}\n", optimization, before).main
    assert main.reads == set(reads.split())
    assert main.writes == set(writes.split())


def test_used_but_not_read(shaders):
    main = module(shaders, "void main() { a.at[b.at.length()] = uint(imageSize(image).x); }\n").main
    assert main.uses == {"a", "b", "image"}
    assert main.reads == set()


REFERENCE = "layout(buffer_reference, scalar) {} buffer Items {{ uint at[]; }};\n"


def test_reads_through_a_reference_are_free_and_writes_refused(shaders):
    reads = "layout(set = 0, binding = 0, scalar) readonly buffer M { Items items[]; } meshes;\n"
    body = "void main() { a.at[0] = meshes.items[1].at[2]; }\n"
    main = module(shaders, reads + body, before=REFERENCE.format("readonly")).main
    assert main.reads == {"meshes"}
    assert main.writes == {"a"}
    for write in ("meshes.items[1].at[2] = 1u;", "atomicAdd(Items(uint64_t(c.total)).at[0], 1u);"):
        with pytest.raises(SolariError, match="demo: writes through a buffer_reference"):
            module(shaders, reads + "void main() {" + write + "}\n", before=REFERENCE.format(""))


def test_kinds_counts_formats_and_access(shaders):
    # The compiler replaces an array without a length by one with a length, unless a variable indexes it.
    declared = """
layout(set = 0, binding = 0, scalar) readonly buffer R { uint at[]; } r;
layout(set = 0, binding = 1, r32f) writeonly uniform image2D w;
"""
    body = declared + "void main() { a.at[0] = uint(texture(many[u.value], vec2(0)).x); }\n"
    found = module(shaders, body, "zero").bindings
    access = {name: (found[name].readonly, found[name].writeonly) for name in "arw"}
    assert access == {"a": (False, False), "r": (True, False), "w": (False, True)}
    kinds = {name: (binding.kind, binding.count) for name, binding in found.items()}
    assert kinds == {
        "a": ("storage_buffer", 1),
        "b": ("storage_buffer", 1),
        "c": ("storage_buffer", 1),
        "D": ("storage_buffer", 1),
        "u": ("uniform_buffer", 1),
        "image": ("storage_image", 1),
        "sampled": ("combined_image_sampler", 1),
        "many": ("combined_image_sampler", 0),
        "tlas": ("acceleration_structure", 1),
        "r": ("storage_buffer", 1),
        "w": ("storage_image", 1),
    }
    assert found["image"].image_format == "R32_UINT"
    assert (found["u"].set, found["u"].binding) == (1, 6)
    c = found["c"]
    assert c.dtype is not None
    assert (c.dtype.names, c.dtype.itemsize, c.element, c.element_offset) == (("total", "wide"), 20, np.dtype("u4"), 20)
    assert c.size_bytes(10) == 60


@pytest.mark.parametrize(
    ("layout", "member", "message"),
    [
        ("std140", "vec3 at[];", r"demo: .*outer.*layout\(scalar\)"),
        ("std430", "mat3 m;", r"outer\.m must be column-major in a layout\(scalar\)"),
    ],
)
def test_other_layouts_are_refused(shaders, layout, member, message):
    declared = f"layout(set = 0, binding = 0, {layout}) buffer O {{ {member} }} outer;\n"
    with pytest.raises(SolariError, match=message):
        module(shaders, declared + "void main() {}\n", "zero")


def test_constants_and_workgroup_size(shaders):
    declared = """
layout(local_size_y_id = 3, local_size_z = 2) in;
layout(constant_id = 0) const bool FLAG = true;
layout(constant_id = 1) const int COUNT = -4;
layout(constant_id = 2) const float SCALE = 1.5;
layout(constant_id = 3) const uint ROWS = 4;
void main() { if (FLAG) a.at[uint(COUNT)] = uint(SCALE) * ROWS; }
"""
    found = module(shaders, declared)
    constants = {name: (c.id, c.dtype.str[1:], c.default) for name, c in found.constants.items()}
    assert constants == {"FLAG": (0, "u4", True), "COUNT": (1, "i4", -4), "SCALE": (2, "f4", 1.5), "ROWS": (3, "u4", 4)}
    assert found.local_size() in {(8, 1, 2), (8, 4, 2)}
    assert found.local_size({"ROWS": 16}) == (8, 16, 2)
    assert module(shaders, "void main() { a.at[0] = 1u; }\n").local_size() == (8, 1, 1)


RECORD = """#version 460
#extension GL_EXT_ray_tracing : require
layout(location = 0) rayPayloadInEXT uint found;
layout(shaderRecordEXT) buffer RecordBlock { uint value; } record;
void main() { found = record.value; }
"""


def test_data_in_shader_records_are_refused(shaders):
    shaders.write("x.rchit", RECORD)
    with pytest.raises(SolariError, match=r"^x: shaderRecordEXT: records .* hold no data: read a buffer"):
        reflect(compile_shader("x.rchit", root=shaders.root), "x")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = ShaderFolder(tmp_path_factory.mktemp("whole"))
    return module(folder, FUNCTIONS + "void main() { put(0u, c.total); }\n", "zero")


WORDS = st.integers(0, 2**32 - 1) | st.integers(0, 2**16 - 1) | st.integers(0, 15)


@given(st.integers(5, 1999), WORDS, st.none() | st.integers(0, 1999))
@settings(max_examples=300)
def test_damaged_modules_are_read_or_refused(whole, place, word, end):
    words = np.frombuffer(whole.spirv, np.uint32).copy()
    words[place % len(words)] = word
    with contextlib.suppress(SolariError):
        reflect(words[: None if end is None else end % len(words)].tobytes(), "x")
    with pytest.raises(SolariError, match="not a SPIR-V module"):
        reflect(b"nonsense, and long enough for a header", "x")
