"""What reflection, layouts and drivers see of a module: all that its entry point reaches, and nothing else."""

import re
import subprocess

from support.seeded_bugs import Bug, seeded

from solari_vk.gpu.shaders import shaderc
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.dead_code import without_dead_code, without_texts
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


def compiled(shaders: ShaderFolder, body: str) -> bytes:
    file = shaders.write("passes/x.comp", SHADER.replace("BODY", body))
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


def test_a_second_time_nothing_goes():
    spirv = compile_shader("passes/gbuffer/raster.frag")
    assert without_dead_code(spirv) == spirv


def test_shaders_of_overlays_alone_are_not_optimized():
    path = "passes/solari019/restir_di/spatial_and_shade.comp"
    usual, other = compile_shader(path), compile_shader("passes/denoise/blur.comp")
    with seeded(Bug(path, "main", "correct();")):
        patched = compile_shader(path)
        assert compile_shader("passes/denoise/blur.comp") == other
    assert reflect(patched).bindings == reflect(usual).bindings
    assert disassembled(patched).count("OpFunctionCall") > 10 > disassembled(usual).count("OpFunctionCall")


def test_texts_are_dropped_and_all_else_stays(shaders):
    file = shaders.write("passes/x.comp", SHADER.replace("BODY", ""))
    raw = shaderc.compile_source(file.read_bytes(), "comp", str(file), [], optimization="zero")
    kept = without_texts(raw)
    assert b"void main()" in raw
    assert b"void main()" not in kept
    after_texts = [disassembled(module).partition("OpName %main")[2] for module in (raw, kept)]
    assert re.sub(r"(?m)^ +Op(Line|NoLine|ModuleProcessed).*\n", "", after_texts[0]) == after_texts[1] != ""
