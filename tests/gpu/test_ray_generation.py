"""Compute shaders that trace are compiled as ray generation shaders, and no other module asks for ray queries."""

from __future__ import annotations

import re

import pytest
from shader_folder import ShaderFolder, check_spirv
from support.seeded_bugs import Bug, seeded

from solari_vk.base.errors import CompilationError, SolariError
from solari_vk.gpu.shaders import ray_generation, shaderc, spv
from solari_vk.gpu.shaders.compiler import compile_shader, glsl_root
from solari_vk.gpu.shaders.spirv import reflect

PATHS = sorted(
    path.relative_to(glsl_root()).as_posix()
    for path in glsl_root().rglob("*")
    if path.suffix.lstrip(".") in shaderc.STAGES
)
OWN_QUERIES = {
    path
    for path in PATHS
    if re.match(r"passes/conformance/(discarded|positions|probe|probe_debug|trace)\.(comp|frag)", path)
}
# Ray flags: opaque; opaque and terminate on the first hit; opaque and cull back faces.
CLOSEST = 0x1
ANY = 0x5
FRONT = 0x11
VISIBILITY = 0xD  # opaque, terminate on the first hit, skip the closest-hit shader
TRACE_RAY = 4445
SPEC_CONSTANT_FALSE = 49
SPEC_CONSTANT_OP = 52
SELECT = 169
BITWISE_OR = 197

START = """#include "scene/trace.glsl"
layout(
    local_size_x = 64
) in;
layout(set = 1, binding = 0, scalar) buffer OutBlock { float at[]; } found;
"""
HIT = "trace_closest_hit(vec3(0), 0.0, vec3(0, 0, 1), 1.0, TRACE_BOTH_FACES).t"


def module(shaders: ShaderFolder, body: str, name: str = "passes/x.comp", start: str = START, **options: str) -> bytes:
    shaders.write(name, "#version 460\n#extension GL_EXT_scalar_block_layout : require\n" + start + body)
    return compile_shader(name, root=shaders.root, rays="pipeline", **options)


def traced_flags(spirv: bytes) -> set[int | None]:
    """The flags of all rays that a module traces in scenes without features; None for flags that are no constant."""
    constants, found = {}, set()
    for words in spv.instructions(spirv):
        if words[0] == 4 << 16 | 43:  # OpConstant of one word
            constants[int(words[2])] = int(words[3])
        if words[0] & 0xFFFF == SPEC_CONSTANT_FALSE:
            constants[int(words[2])] = 0
        if words[0] & 0xFFFF == SPEC_CONSTANT_OP:
            result, op, *operands = (int(word) for word in words[2:])
            values = [constants.get(operand) for operand in operands]
            if op == SELECT and values[0] is not None:
                constants[result] = values[1] if values[0] else values[2]
            if op == BITWISE_OR:
                constants[result] = values[0] | values[1]
        if words[0] & 0xFFFF == TRACE_RAY:
            found.add(constants.get(int(words[2])))
    return found


@pytest.mark.parametrize("path", sorted(set(PATHS) - OWN_QUERIES))
def test_modules_of_both_ways(path: str) -> None:
    """Valid and readable; one that traces by queries is a ray generation shader by pipelines, others are equal."""
    queries, pipelines, compute = (compile_shader(path, rays=way) for way in ("query", "pipeline", "compute"))
    check_spirv(queries, path)
    module = reflect(
        queries, path, writes_by_address=path.startswith(("scene/deform", "scene/tensors/", "scene/trees/"))
    )
    assert module.main.stage == path.rpartition(".")[2]
    assert not ray_generation.uses_ray_queries(pipelines)
    if not ray_generation.uses_ray_queries(queries):
        assert queries == pipelines == compute
        return
    check_spirv(compute, path)
    assert not ray_generation.uses_ray_queries(compute)
    assert reflect(compute, path).main.stage == "comp"
    check_spirv(pipelines, path)
    assert reflect(pipelines, path).main.stage == "rgen"
    assert traced_flags(pipelines) or path == "passes/layout.comp"  # which only declares
    assert traced_flags(pipelines) <= {CLOSEST, FRONT, VISIBILITY, None}


def test_some_modules_trace() -> None:
    assert sum(ray_generation.uses_ray_queries(compile_shader(path)) for path in set(PATHS) - OWN_QUERIES) > 10


@pytest.mark.parametrize("path", sorted(OWN_QUERIES))
def test_queries_of_a_shader_s_own_are_refused(path: str) -> None:
    check_spirv(compile_shader(path), path)
    for way in ("pipeline", "compute"):
        with pytest.raises(
            SolariError, match=rf"^{path}: .*VK_KHR_ray_query, opened with rays='query'.*scene/trace.glsl"
        ):
            compile_shader(path, rays=way)


def test_queries_beside_trace_are_refused_too(shaders: ShaderFolder) -> None:
    body = (
        "void main() { rayQueryEXT q; rayQueryInitializeEXT(q, tlas, 0, 1, vec3(0), 0.0, vec3(1), 1.0);\n"
        "found.at[0] = float(rayQueryProceedEXT(q)) + " + HIT + "; }\n"
    )
    with pytest.raises(SolariError, match=r"^passes/x.comp: it has ray queries of its own"):
        module(shaders, body, start="#extension GL_EXT_ray_query : require\n" + START)


def test_flags_of_visibility_rays_are_seen() -> None:
    path = "passes/reference/trace_wave.comp"
    assert VISIBILITY in traced_flags(compile_shader(path, rays="pipeline"))
    for changed, left in (("gl_RayFlagsSkipClosestHitShaderEXT", 0x8), ("TRACE_ANY_HIT", ANY)):
        with seeded(Bug("scene/trace.glsl", "flags", changed)):
            found = traced_flags(compile_shader(path, rays="pipeline"))
            assert left in found
            assert VISIBILITY not in found


def test_only_what_traces_becomes_a_ray_generation_shader(shaders: ShaderFolder) -> None:
    traces = reflect(module(shaders, "void main() { found.at[INVOCATION_INDEX.x] = " + HIT + "; }\n"))
    assert (traces.main.stage, traces.local_size()) == ("rgen", (1, 1, 1))
    spirv = module(shaders, "void main() { found.at[gl_GlobalInvocationID.x] = 1.0; }\n")
    assert (reflect(spirv).main.stage, reflect(spirv).local_size()) == ("comp", (64, 1, 1))
    assert not ray_generation.uses_ray_queries(spirv)
    assert b"SPV_KHR_ray_query" not in spirv
    assert compile_shader("passes/x.comp", root=shaders.root) == spirv
    body = "layout(location = 0) out vec4 color;\nvoid main() { color = vec4(" + HIT + "); }\n"
    with pytest.raises(SolariError, match=r"^passes/x\.frag: it has ray queries of its own"):
        module(shaders, body, "passes/x.frag", '#include "scene/trace.glsl"\n')


@pytest.mark.parametrize(
    ("body", "size", "message"),
    [
        ("void main() { found.at[gl_GlobalInvocationID.x] = HIT; }", "", r"x\.comp:9: .*gl_GlobalInvocationID"),
        ("void main() { found.at[0] = HIT; }", "layout(local_size_y = 2) in;", r"size\.glsl:1: .*local_size"),
        ("shared uint n;\nvoid main() { n = 1u; found.at[n] = HIT; }", "", r"x\.comp:9: .*shared"),
    ],
)
def test_what_only_compute_shaders_have_is_refused(shaders: ShaderFolder, body: str, size: str, message: str) -> None:
    shaders.write("size.glsl", size + "\n")
    hint = r"^passes/x\.comp: it traces rays(.|\n)*INVOCATION_INDEX(.|\n)*local size(.|\n)*"
    with pytest.raises(CompilationError, match=hint + message):
        module(shaders, body.replace("HIT", HIT) + "\n", start='#include "size.glsl"\n' + START)
    assert reflect(compile_shader("passes/x.comp", root=shaders.root)).main.stage == "comp"


@pytest.mark.parametrize(("body", "line"), [("nonsense", 8), ("#ifdef RAY_PIPELINES\nnonsense\n#endif", 9)])
def test_errors_name_the_line(shaders: ShaderFolder, body: str, line: int) -> None:
    body += "\nvoid main() { found.at[0] = " + HIT + "; }\n"
    with pytest.raises(CompilationError, match=rf"x\.comp:{line}: error.*\n    nonsense"):
        module(shaders, body, header="const float SCALE = 2.0;")
