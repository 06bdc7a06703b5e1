// Functions for the debug views of the separate passes, which solari_vk/passes/debug_views.py lists.
#ifndef PASSES_SOLARI019_DEBUG_VIEWS_GLSL
#define PASSES_SOLARI019_DEBUG_VIEWS_GLSL

#include "passes/display/debug_views.glsl"
#include "passes/solari019/light_tiles/light_tiles.glsl"
#include "passes/solari019/restir_di/bindings.glsl"
#include "passes/solari019/restir_gi/bindings.glsl"

vec3 show_light_tiles(uvec2 pixel) {
    uint samples_each = max(light_tiles.samples_each, 1u);
    uvec2 position = pixel * uvec2(samples_each, uint(light_tiles.at.length()) / samples_each) / camera.size;
    vec3 radiance = unpack_light_sample(light_tiles.at[position.y * samples_each + position.x]).radiance;
    return encode_srgb(radiance / max(max_component(radiance), 1e-30));  // at full brightness most would be white
}

vec3 show_light(uint light_index) {
    LightSource light = light_sources.at[light_index];
    return show_number(debug_color_id(light.kind, light.record_index));
}

#endif
