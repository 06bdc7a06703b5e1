// How many paths a pixel takes: more than one if its history is short, since its light is averaged over few frames.
// With the setting frame_ms all pixels take more or fewer, by chance, as the frame's time allows.
#ifndef PASSES_PATHS_SHORT_HISTORY_GLSL
#define PASSES_PATHS_SHORT_HISTORY_GLSL

#include "common/random.glsl"
#include "generated/passes/paths.glsl"  // SHORT_HISTORY, written by solari_vk/passes/paths.py
#include "passes/bindings.glsl"
#include "passes/denoise/api.glsl"

layout(constant_id = short_history_samples_id) const uint short_history_samples = 1u;  // paths of such a pixel
// The most paths of a pixel with the setting frame_ms; 0 without that.
layout(constant_id = max_timed_samples_id) const uint max_timed_samples = 0u;
// With the setting upscale: of so many pixels one takes a path in a frame.
layout(constant_id = pixels_per_path_id) const float pixels_per_path = 1.0;

// With the setting frame_ms: the factor of each pixel's expected number of paths, which may be above 1.
layout(set = 1, scalar) uniform PathShareBlock { float value; } path_share;

const uint SHARE_SALT = 0x5BE0CD19u, TURN_SALT = 0x9B05688Cu;
const uint GOLDEN_RATIO = 2654435769u;  // 2^32 over it

// Whether some pixels take no path, so that the others are in a list.
bool chooses_pixels() { return max_timed_samples > 0u || pixels_per_path > 1.0; }

// With upscale, pixels take their paths by turns: one of each block of n x n, the same of all blocks, so that
// the pixels of a frame are as far apart as they can be. The order is another one each time, or surfaces that move by a
// pixel a frame might never have a turn. Returns how many turns a pixel has in this frame, two at most: the last one of
// an order and the first one of the next. number: of turns that it has had before; without a turn one that no turn has.
uint turn_count(uint index, out uint number) {
    number = this_frame.index;
    if (pixels_per_path == 1.0) { return 1u; }
    number = ~number;
    uint n = uint(ceil(sqrt(pixels_per_path) - 1e-3)), count = n * n, found = 0u;
    uvec2 within = find_pixel_of(index) % n;
    // Fixed-point numbers of turns up to this frame's and the next one's, which have 29 bits behind the point.
    uint turns_per_frame = uint(float(count) / pixels_per_path * 536870912.0);
    uvec2 low, high;
    umulExtended(this_frame.index + uvec2(0u, 1u), uvec2(turns_per_frame), high, low);
    uvec2 turns = high << 3u | low >> 29u;
    for (uint turn = turns[0]; turn < turns[1]; turn++) {
        uint order = turn / count;
        uint random = seed_rng(uvec2(order, 0u), 0u, this_frame.seed ^ TURN_SALT);
        // A permutation, because the factor and the count have no common divisor.
        uint whose = (turn % count * (n * (random % n) + 1u) + (random >> 16u)) % count;
        if (whose != within.x + n * within.y) { continue; }
        number = order;
        found++;
    }
    return found;
}

// The number of paths of a pixel, by the length of its history before this frame. It is that of the diffuse lobe, since
// that of the specular lobe is short wherever the camera moves. number: of earlier frames in which it took paths.
uint samples_per_pixel(uint index, out uint number) {
    uint turns = turn_count(index, number);
    if (!uses_denoiser(index)) { return 1u; }
    float long_enough = min(SHORT_HISTORY, float(denoise_settings.max_history - 1u));
    float frames = history_length(index);
    uint samples = frames < long_enough ? short_history_samples : 1u;
    // What has just come into view has no light yet, and pixels around it may show other surfaces.
    if (max_timed_samples == 0u) { return turns > 0u ? samples : uint(frames < 1.0); }
    // The expected number is rounded up or down at random, with a number that is uniform over pixels and a golden ratio
    // (Weyl) sequence over frames, so that the choice doesn't depend on what paths have found. Pixels with less than
    // one frame of history take one path at least.
    uint offset = seed_rng(uvec2(index, 0u), 0u, this_frame.seed ^ SHARE_SALT);
    float expected = min(path_share.value * float(samples), float(max_timed_samples));
    uint chosen = uint(expected + unit_float(offset + this_frame.index * GOLDEN_RATIO));
    return clamp(chosen, frames < 1.0 ? 1u : 0u, max_timed_samples);  // the sum may round up to one more
}

uint samples_per_pixel(uint index) {
    uint number;
    return samples_per_pixel(index, number);
}

#endif
