// World cache, step 6: blends a cell's new irradiance into its mean over frames, of which fewer count where light
// changes. The adaptive blend is Guillaume Boisse's, as in the Bevy 0.18 post about Solari.
#version 460
#include "passes/world_cache/update.glsl"

layout(local_size_x = GROUP_SIZE) in;

// What a frame adds to the sample count of a cell below the maximum. Differs from Solari, where it is 1: young cells
// receive light from other young cells, which still lack later bounces. With less than 1, later samples soon outweigh
// a cell's first ones, and multi-bounce light arrives several times as fast.
const float SHORT_HISTORY_GROWTH = 0.25;
// The same in the fill: its first samples have all bounces, since no path ends in an empty cache.
const float FILL_GROWTH = 1.0;

void main() {
    uint thread = place_in_list(thread_index(gl_GlobalInvocationID.xy));
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    if ((world_cache_samples.at[thread].life & SEES_WALL) != 0u) { world_cache_first_points.at[cell] = DIVIDED_CELL; }
    vec4 old = world_cache_irradiance.at[cell];
    float delta = world_cache_luminance_deltas.at[cell];

    float max_samples = float(world_cache_settings.max_samples);
    float growth = is_filling() ? FILL_GROWTH : SHORT_HISTORY_GROWTH;
    float sample_count = clamp(old.w + growth, 1.0, max_samples);
    float change = saturate(abs(delta) / max(luminance(old.rgb), 1e-30));
    float changing_max_samples = mix(max_samples, 1.0, pow(change, world_cache_settings.change_exponent));
    float share = 1.0 / (is_filling() ? sample_count : min(sample_count, changing_max_samples));
    vec3 blended = mix(old.rgb, world_cache_samples.at[thread].irradiance, share);
    world_cache_irradiance.at[cell] = vec4(blended, sample_count);
    if (is_filling()) { return; }
    float newest = luminance(blended) - luminance(old.rgb);
    world_cache_luminance_deltas.at[cell] = mix(delta, newest, world_cache_settings.change_smoothing);
}
