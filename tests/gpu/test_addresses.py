"""Buffers that shaders access by address on software devices: the same values, valid modules, little to compile."""

from __future__ import annotations

from collections import Counter
from functools import cache

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.gpu.frame import interface
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.addresses import access_by_address, addressable
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.gpu.shaders.spv import instructions
from solari_vk.gpu.shaders.whole_vectors import with_whole_vectors
from tests.gpu.shader_folder import check_spirv

SHADER = """
#extension GL_EXT_buffer_reference : require
layout(local_size_x = 8) in;
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Floats { float at[]; };
struct Inner { vec2 pair; uint more[3]; };
struct Record { mat2x3 turn; Inner inner; Floats floats; };
layout(set = 0, scalar) readonly buffer RecordsBlock { uint first; Record at[]; } records;
layout(set = 0, scalar) readonly buffer LooseBlock { vec3 at[]; } loose;
layout(set = 1, scalar) buffer OutputsBlock { vec3 at[]; } outputs;
layout(set = 1, scalar) buffer CopiesBlock { Inner at[]; } copies;
layout(set = 1, scalar) buffer CountsBlock { uint at[]; } counts;
vec3 turned(uint i, float scale) { return scale * (records.at[i].turn * records.at[i].inner.pair); }
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= outputs.at.length()) { return; }
    Record record = records.at[i];
    vec3 value = turned(i, 2.0) + loose.at[record.inner.more[records.first]];
    for (uint j = 0u; j < 3u; j++) { value += record.floats.at[j]; }
    outputs.at[i] = value;
    outputs.at[i].y += 1.0;
    copies.at[i] = record.inner;
    atomicAdd(counts.at[0], record.inner.more[1]);
}
"""
COUNT = 21
# What the frame of cornell_box has: instructions once functions are inlined, of all passes and of the largest, and
# accesses of buffers by descriptor. A driver's compiler takes time for each. A change that raises them says why. The
# fill of the world cache has three, which insert cells and list them; the list of pixels at edges has one. Strata of
# pixels have 5,500 instructions.
REALTIME = 160_500, 34_000, 49
# Instructions of modules for scenes with any features. One place for each lobe, light sample and ray counts most. Those
# of paths/ may store what they have chosen, and first rays of upscaled frames find whose turn it is; the cache's finds
# the solid in which paths start by a ray of its own.
WITH_FEATURES = {
    "passes/paths/first_ray.comp": 139_600,
    "passes/paths/later_rays.comp": 117_200,
    "passes/world_cache/sample.comp": 119_000,
    "passes/reference/shade_wave.comp": 32_000,  # light strata have 800
}


def compiled(shaders):
    shaders.write("x", SHADER)
    return reflect(compile_shader("passes/x.comp", root=shaders.root), "x")


@pytest.mark.parametrize("most", [1, 32])
def test_modules_stay_valid(shaders, most):
    module = compiled(shaders)
    spirv, names = access_by_address(module.spirv, tuple(module.variables.items()), most)
    check_spirv(spirv, "x")
    # a buffer with an atomic operation keeps its descriptor
    assert list(names) == ["copies", "loose", "outputs", "records"][:most]
    # and one whose length is asked for needs it besides
    assert addressable(module.spirv, tuple(module.variables.items())) == {"copies", "loose", "records"}


def test_shaders_compute_the_same(shaders, any_device, monkeypatch):
    """Under validation, which finds no fault but missing barriers."""
    monkeypatch.setenv("SOLARI_VK_ADDRESSES", "1")
    module = compiled(shaders)
    rng = np.random.default_rng(1)
    floats = rng.random(COUNT + 3, np.float32)
    records = np.zeros(COUNT, module.bindings["records"].element)
    loose = rng.random((COUNT, 3), np.float32)
    with sv.Device(validation=True) as device:
        made = {"floats": floats, "loose": loose}
        buffers = {name: device.buffer(values.nbytes, name) for name, values in made.items()}
        for name, values in made.items():
            buffers[name].upload(values)
        words = records.view(np.uint32).reshape(COUNT, -1)
        words[:, :8] = rng.random((COUNT, 8), np.float32).view(np.uint32)  # turn, pair
        words[:, 8:11] = rng.integers(0, COUNT, (COUNT, 3))
        addresses = buffers["floats"].address + 4 * np.arange(COUNT, dtype=np.uint64)
        words[:, -2:] = addresses.view(np.uint32).reshape(COUNT, 2)
        head = module.bindings["records"].element_offset
        whole = np.concatenate([np.full(head // 4, 2, np.uint32), words.ravel()])
        buffers["records"] = device.buffer(whole.nbytes, "records")
        buffers["records"].upload(whole)
        stage = Stage("s", buffers={"outputs": COUNT, "copies": COUNT, "counts": 1}, passes=[Pass("x", threads=COUNT)])
        external = {name: buffers[name] for name in ("records", "loose")}
        with Frame(device, [stage], external=external, glsl_root=shaders.root, robust=False) as frame:
            frame.submit()
            results = [frame[name].copy() for name in ("outputs", "copies", "counts")]
        for buffer in buffers.values():
            buffer.destroy()
    numbers = words[:, :8].copy().view(np.float32)
    turns, pairs = numbers[:, :6].reshape(COUNT, 2, 3), numbers[:, 6:]
    expected = 2 * np.einsum("nij,ni->nj", turns, pairs) + loose[words[:, 10]]
    expected += (floats[:COUNT] + floats[1 : COUNT + 1] + floats[2 : COUNT + 2])[:, None]
    np.testing.assert_allclose(results[0].view(np.float32).reshape(COUNT, 3), expected + np.array([0, 1, 0]), rtol=1e-5)
    np.testing.assert_array_equal(np.frombuffer(results[1].tobytes(), np.uint32).reshape(COUNT, 5), words[:, 6:11])
    assert results[2].view(np.uint32)[0] == words[:, 9].sum()


def inlined(spirv: bytes) -> int:
    """How many instructions the entry point has once all functions are inlined, as drivers do."""
    sizes = Counter[int]()
    calls = dict[int, list[int]]()
    current = 0
    for words in instructions(spirv):
        op = int(words[0]) & 0xFFFF
        if op == 15:  # OpEntryPoint
            main = int(words[2])
        elif op == 54:  # OpFunction
            current = int(words[2])
            calls[current] = []
        sizes[current] += 1
        if op == 57:  # OpFunctionCall
            calls[current].append(int(words[3]))

    @cache
    def of(function: int) -> int:
        return sizes[function] + sum(of(called) for called in calls[function])

    return of(main)


def bound_accesses(spirv: bytes) -> int:
    """How many access chains start at a storage buffer that is bound by a descriptor."""
    listed = list(instructions(spirv))
    bound = {words[2] for words in listed if words[0] & 0xFFFF == 59 and words[3] == 12}  # OpVariable, StorageBuffer
    return sum(words[0] & 0xFFFF in (65, 66) and words[3] in bound for words in listed)


def picture(device, scene):
    with sv.PathTracer(device, scene, (24, 16)) as tracer:
        return tracer.render(samples=2)["radiance"]


def frames(device, scene):
    with sv.Renderer(device, scene, (24, 16)) as renderer:
        return [renderer.render()["radiance"].copy() for _ in range(3)]


@pytest.mark.parametrize(
    ("pictures", "name"),
    [
        (picture, "cornell_box"),
        *(pytest.param(frames, name, marks=pytest.mark.slow) for name in ("cornell_box", "sphere_grid")),
    ],
)
def test_pictures_are_the_same(device, pictures, name):
    """Those of a device under validation, whose shaders have bound buffers, bit by bit."""
    with sv.Device(validation=False) as other:
        if not other.buffers_by_address:
            pytest.skip("other devices have buffers by descriptors")
        np.testing.assert_array_equal(pictures(other, sv.builtin(name)), pictures(device, sv.builtin(name)))


def test_a_realtime_frame_is_little_to_compile(any_device, monkeypatch):
    seen: dict[bytes, bytes] = {}

    def note(spirv, buffers, most):
        seen[spirv], names = access_by_address(spirv, buffers, most)
        return seen[spirv], names

    monkeypatch.setattr(interface, "access_by_address", note)
    with sv.Device(validation=False) as device:
        if not device.buffers_by_address:
            pytest.skip("other devices have buffers by descriptors")
        with sv.Renderer(device, sv.builtin("cornell_box"), (16, 16)):
            pass
    for number, spirv in enumerate(seen.values()):
        check_spirv(spirv, f"module {number}")
    sizes = [inlined(spirv) for spirv in seen.values()]
    found = sum(sizes), max(sizes), sum(map(bound_accesses, seen.values()))
    assert all(have <= allowed for have, allowed in zip(found, REALTIME, strict=True)), found


@pytest.mark.parametrize("path", WITH_FEATURES)
def test_modules_with_features_are_no_more_to_compile(path):
    assert inlined(compile_shader(path)) <= WITH_FEATURES[path]


COMPONENTS = """layout(local_size_x = 1) in;
struct Thing { vec2 size; mat4x3 axes; vec3 names[2]; };
layout(set = 0, scalar) readonly buffer ThingsBlock { Thing at[]; } things;
layout(set = 1, scalar) buffer SumsBlock { float at[]; } sums;
void main() {
    uint i = gl_GlobalInvocationID.x;
    sums.at[0] = things.at[i].size.y + things.at[i].axes[3].z + things.at[i].names[i][i] + things.at[i].size.x;
}
"""


def test_vectors_are_loaded_whole(shaders):
    """As Mesa 22.3 needs it. The pictures of tests/bound/test_texel_buffers.py have such modules."""
    shaders.write("components", COMPONENTS)
    spirv = compile_shader("passes/components.comp", root=shaders.root)
    counts = []
    for code in (spirv, with_whole_vectors(spirv)):
        check_spirv(code, "components")
        listed = list(instructions(code))
        scalar = next(words[1] for words in listed if spv.opcode(words) == spv.OP_TYPE_FLOAT)
        loads = [words[1] for words in listed if spv.opcode(words) == spv.OP_LOAD]
        counts.append((loads.count(scalar), len(loads)))
    assert counts[0][0] == 4
    assert counts[1] == (0, counts[0][1])
