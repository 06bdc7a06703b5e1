// Lists the pixels of which coverage.comp traces several camera rays: at edges where a mean begins, in a first frame,
// where the picture jumps or where light has changed, and in the first frames at rest. And such as show blended
// surfaces in motion: one sample shows one of their layers alone, and means are short there. A pass that traced rays
// here would keep the threads of the other pixels waiting.
#version 460
#include "passes/taa/history.glsl"
#include "passes/taa/strata.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

bool is_at_edge(ivec2 center) {
    uint instance = imageLoad(gbuffer_surface, texel_of(center)).y;
    for (int i = 0; i < 9; i++) {
        ivec2 other = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(other, camera.size)) { continue; }
        if (imageLoad(gbuffer_surface, texel_of(other)).y != instance || !show_the_same(center, other)) { return true; }
        // At the border of the picture the samples of one frame may miss an edge.
        if (this_frame.has_history != 0u && previous_instance(texel_of(other)) != instance) { return true; }
    }
    return false;
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (taa_settings.antialiasing == 0u || !find_element(pixel, camera.picture_size, index)) { return; }
    if (in_exposure()) { return; }
    radiance.at[index] = NO_COVERAGE;
    // Rays can't tell what raster shows of instances that are other meshes to rays.
    if (SCENE_PROXIES) { return; }
    ivec2 at = ivec2(pixel), center = find_center(at);
    float left = has_strata() ? load_history(at).weight * confidence_at(center) : LONGEST;  // samples that still hold
    bool is_young = left < COVERED, has_blends = SCENE_BLEND && is_blended(center);
    bool stays = (is_young || has_blends) && is_still(center);
    // Of narrow holes few samples show what is behind them, so that only a frame without any past guesses its light.
    bool has_new_light = this_frame.expected_change > 0.0 && stays && left < 1.0 && !SCENE_ALPHA;
    bool begins = begins_anew(center) || has_new_light;
    bool shows_layers = has_blends && !stays;
    bool needs_shares = stays && is_young && load_strata(index).share != FLICKERS;
    if (shows_layers || (begins || needs_shares) && is_at_edge(center)) {
        uint needs = begins || shows_layers ? NEEDS_LIGHT : 0u;
        taa_edges.at[atomicAdd(taa_coverage.found, 1u)] = index | needs;
    }
}
