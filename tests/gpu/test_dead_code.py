"""What reflection, layouts and drivers see of a module: all that its entry point reaches, and nothing else."""

import re
import subprocess

import pytest

from solari_vk.gpu.shaders import shaderc
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.dead_code import without_dead_code, without_texts
from solari_vk.gpu.shaders.specialized import specialized
from solari_vk.gpu.shaders.spirv import reflect
from tests.gpu.shader_folder import ShaderFolder, check_spirv

SHADER = """#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_ray_query : require
layout(local_size_x = 1) in;
layout(constant_id = 3) const uint COUNT = 2u;
layout(constant_id = 4) const uint ABSENT = 2u;
struct Inner { vec2 pair; float weight; };
layout(buffer_reference, scalar) readonly buffer Later;
layout(buffer_reference, scalar) readonly buffer Later { Later next; Inner at[]; };
layout(set = 1, binding = 0, scalar) buffer Kept { float at[]; } kept;
layout(set = 1, binding = 1, scalar) buffer Read { Later first; } start;
layout(set = 1, binding = 2, scalar) buffer Gone { vec4 at[]; } gone;
layout(set = 1, binding = 3, r32f) uniform image2D gone_image;
layout(set = 1, binding = 4) uniform accelerationStructureEXT gone_tlas;
float exact(float a, float b) { precise float sum = a * b + 1.0; return sum; }
float deeper(const Later later) { return exact(later.at[COUNT].weight, later.next.at[0].pair.y); }
float dead_end() {
    precise float sum = gone.at[0].x * 2.0 + float(ABSENT);
    imageStore(gone_image, ivec2(0), vec4(sum));
    rayQueryEXT query;
    rayQueryInitializeEXT(query, gone_tlas, 0u, 1u, vec3(0.0), 0.0, vec3(1.0), 1.0);
    return float(rayQueryProceedEXT(query));
}
float dead() { return dead_end(); }
void main() { kept.at[0] = sqrt(deeper(start.first)); BODY }
"""


def compiled(shaders: ShaderFolder, body: str, head: str = "void main()") -> bytes:
    file = shaders.write("passes/x.comp", SHADER.replace("void main()", head).replace("BODY", body))
    return without_dead_code(shaderc.compile_source(file.read_bytes(), "comp", str(file), [], optimization="zero"))


def disassembled(spirv: bytes) -> str:
    return subprocess.run(["spirv-dis", "-"], input=spirv, capture_output=True, check=True).stdout.decode()


def test_what_main_does_not_reach_is_gone(shaders):
    spirv = compiled(shaders, "")
    module = reflect(spirv)
    assert set(module.bindings) == {"kept", "start"}
    assert set(module.constants) == {"COUNT"}
    text = disassembled(spirv)
    assert not re.search(r"gone|dead|ABSENT|OpTypeRayQuery|OpCapability RayQuery|SPV_KHR_ray_query", text)
    assert text.count("NoContraction") == 2, "a product and a sum of `exact`"
    assert len(re.findall("OpFunctionEnd", text)) == 3
    check_spirv(spirv, "trimmed")


def test_what_main_reaches_stays(shaders):
    spirv = compiled(shaders, "kept.at[1] = dead();")
    module = reflect(spirv)
    assert set(module.bindings) == {"kept", "start", "gone", "gone_image", "gone_tlas"}
    assert module.main.writes == {"kept", "gone_image"}
    text = disassembled(spirv)
    assert text.count("NoContraction") == 4
    assert "OpCapability RayQuery" in text
    check_spirv(spirv, "whole")


CONSTANT = {
    "a function's result, in a variable": "bool held = no(kept.at[3]); if (held || !YES) { kept.at[1] = dead(); }",
    "the right of &&": "if (kept.at[3] > 1.0 && NO) { kept.at[1] = dead(); }",
    "after a break": "for (uint i = 0u; i < COUNT; ++i) { if (YES) { kept.at[i] = 2.0; break; } kept.at[1] = dead(); }",
    "a loop that never runs": "while (NO) { kept.at[1] = dead(); }",
    "a loop that runs once": "do { kept.at[1] = 2.0; if (NO) { kept.at[1] = dead(); } } while (NO);",
    "after returns of both branches": "if (kept.at[3] > 1.0) { return; } else { return; } kept.at[1] = dead();",
    "else": "if (YES) { kept.at[1] = 2.0; } else if (kept.at[3] > 1.0) { kept.at[1] = dead(); }",
}
CHANGING = {
    "a variable of two values": "bool seen = NO; if (kept.at[3] > 1.0) seen = YES; if (seen) { kept.at[1] = dead(); }",
    "a variable that a function changes": "bool seen = NO; see(seen); if (seen) { kept.at[1] = dead(); }",
    "the left of ||": "if (kept.at[3] > 1.0 || NO) { kept.at[1] = dead(); }",
    "a variable of a loop": "bool more = YES; while (more) { kept.at[1] = dead(); more = NO; }",
}
CONDITIONS = """const bool NO = false, YES = true;
bool no(float value) { if (value > 2.0) { return NO; } return NO && value > 1.0; }
void see(inout bool seen) { seen = YES; }
void main()"""


@pytest.mark.parametrize(
    ("body", "stays"),
    [*((body, False) for body in CONSTANT.values()), *((body, True) for body in CHANGING.values())],
    ids=[*CONSTANT, *CHANGING],
)
def test_blocks_that_constant_conditions_never_run_are_gone(shaders, body, stays):
    spirv = compiled(shaders, body, CONDITIONS)
    assert ("gone" in reflect(spirv).bindings) == stays
    check_spirv(spirv, "pruned")
    assert without_dead_code(spirv) == spirv


SWITCHES = """layout(constant_id = 5) const bool ON = true;
layout(constant_id = 6) const bool OFF = false;
layout(constant_id = 7) const bool OTHER = false;
layout(constant_id = 8) const bool LAST = false;
void main()"""


@pytest.mark.parametrize(
    ("condition", "stays"),
    [
        ("!ON || OFF || COUNT == 3u", (False, True)),
        ("(OTHER || LAST) && ON", (False, False)),
        ("ON != OFF && COUNT != 3u", (True, False)),
        ("COUNT == 4u && !LAST", (False, True)),
    ],
)
def test_what_specialization_constants_switch_off_is_gone(shaders, condition, stays):
    module = reflect(compiled(shaders, f"if ({condition}) {{ kept.at[1] = dead(); }}", SWITCHES))
    for values, expected in zip(({}, {"ON": False, "COUNT": 4, "unknown": 1}), stays, strict=True):
        spirv = specialized(module, values).spirv
        made = reflect(spirv)
        assert ("gone" in made.bindings, made.constants) == (expected, {})
        check_spirv(spirv, "specialized")
        assert f"OpConstant %uint {values.get('COUNT', 2)}\n" in disassembled(spirv)


def test_a_second_time_nothing_goes():
    spirv = compile_shader("passes/gbuffer/raster.frag")
    assert without_dead_code(spirv) == spirv


def test_texts_are_dropped_and_all_else_stays(shaders):
    file = shaders.write("passes/x.comp", SHADER.replace("BODY", ""))
    raw = shaderc.compile_source(file.read_bytes(), "comp", str(file), [], optimization="zero")
    kept = without_texts(raw)
    assert b"void main()" in raw
    assert b"void main()" not in kept
    after_texts = [disassembled(module).partition("OpName %main")[2] for module in (raw, kept)]
    assert re.sub(r"(?m)^ +Op(Line|NoLine|ModuleProcessed).*\n", "", after_texts[0]) == after_texts[1] != ""
