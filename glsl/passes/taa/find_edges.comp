// Lists the pixels of which coverage.comp traces several camera rays: those at edges in a first frame, where the picture
// jumps, or in the first frames at rest, and such as show blended surfaces in motion. A pass that traced rays here would
// keep the threads of the other pixels waiting.
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

// Whether a pixel is at rest, and has had few samples.
bool needs_shares(ivec2 at, ivec2 center) {
    return has_strata() && !in_exposure() && load_history(at).weight < COVERED && is_still(center);
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (taa_settings.antialiasing == 0u || !find_element(pixel, camera.picture_size, index)) { return; }
    ivec2 at = ivec2(pixel), center = find_center(at);
    bool begins = needs_coverage(at, center);
    if (!begins && !needs_shares(at, center)) { return; }
    // Rays can't tell what raster shows of instances that are other meshes to rays.
    if (SCENE_PROXIES || !(blends_in_motion(center) || is_at_edge(center))) {
        if (begins) { radiance.at[index] = NO_COVERAGE; }
        return;
    }
    taa_edges.at[atomicAdd(taa_coverage.found, 1u)] = index;
}
