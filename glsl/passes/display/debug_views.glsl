// Functions for the debug views, whose table is solari_vk/passes/debug_views.py. They write nothing, so looking at a
// view doesn't change the frames.
#ifndef PASSES_DISPLAY_DEBUG_VIEWS_GLSL
#define PASSES_DISPLAY_DEBUG_VIEWS_GLSL

#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/denoise/api.glsl"
#include "passes/display/tonemap.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/world_cache/map.glsl"
#include "scene/sampling.glsl"

const vec3 NOTHING = vec3(0.0);
const vec3 ALARM = vec3(0.9, 0.1, 0.1);

// ---- colors of numbers ------------------------------------------------------------------------------

// From dark blue for 0 through green to yellow for 1: five colors of Viridis (van der Walt and Smith, 2015).
vec3 show_share(float share) {
    const vec3 colors[5] = vec3[](
        vec3(0.267, 0.005, 0.329), vec3(0.229, 0.322, 0.546), vec3(0.128, 0.567, 0.551), vec3(0.369, 0.789, 0.383),
        vec3(0.993, 0.906, 0.144)
    );
    float position = 4.0 * saturate(share);
    int first = min(int(position), 3);
    return mix(colors[first], colors[first + 1], position - float(first));
}

// A random color for each number, never black.
vec3 show_number(uint number) { return 0.2 + 0.8 * unpackUnorm4x8(pcg(number)).rgb; }

vec3 show_direction(vec3 direction) { return 0.5 + 0.5 * direction; }

vec3 show_motion(vec2 motion) { return vec3(0.5 - motion * vec2(camera.size) / 16.0, 0.5); }

vec3 show_depth(float depth_value) {
    return depth_value > 0.0 ? show_share(fract(log2(camera.near / depth_value))) : NOTHING;
}

vec3 show_distance(float meters) {
    return meters > 0.0 && !isinf(meters) ? show_share(fract(log2(meters))) : NOTHING;
}

// ---- views of a pass --------------------------------------------------------------------------------

struct ShownCell {
    bool exists;      // otherwise the fields below `size` are 0
    uint checksum;
    float size;       // in meters
    vec3 irradiance;
    float sample_count;
    uint life;
};

// The world-cache cell at a surface.
ShownCell find_shown_cell(uvec2 pixel, GBufferSurface surface) {
    uint rng = seed_rng(pixel, 0u, 0u);
    float cell_size = get_cell_size(surface.world_position, rng);
    WorldCacheKey key = make_world_cache_key(surface.world_position, surface.geometric_world_normal, cell_size);
    uint empty_step;
    uint cell = find_world_cache_cell(key, empty_step);
    if (cell == NO_INDEX) { return ShownCell(false, key.checksum, cell_size, vec3(0.0), 0.0, 0u); }
    vec4 irradiance = world_cache_irradiance.at[cell];
    return ShownCell(true, key.checksum, cell_size, irradiance.rgb, irradiance.w, world_cache_life.at[cell]);
}

#endif
