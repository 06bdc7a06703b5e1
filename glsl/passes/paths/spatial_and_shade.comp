// Reuse between neighbors: merges a pixel's reservoir with that of a neighbor, keeps the result for the next frame, and
// adds the light of both samples to the pixel. Lin et al., "Generalized Resampled Importance Sampling" (2022).
#version 460
#include "common/pixel.glsl"
#include "passes/demodulation.glsl"
#include "passes/paths/reservoir.glsl"
#include "passes/reuse.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x51ED270Bu;

// The distance from a vertex to the reservoir's sample.
float sample_distance(Vertex vertex, PathReservoir reservoir) {
    if (is_path_sample(reservoir)) { return distance(vertex.origin, hit_position(reservoir)); }
    ResolvedLightSample light = resolve_light_point(reservoir);
    return is_at_infinity(light.kind) ? INFINITY : distance(vertex.origin, light.world_position);
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    uint index;
    if (!find_pixel(pixel, index)) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    Merge merged = Merge(paths_temporal_reservoirs.at[index], ZERO_LOBES);
    if (surface.exists) {
        uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
        Vertex vertex = make_vertex(dispersed(surface, pixel));
        uvec2 neighbor;
        GBufferSurface neighbor_surface, other_surface = surface;
        PathReservoir other = EMPTY_RESERVOIR;
        if (!is_dispersive(surface)
            && find_spatial_neighbor(pixel, surface, restir_settings.radius, rng, neighbor, neighbor_surface)
            && !is_dispersive(neighbor_surface)) {
            other_surface = neighbor_surface;
            other = paths_temporal_reservoirs.at[element_index(neighbor, camera.size)];
        }
        merged = merge_reservoirs(
            vertex, merged.reservoir, make_vertex(other_surface), other, false,
            vec2(other.confidence), rand_f(rng)
        );
        Demodulation albedo = demodulation(surface);
        paths_diffuse.at[index].rgb += merged.light.diffuse / albedo.diffuse;
        paths_specular.at[index].rgb += merged.light.specular / albedo.specular;
        if (merged.reservoir.weight > 0.0) {
            float distance = sample_distance(vertex, merged.reservoir);
            paths_diffuse.at[index].w = distance;
            if (reuses_specular(surface.material.base.perceptual_roughness)) { paths_specular.at[index].w = distance; }
        }
    }
    paths_reservoirs.at[index] = merged.reservoir;
}
