// The next ray of each path that waits; in the last round all rays that are left.
#version 460
#include "generated/passes/paths.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/demodulation.glsl"
#include "passes/paths/reservoir.glsl"
#include "passes/paths/waiting.glsl"
#include "passes/paths/young.glsl"

layout(local_size_x = GROUP_SIZE) in;

void main() {
    uint row = thread_index(INVOCATION_INDEX);
    if (row >= paths_round.count) { return; }
    uint index = paths_lists.at[first_entry(paths_round.index) + row];
    uvec2 pixel = uvec2(index % camera.size.x, index / camera.size.x);
    Path path = take_waiting_path(index);
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;

    bool goes_on;
    do { goes_on = advance(path); } while (goes_on && paths_round.index == LAST_ROUND);
    if (goes_on) { wait(path, index, paths_round.index + 1u); }

    GBufferSurface surface = load_gbuffer(pixel);
    Lobes light = path_light(path);
    if (paths_reuse) {
        paths_offers.at[index].radiance += path.shareable;
        Lobes shareable = indirect_light(path, path.shareable);
        light.specular += kept_specular(shareable, surface.material.perceptual_roughness);
    }
    Demodulation by = demodulation(surface);
    float share = 1.0 / float(count_samples(index));
    paths_diffuse.at[index].rgb += share * light.diffuse / by.diffuse;
    paths_specular.at[index].rgb += share * light.specular / by.specular;
}
