// The light of both lobes of a pixel while it is filtered. Radiance is demodulated and linear.
#ifndef PASSES_DENOISE_SIGNAL_GLSL
#define PASSES_DENOISE_SIGNAL_GLSL

#include "passes/denoise/bindings.glsl"
#include "passes/denoise/lobe_history.glsl"

struct Signal {
    vec3 radiance;
    float standard_error;  // of the luminance; negative where the pixel has no sample
};

struct Signals {
    Signal diffuse;
    Signal specular;
    uint state;
};

// The state of a pixel's signals. DONE: the blur has finished them. Its next pass copies them to the other ping-pong
// buffer, as DONE_IN_BOTH; those after it skip the pixel. REFLECTION_EDGES_UNKNOWN: being filtered, but the history is
// so short (MIN_VARIANCE_FRAMES) that variance.comp couldn't find the edges of bright reflections and keep the blur
// from crossing them.
const uint FILTERING = 0u, DONE = 1u, DONE_IN_BOTH = 2u, REFLECTION_EDGES_UNKNOWN = 3u;
const uint NO_SAMPLE = 0x7FFFu;  // fifteen ones, the code of a NaN: no standard error is packed to it

// random: 16 bits, for stochastic rounding.
uint pack_standard_error(float standard_error, uint random) {
    return standard_error < 0.0 ? NO_SAMPLE : floatBitsToUint(min(standard_error, LARGEST_PACKED)) + random >> 16u;
}

float unpack_standard_error(uint bits) { return (bits & NO_SAMPLE) == NO_SAMPLE ? -1.0 : unpack_positive(bits, 15u); }

uvec3 pack_signals(Signals signals, uvec3 random) {
    uint diffuse = pack_standard_error(signals.diffuse.standard_error, random.z & 0xFFFFu);
    uint specular = pack_standard_error(signals.specular.standard_error, random.z >> 16u);
    return uvec3(
        pack_color(signals.diffuse.radiance, random.x), pack_color(signals.specular.radiance, random.y),
        diffuse | specular << 15u | signals.state << 30u
    );
}

bool is_done(uint state) { return state == DONE || state == DONE_IN_BOTH; }

uint state_of(uint last_word) { return last_word >> 30u; }

Signals unpack_signals(uvec3 bits) {
    return Signals(
        Signal(unpack_color(bits.x), unpack_standard_error(bits.z)),
        Signal(unpack_color(bits.y), unpack_standard_error(bits.z >> 15u)), state_of(bits.z)
    );
}

#endif
