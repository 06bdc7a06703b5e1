// Adding the light of a path to its pixel.
#ifndef PASSES_PATHS_PIXEL_GLSL
#define PASSES_PATHS_PIXEL_GLSL

#include "passes/gbuffer/gbuffer.glsl"
#include "passes/demodulation.glsl"
#include "passes/paths/candidate.glsl"
#include "passes/paths/path_state.glsl"

// The light of a path after its first ray, and after later ones, where reservoirs don't get it.
PerLobe first_light(inout Path path, uint index, float perceptual_roughness) {
    return paths_reuse ? write_candidate(path, index, perceptual_roughness) : path_light(path);
}

PerLobe later_light(Path path, uint index, float perceptual_roughness) {
    PerLobe light = path_light(path);
    if (!paths_reuse) { return light; }
    paths_reservoir_candidates.at[index].radiance += path.reusable_radiance;
    // 0 only for a delta lobe (write_candidate), since the first ray has hit a surface
    bool delta = paths_reservoir_candidates.at[index].path_contribution_weight == 0.0;
    if (delta || !reuses_specular(perceptual_roughness)) {
        light.specular += apply_first_weight(path, path.reusable_radiance).specular;
    }
    return light;
}

// Adds light to a pixel. The first light of a frame replaces that of the last one.
void add_to_pixel(Path path, PerLobe light, GBufferSurface surface, uint index) {
    bool first = path.bounce == 1u;
    Demodulation albedo = demodulation(surface);
    float share = 1.0 / float(samples_per_pixel(index));
    vec4 diffuse = vec4(0.0), specular = vec4(0.0);
    if (!first || paths_wave.sample_index > 0u) {
        diffuse = paths_diffuse.at[index];
        specular = paths_specular.at[index];
    }
    diffuse.rgb += share * light.diffuse / albedo.diffuse;
    specular.rgb += share * light.specular / albedo.specular;
    if (first && path.first_ray_is_diffuse && !(diffuse.w > 0.0)) { diffuse.w = path.hit.t; }
    if (first && !path.first_ray_is_diffuse && !(specular.w > 0.0)) { specular.w = path.hit.t; }
    paths_diffuse.at[index] = diffuse;
    paths_specular.at[index] = specular;
}

#endif
