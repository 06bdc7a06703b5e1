// ReSTIR GI, initial samples: traces one ray in a random direction, and looks up in the world cache what its end
// reflects. Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (HPG 2021).
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/camera_medium.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/solari019/restir_gi/reservoir.glsl"
#include "passes/world_cache/query.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x6A09E667u;

GiReservoir generate_initial_reservoir(GBufferSurface surface, inout uint rng) {
    GiReservoir reservoir = empty_gi_reservoir(1.0);
    vec3 direction = orthonormalize(surface.world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
    if (!(dot(direction, surface.geometric_world_normal) > 0.0)) { return reservoir; }
    vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
    Walk walk = start_walk(origin, direction);
    walk.medium = camera_medium();
    GatheredLight light = gather_light(walk, true, world_cache_settings.lifetime, rng);
    reservoir.sample_point_world_position = light.first_position;
    reservoir.sample_point_world_normal = light.first_normal;
    reservoir.radiance = gathered_radiance(light);
    reservoir.reflectance = light.reflectance;
    reservoir.world_cache_cell = light.first_normal == SEEN_IN_MIRROR ? NO_INDEX : light.cell;
    reservoir.unbiased_contribution_weight = luminance(reservoir.radiance) > 0.0 ? 2.0 * PI : 0.0;
    // Samples behind blended surfaces are found with this probability.
    if (SCENE_BLEND) { reservoir.unbiased_contribution_weight /= light.through.probability; }
    return reservoir;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (!is_inside(pixel, camera.size)) { return; }
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    GBufferSurface surface = load_gbuffer(pixel);
    gi_temporal_reservoirs.at[pixel_index(pixel, camera.size)] =
        takes_no_gi(surface) ? empty_gi_reservoir(0.0) : generate_initial_reservoir(surface, rng);
}
