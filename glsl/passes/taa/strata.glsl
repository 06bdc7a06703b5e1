// The picture of a pixel at rest, by what its samples show. Later samples count more, since the denoiser knows more
// from frame to frame; but how much of the pixel a surface covers is told by all samples alike. So the surface that
// the first sample showed and all else have a mean each, and both count by their numbers of samples: poststratification
// (Holt and Smith, "Post Stratification", 1979).
#ifndef PASSES_TAA_STRATA_GLSL
#define PASSES_TAA_STRATA_GLSL

#include "common/hash.glsl"
#include "common/packing.glsl"
#include "passes/taa/bindings.glsl"
#include "passes/taa/samples.glsl"

struct Strata {
    vec3 first;    // mean radiance of the samples that show `surface`
    vec3 rest;     // the same of the others
    vec2 counts;   // of these samples
    uint surface;  // what the first sample showed, by surface_code
};

const Strata NO_STRATA = Strata(vec3(0.0), vec3(0.0), vec2(0.0), 0u);

// How taa_strata has them: both means, 16 bits a channel; the counts in units of 1 / COUNT_SCALE, 8 bits each; the
// surface.
const float COUNT_SCALE = 4.0;
const uint INSTANCE_BITS = 6u, NORMAL_BITS = 5u;  // of a surface code, the latter for each of two coordinates

// A surface within a pixel: its instance, by a hash, and its normal.
uint surface_code(ivec2 pixel) {
    vec3 normal = imageLoad(guides_normal_roughness, texel_of(pixel)).xyz;
    uint instance = pcg(imageLoad(gbuffer_surface, texel_of(pixel)).y) >> 32u - INSTANCE_BITS;
    return instance | pack_octahedral(safe_normalize(normal, vec3(0.0, 0.0, 1.0)), NORMAL_BITS) << INSTANCE_BITS;
}

bool is_same_surface(uint a, uint b) {
    vec3 normal = unpack_octahedral(a >> INSTANCE_BITS, NORMAL_BITS);
    vec3 other = unpack_octahedral(b >> INSTANCE_BITS, NORMAL_BITS);
    return bitfieldExtract(a ^ b, 0, int(INSTANCE_BITS)) == 0u && dot(normal, other) > MIN_NORMAL_COSINE;
}

Strata load_strata(uint index) {
    uvec4 bits = taa_strata.at[index];
    vec3 low = vec3(unpack_positive(bits.x, 16u), unpack_positive(bits.y, 16u), unpack_positive(bits.z, 16u));
    vec3 high = vec3(unpack_positive(bits.x >> 16u, 16u), unpack_positive(bits.y >> 16u, 16u),
                     unpack_positive(bits.z >> 16u, 16u));
    vec2 counts = vec2(bits.w & 0xFFu, bits.w >> 8u & 0xFFu) / COUNT_SCALE;
    return Strata(low, high, counts, bits.w >> 16u);
}

void store_strata(uint index, Strata strata, inout uint rng) {
    uvec2 counts = uvec2(COUNT_SCALE * strata.counts + vec2(rand_f(rng), rand_f(rng)));
    taa_strata.at[index] = uvec4(
        pack_two(strata.first.r, strata.rest.r, rng), pack_two(strata.first.g, strata.rest.g, rng),
        pack_two(strata.first.b, strata.rest.b, rng), counts.x | counts.y << 8u | strata.surface << 16u
    );
}

float sample_count(Strata strata) { return strata.counts.x + strata.counts.y; }

// A sample counts in proportion to its number among those of its surface.
void add_to_mean(inout vec3 mean, inout float count, vec3 found) {
    mean = mix(found, mean, square(count / (count + 1.0)));
    count += 1.0;
}

void add_sample(inout Strata strata, uint surface, vec3 found) {
    float count = sample_count(strata);
    if (count == 0.0) { strata.surface = surface; }
    strata.counts *= min((LONGEST - 1.0) / max(count, 1.0), 1.0);
    if (is_same_surface(surface, strata.surface)) {
        add_to_mean(strata.first, strata.counts.x, found);
    } else {
        add_to_mean(strata.rest, strata.counts.y, found);
    }
}

vec3 mean_of(Strata strata) { return mix(strata.first, strata.rest, strata.counts.y / sample_count(strata)); }

#endif
