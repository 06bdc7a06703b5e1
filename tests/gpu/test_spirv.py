"""Reflection: bindings, layouts, sizes, constants, and the accesses of entry points."""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest

from solari_vk.errors import SolariError
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


@pytest.mark.parametrize("optimization", ["zero", "size", "performance"])
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
        ("a.at[0] = uint(textureGather(sampled, vec2(0.5)).x + texelFetch(many[u.value], ivec2(0), 0).x);",
         "sampled many u", "a"),
        ("rayQueryEXT q; rayQueryInitializeEXT(q, tlas, 0u, 255u, vec3(0), 0.0, vec3(1), 9.0); "
         "while (rayQueryProceedEXT(q)) {} a.at[0] = rayQueryGetIntersectionTypeEXT(q, true);", "tlas", "a"),
        ("float whole; a.at[0] = uint(modf(c.wide.x, whole)) + uint(whole);", "c", "a"),
        ("for (uint i = 0u; i < b.at[0]; i++) { uint local[4]; local[i & 3u] = i; a.at[i] = local[0]; }", "b", "a"),
        ("if (u.value > 3u) { return; } else { a.at[0] = 1u; }", "u", "a"),
    ],
)  # fmt: skip
def test_accesses(shaders, body, reads, writes, optimization):
    scoped = "atomicLoad" in body or "atomicStore" in body
    before = "#extension GL_KHR_memory_scope_semantics : require\n" if scoped else ""
    main = module(shaders, "void main() {" + body + "}\n", optimization, before).main
    assert main.reads == set(reads.split())
    assert main.writes == set(writes.split())


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
        ("uint n = twice(3u); put(0u, n);", "", "a"),
        ("put(0u, c.total);", "c", "a c"),
        ("rayQueryEXT query; start(tlas, query); a.at[0] = uint(rayQueryProceedEXT(query));", "tlas", "a"),
        ("a.at[0] = uint(look(sampled).x + look(many[1]).y);", "sampled many", "a"),
        ("Big big = copy(); big.x[1] = 3u; a.at[0] = big.x[u.value];", "c u", "a"),
    ],
)
def test_accesses_through_functions(shaders, body, reads, writes, optimization):
    main = module(shaders, FUNCTIONS + "void main() {" + body + "}\n", optimization).main
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


def test_kinds_counts_and_formats(shaders):
    # The compiler replaces an array without a length by one with a length, unless a variable indexes it.
    found = module(shaders, "void main() { a.at[0] = uint(texture(many[u.value], vec2(0)).x); }\n", "zero").bindings
    kinds = {name: (binding.kind, binding.count) for name, binding in found.items()}
    assert kinds == {
        "a": ("storage_buffer", 1), "b": ("storage_buffer", 1), "c": ("storage_buffer", 1), "D": ("storage_buffer", 1),
        "u": ("uniform_buffer", 1), "image": ("storage_image", 1), "sampled": ("combined_image_sampler", 1),
        "many": ("combined_image_sampler", 0), "tlas": ("acceleration_structure", 1),
    }  # fmt: skip
    assert found["image"].image_format == "R32_UINT"
    assert (found["u"].set, found["u"].binding) == (1, 6)
    c = found["c"]
    assert c.dtype is not None
    assert (c.dtype.names, c.dtype.itemsize, c.element, c.element_offset) == (("total", "wide"), 20, np.dtype("u4"), 20)
    assert c.size_bytes(10) == 60


def test_readonly_and_writeonly(shaders):
    declared = """
layout(set = 0, binding = 0, scalar) readonly buffer R { uint at[]; } r;
layout(set = 0, binding = 1, r32f) writeonly uniform image2D w;
"""
    found = module(shaders, declared + "void main() {}\n", "zero").bindings
    assert (found["r"].readonly, found["r"].writeonly) == (True, False)
    assert (found["w"].readonly, found["w"].writeonly) == (False, True)
    assert not found["a"].readonly


def test_block_layouts(shaders):
    declared = """
layout(buffer_reference, scalar) readonly buffer Items { uint at[]; };
struct Inner { vec3 position; uint8_t byte; double big; };
struct Outer {
    uint first; Inner inner; mat4x3 rows; mat3 square; vec2 pairs[3]; Inner many[2]; Items items; i16vec3 s;
};
layout(set = 0, binding = 0, scalar) buffer O { Outer at[]; } outer;
"""
    element = module(shaders, declared + "void main() {}\n", "zero").bindings["outer"].element
    inner = np.dtype({"names": ["position", "byte", "big"], "formats": [("f4", 3), "u1", "f8"],
                      "offsets": [0, 12, 16], "itemsize": 24})  # fmt: skip
    assert element is not None
    assert {name: element.fields[name][0] for name in element.names} == {
        "first": np.dtype("u4"), "inner": inner, "rows": np.dtype(("f4", (4, 3))), "square": np.dtype(("f4", (3, 3))),
        "pairs": np.dtype(("f4", (3, 2))), "many": np.dtype((inner, (2,))), "items": np.dtype("u8"),
        "s": np.dtype(("i2", (3,))),
    }  # fmt: skip
    assert [element.fields[name][1] for name in element.names] == [0, 8, 32, 80, 116, 144, 192, 200]
    assert element.itemsize == 208


@pytest.mark.parametrize("layout", ["std140", "std430"])
def test_other_layouts_are_refused(shaders, layout):
    declared = f"layout(set = 0, binding = 0, {layout}) buffer O {{ vec3 at[]; }} outer;\n"
    with pytest.raises(SolariError, match=r"demo: .*outer.*layout\(scalar\)"):
        module(shaders, declared + "void main() {}\n", "zero")
    declared = f"layout(set = 0, binding = 0, {layout}) buffer O {{ mat3 m; }} outer;\n"
    with pytest.raises(SolariError, match=r"outer\.m must be column-major in a layout\(scalar\)"):
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
    assert constants == {
        "FLAG": (0, "u4", True), "COUNT": (1, "i4", -4), "SCALE": (2, "f4", 1.5), "ROWS": (3, "u4", 4),
    }  # fmt: skip
    assert found.local_size() in {(8, 1, 2), (8, 4, 2)}
    assert found.local_size({"ROWS": 16}) == (8, 16, 2)
    assert module(shaders, "void main() { a.at[0] = 1u; }\n").local_size() == (8, 1, 1)


def test_stages(shaders):
    shaders.write("x.frag", "#version 460\nlayout(location = 0) out vec4 color;\nvoid main() { color = vec4(1); }\n")
    assert reflect(compile_shader("x.frag", root=shaders.root)).main.stage == "frag"


def test_data_in_shader_records_are_refused(shaders):
    shaders.write("x.rchit", """#version 460
#extension GL_EXT_ray_tracing : require
layout(location = 0) rayPayloadInEXT uint found;
layout(shaderRecordEXT) buffer RecordBlock { uint value; } record;
void main() { found = record.value; }
""")
    with pytest.raises(SolariError, match=r"^x: shaderRecordEXT: records .* hold no data: read a buffer"):
        reflect(compile_shader("x.rchit", root=shaders.root), "x")


def test_stripped_and_damaged_modules(shaders):
    spirv = module(shaders, FUNCTIONS + "void main() { put(0u, c.total); }\n", "zero").spirv
    with pytest.raises(SolariError, match="not a SPIR-V module"):
        reflect(b"nonsense, and long enough for a header", "x")
    words = np.frombuffer(spirv, np.uint32)
    chooser = random.Random(1)
    for _ in range(300):
        damaged = words.copy()
        if chooser.random() < 0.3:
            damaged = damaged[: chooser.randrange(len(words))]
        else:
            damaged[chooser.randrange(5, len(words))] = chooser.getrandbits(32) >> chooser.choice([0, 16, 28])
        with contextlib.suppress(SolariError):
            reflect(damaged.tobytes(), "x")
