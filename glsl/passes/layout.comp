// Declares what the package's shaders bind, and computes nothing. On software devices the descriptor layouts of all
// frames hold these bindings, numbered by name (solari_vk/gpu/frame/interface.py), so that frames share pipelines.
#version 460
#include "generated/bound/lights/light_kinds.glsl"
#include "passes/camera_medium.glsl"
#include "passes/denoise/alternate_history.glsl"
#include "passes/denoise/bindings.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/display/bindings.glsl"
#include "passes/gbuffer/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/guides/bindings.glsl"
#include "passes/light_change.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/paths/short_history.glsl"
#include "passes/reference/bindings.glsl"
#include "passes/solari019/light_tiles/bindings.glsl"
#include "passes/solari019/restir_di/bindings.glsl"
#include "passes/solari019/restir_gi/bindings.glsl"
#include "passes/taa/bindings.glsl"
#include "passes/world_cache/bindings.glsl"
#include "scene/bindings.glsl"
#include "scene/brdf_table.glsl"
#include "scene/trace.glsl"

void main() {}
