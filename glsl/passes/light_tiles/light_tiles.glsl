// Light samples to choose from, out of tiles that were drawn ahead: Wyman and Panteleev, "Rearchitecting Spatiotemporal
// Resampling for Production" (2021), section 5. Users choose by these; what they choose they resolve again, exactly.
#ifndef PASSES_LIGHT_TILES_LIGHT_TILES_GLSL
#define PASSES_LIGHT_TILES_LIGHT_TILES_GLSL

#include "common/packing.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/light_tiles/bindings.glsl"
#include "scene/sampling.glsl"

struct LightCandidate {
    LightSample light_sample;
    ResolvedLightSample resolved;  // as packed; without lights, black
};

PackedLightSample pack_light_sample(ResolvedLightSample resolved) {
    uint inverse_pdf = floatBitsToUint(resolved.inverse_pdf) & ~1u;
    inverse_pdf |= (resolved.double_sided ? 1u : 0u) | (resolved.world_position.w == 0.0 ? 1u << 31u : 0u);
    return PackedLightSample(
        resolved.world_position.xyz,
        pack_octahedral_2x16(resolved.world_normal),
        light_tiles_settings.encoding == LIGHT_TILE_ENCODING_LINEAR
            ? pack_rgb9e5(resolved.radiance * this_frame.exposure)
            : pack_radiance_log2_rgb9e5(resolved.radiance, this_frame.exposure),
        uintBitsToFloat(inverse_pdf)
    );
}

ResolvedLightSample unpack_light_sample(PackedLightSample packed) {
    uint inverse_pdf = floatBitsToUint(packed.inverse_pdf);
    return ResolvedLightSample(
        vec4(packed.world_position, inverse_pdf >> 31u == 0u ? 1.0 : 0.0),
        unpack_octahedral_2x16(packed.world_normal),
        (inverse_pdf & 1u) != 0u,
        0.0,
        light_tiles_settings.encoding == LIGHT_TILE_ENCODING_LINEAR
            ? unpack_rgb9e5(packed.radiance) / this_frame.exposure
            : unpack_radiance_log2_rgb9e5(packed.radiance, this_frame.exposure),
        abs(packed.inverse_pdf)
    );
}

const LightSample NO_LIGHT_SAMPLE = LightSample(NO_INDEX, 0u, 0u);
const ResolvedLightSample BLACK_LIGHT_SAMPLE =
    ResolvedLightSample(vec4(0.0, 0.0, 1.0, 0.0), vec3(0.0, 0.0, -1.0), false, 0.0, vec3(0.0), 0.0);

// Draws one of all lights, whatever the tiles hold.
LightCandidate draw_light_candidate(inout uint rng) {
    if (scene_info.light_count == 0u) { return LightCandidate(NO_LIGHT_SAMPLE, BLACK_LIGHT_SAMPLE); }
    LightSample light_sample = generate_random_light_sample(rng);
    return LightCandidate(light_sample, resolve_light_sample(light_sample));
}

// For pixels `rng` is seeded by the group of invocations, so that these read the same memory.
uint choose_light_tile(inout uint rng) {
    return rand_range_u(light_tiles.at.length() / light_tiles.samples_each, rng);
}

LightCandidate sample_light_candidate(uint tile, inout uint rng) {
    if (light_tiles_settings.light_sampling == LIGHT_SAMPLING_RESOLVE) { return draw_light_candidate(rng); }
    uint index = tile * light_tiles.samples_each + rand_range_u(light_tiles.samples_each, rng);
    return LightCandidate(light_tile_samples.at[index], unpack_light_sample(light_tiles.at[index]));
}

#endif
