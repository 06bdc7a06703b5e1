// The picture of a pixel at rest, by what its samples show. Later samples count more, since the denoiser knows more
// from frame to frame; but how much of the pixel a surface covers is told by all frames alike, and at edges by several
// camera rays in each. So the surface that the first sample showed and all else have a mean each, which count by their
// shares of the pixel: poststratification (Holt and Smith, "Post Stratification", 1979).
#ifndef PASSES_TAA_STRATA_GLSL
#define PASSES_TAA_STRATA_GLSL

#include "common/hash.glsl"
#include "common/packing.glsl"
#include "passes/taa/bindings.glsl"
#include "passes/taa/samples.glsl"

struct Strata {
    vec3 first;    // mean radiance of the samples that show `surface`
    vec3 rest;     // the same of the others
    vec2 counts;   // of these samples; the second is GUESSED where it has none and other pixels tell its light
    float share;   // of camera rays that show the first one, over frames; NO_SHARE without any, or FLICKERS
    uint surface;  // what the first sample showed, by surface_code
};

const float GUESSED = 0.25, NO_SHARE = -1.0;
const float FLICKERS = -2.0;  // light has changed without a cause: rays would be traced again and again
const Strata NO_STRATA = Strata(vec3(0.0), vec3(0.0), vec2(0.0), NO_SHARE, 0u);

// ---- surfaces within a pixel --------------------------------------------------------------------------

const uint INSTANCE_BITS = 4u, NORMAL_BITS = 4u;  // of a code, the latter for each of two coordinates

// The instance, by a hash, and its geometric normal, 0 where there is no surface.
uint surface_code(uint instance, vec3 normal) {
    uint direction = pack_octahedral(instance == NO_INDEX ? vec3(0.0, 0.0, 1.0) : normal, NORMAL_BITS);
    return pcg(instance) >> 32u - INSTANCE_BITS | direction << INSTANCE_BITS;
}

// What the sample of a rendered pixel shows.
uint surface_code(ivec2 pixel) {
    uvec2 surface = imageLoad(gbuffer_surface, texel_of(pixel)).xy;
    return surface_code(surface.y, unpack_octahedral_2x16(surface.x));
}

bool is_same_surface(uint a, uint b) {
    vec3 normal = unpack_octahedral(a >> INSTANCE_BITS, NORMAL_BITS);
    vec3 other = unpack_octahedral(b >> INSTANCE_BITS, NORMAL_BITS);
    return bitfieldExtract(a ^ b, 0, int(INSTANCE_BITS)) == 0u && dot(normal, other) > MIN_NORMAL_COSINE;
}

// ---- packing ------------------------------------------------------------------------------------------

// Both means, 16 bits a channel; then the surface, the share in units of 1 / SHARES or a code for none, and the counts.
const float SHARES = 253.0;
const uint FLICKERS_CODE = 254u, NO_SHARE_CODE = 255u;
const int SHARE_AT = 12, FIRST_AT = 20, REST_AT = 26;  // the first bits of what follows the surface

Strata load_strata(uint index) {
    uvec4 bits = taa_strata.at[index];
    vec3 first = vec3(unpack_positive(bits.x, 16u), unpack_positive(bits.y, 16u), unpack_positive(bits.z, 16u));
    uvec3 high = bits.xyz >> 16u;
    vec3 rest = vec3(unpack_positive(high.x, 16u), unpack_positive(high.y, 16u), unpack_positive(high.z, 16u));
    uint code = bitfieldExtract(bits.w, SHARE_AT, 8);
    float share = code == NO_SHARE_CODE ? NO_SHARE : code == FLICKERS_CODE ? FLICKERS : float(code) / SHARES;
    vec2 counts = vec2(bitfieldExtract(bits.w, FIRST_AT, 6), bitfieldExtract(bits.w, REST_AT, 6));
    counts.y = counts.y == 1.0 ? GUESSED : max(counts.y - 1.0, 0.0);
    return Strata(first, rest, counts, share, bitfieldExtract(bits.w, 0, SHARE_AT));
}

void store_strata(uint index, Strata strata, inout uint rng) {
    uint none = strata.share == FLICKERS ? FLICKERS_CODE : NO_SHARE_CODE;
    uint share = strata.share < 0.0 ? none : uint(SHARES * strata.share + rand_f(rng));
    uvec2 counts = uvec2(strata.counts + vec2(rand_f(rng), rand_f(rng)));
    uint rest = strata.counts.y == GUESSED ? 1u : counts.y == 0u ? 0u : counts.y + 1u;
    taa_strata.at[index] = uvec4(
        pack_two(strata.first.r, strata.rest.r, rng), pack_two(strata.first.g, strata.rest.g, rng),
        pack_two(strata.first.b, strata.rest.b, rng),
        strata.surface | share << SHARE_AT | min(counts.x, 63u) << FIRST_AT | min(rest, 63u) << REST_AT
    );
}

// ---- the mean -----------------------------------------------------------------------------------------

float sample_count(Strata strata) { return strata.counts.x + strata.counts.y; }

// share: of the camera rays of one frame
void add_share(inout Strata strata, float share) {
    strata.share = mix(strata.share, share, strata.share < 0.0 ? 1.0 : 1.0 / (sample_count(strata) + 1.0));
}

// A sample counts in proportion to its number among those of its surface.
void add_to_mean(inout vec3 mean, inout float count, vec3 found) {
    mean = mix(found, mean, square(count / (count + 1.0)));
    count = (count == GUESSED ? 0.0 : count) + 1.0;
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

// Whether rays tell the shares of the pixel, and it is known what each shows.
bool is_complete(Strata strata) {
    bool knows_first = strata.counts.x > 0.0 || strata.share == 0.0;
    bool knows_rest = strata.counts.y > 0.0 || strata.share == 1.0;
    return strata.share >= 0.0 && knows_first && knows_rest;
}

vec3 mean_of(Strata strata) {
    float share = is_complete(strata) ? strata.share : strata.counts.x / sample_count(strata);
    return mix(strata.rest, strata.first, share);
}

// The number of samples from which the mean is better than what a few samples and their neighbors tell: where rays
// tell the shares of surfaces that differ clearly, there are few doubts.
float samples_needed(Strata strata) {
    float bright = luminance(strata.first), other = luminance(strata.rest);
    bool differ = abs(bright - other) > CLEAR_DIFFERENCE * (bright + other);
    return is_complete(strata) && differ ? 2.0 : ENOUGH;
}

#endif
