// Light samples from presampled tiles: Wyman and Panteleev, "Rearchitecting Spatiotemporal Resampling for Production"
// (2021), section 5. A pass chooses among packed samples, and resolves the chosen one again from the light itself.
#ifndef PASSES_SOLARI019_LIGHT_TILES_LIGHT_TILES_GLSL
#define PASSES_SOLARI019_LIGHT_TILES_LIGHT_TILES_GLSL

#include "common/packing.glsl"
#include "common/random.glsl"
#include "passes/bindings.glsl"
#include "passes/solari019/light_tiles/bindings.glsl"
#include "scene/sampling.glsl"

struct LightCandidate {
    LightSample light_sample;
    ResolvedLightSample resolved;  // as unpacked from a tile; black in a scene without lights
};

PackedLightSample pack_light_sample(ResolvedLightSample resolved) {
    return PackedLightSample(
        resolved.world_position,
        pack_octahedral_2x16(resolved.world_normal),
        pack_radiance_log2_rgb9e5(resolved.radiance, this_frame.exposure),
        resolved.inverse_area_pdf,
        resolved.kind,
        resolved.data
    );
}

ResolvedLightSample unpack_light_sample(PackedLightSample packed) {
    return ResolvedLightSample(
        packed.kind,
        packed.data,
        packed.world_position,
        unpack_octahedral_2x16(packed.world_normal),
        0.0,
        unpack_radiance_log2_rgb9e5(packed.radiance, this_frame.exposure),
        packed.inverse_area_pdf
    );
}

const LightSample NO_LIGHT_SAMPLE = LightSample(NO_INDEX, 0u, 0u);
const ResolvedLightSample BLACK_LIGHT_SAMPLE =
    ResolvedLightSample(0u, 0u, vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, -1.0), 0.0, vec3(0.0), 0.0);

// A sample of any light, drawn and resolved without the tiles.
LightCandidate draw_light_candidate(inout uint rng) {
    if (scene_info.light_count == 0u) { return LightCandidate(NO_LIGHT_SAMPLE, BLACK_LIGHT_SAMPLE); }
    LightSample light_sample = generate_random_light_sample(rng);
    return LightCandidate(light_sample, resolve_light_sample(light_sample));
}

// A random tile. Pixels seed `rng` by their workgroup, so that the pixels of a workgroup read the same memory.
uint choose_light_tile(inout uint rng) {
    return rand_range_u(light_tiles.at.length() / light_tiles.samples_each, rng);
}

LightCandidate sample_light_candidate(uint tile, inout uint rng) {
    uint index = tile * light_tiles.samples_each + rand_range_u(light_tiles.samples_each, rng);
    return LightCandidate(light_tile_samples.at[index], unpack_light_sample(light_tiles.at[index]));
}

#endif
