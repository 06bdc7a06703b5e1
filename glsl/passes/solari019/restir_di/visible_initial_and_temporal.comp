// ReSTIR DI, first half as in Solari (di_initial_visibility=on): an occluded sample is dropped before the merge.
#version 460
#include "common/pixel.glsl"
#include "passes/ray_count.glsl"
#include "passes/solari019/restir_di/initial_and_temporal.glsl"
#include "scene/light_visibility.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void test_visibility(GBufferSurface surface, inout DiReservoir reservoir) {
    if (reservoir.light_sample.light_index == NO_INDEX) { return; }
    count_ray();
    vec3 origin = surface.world_position + surface.geometric_world_normal * surface.ray_offset;
    ResolvedLightSample resolved = resolve_light_sample(reservoir.light_sample);
    vec3 end = light_sample_for_receiver(resolved, surface.world_position).world_position;
    vec3 transmittance = trace_shadow_ray(origin, for_shadow_ray(resolved, end));
    reservoir.unbiased_contribution_weight *= transmittance != vec3(0.0) ? 1.0 : 0.0;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    write_temporal_reservoir(pixel);
}
