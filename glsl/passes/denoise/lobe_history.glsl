// The light of a lobe in the denoiser: its mean over frames. Radiance is demodulated and linear.
#ifndef PASSES_DENOISE_LOBE_HISTORY_GLSL
#define PASSES_DENOISE_LOBE_HISTORY_GLSL

#include "common/packing.glsl"
#include "passes/denoise/constants.glsl"

// History of a lobe.
struct LobeHistory {
    vec3 radiance;           // the mean
    float second_moment;     // the mean of squared luminances
    float fast_luminance;    // fast history: exponential mean of the luminances of the latest frames
    float frames;            // number of frames in the mean; 0 without a history
    float inverse_hit_distance;  // mean of 1 / distance to where the light came from, in 1/m; 0 when unknown
};

const LobeHistory NO_HISTORY = LobeHistory(vec3(0.0), 0.0, 0.0, 0.0, 0.0);

// Kish's effective sample size: 1 if one frame brought all the light, `frames` if all brought the same.
float effective_frames(LobeHistory lobe) {
    float value = luminance(lobe.radiance);
    return lobe.frames * value * value / max(lobe.second_moment, EPSILON);
}

// ---- packing ----------------------------------------------------------------------------------------

uvec4 pack_lobe_history(LobeHistory lobe, inout uint rng) {
    uint red = pack_positive(lobe.radiance.r, 21u, rng), green = pack_positive(lobe.radiance.g, 21u, rng);
    uint blue = pack_positive(lobe.radiance.b, 21u, rng);
    return uvec4(
        red | green << 21u, green >> 11u | blue << 10u,
        pack_two(lobe.second_moment, lobe.fast_luminance, rng), pack_two(lobe.frames, lobe.inverse_hit_distance, rng)
    );
}

LobeHistory unpack_lobe_history(uvec4 bits) {
    return LobeHistory(
        vec3(unpack_positive(bits.x, 21u), unpack_positive(bits.x >> 21u | bits.y << 11u, 21u),
             unpack_positive(bits.y >> 10u, 21u)),
        unpack_positive(bits.z, 16u), unpack_positive(bits.z >> 16u, 16u),
        unpack_positive(bits.w, 16u), unpack_positive(bits.w >> 16u, 16u)
    );
}

#endif
