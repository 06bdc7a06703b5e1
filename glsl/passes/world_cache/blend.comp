// World cache, step 6: new irradiance into the mean over frames, fewer of them where light changes (Guillaume Boisse's blend).
#version 460
#include "passes/world_cache/update.glsl"

layout(local_size_x = GROUP_SIZE) in;

// Differs from Solari, where it is 1: what a young cell saw came from young cells, which miss the later bounces; so its first
// samples count less, as the cube of their age, and light arrives several times as fast.
const float YOUNG_GROWTH = 0.25;

void main() {
    uint thread = thread_index(gl_GlobalInvocationID.xy);
    uint cell = find_cell_to_update(thread);
    if (cell == NO_INDEX) { return; }
    vec4 old = world_cache_irradiance.at[cell];
    float delta = world_cache_luminance_deltas.at[cell];

    float most = float(world_cache_settings.max_samples);
    float sample_count = min(old.w > 0.0 ? old.w + YOUNG_GROWTH : 1.0, most);
    if (world_cache_settings.blend == WORLD_CACHE_BLEND_ADAPTIVE) {
        float change = abs(delta) / max(luminance(old.rgb), 1e-30);
        most = mix(most, 1.0, pow(saturate(change), world_cache_settings.change_exponent));
    }
    float share = 1.0 / min(sample_count, most);
    // Differs from Solari: lights that are switched needn't be guessed from noise
    if (world_cache_settings.relight != 0u) { share = max(share, this_frame.lighting_change); }
    vec3 blended = mix(old.rgb, world_cache_samples.at[thread].irradiance, share);
    world_cache_irradiance.at[cell] = vec4(blended, sample_count);
    float newest = luminance(blended) - luminance(old.rgb);
    world_cache_luminance_deltas.at[cell] = mix(delta, newest, world_cache_settings.change_smoothing);
}
