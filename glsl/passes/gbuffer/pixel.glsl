// The values of a G-buffer pixel, from a hit that raster or a ray found, or for a pixel without a surface.
#ifndef PASSES_GBUFFER_PIXEL_GLSL
#define PASSES_GBUFFER_PIXEL_GLSL

#include "common/random.glsl"
#include "passes/gbuffer/gbuffer.glsl"

const uint GBUFFER_SALT = 0x8DA6B343u;

// Decides which blended surfaces a pixel shows in this frame (see alpha_threshold). Bits that a hash of the seed flips
// keep blocks of pixels and frames together.
uvec2 pixel_alpha_seed(uvec2 pixel) {
    uvec2 bits = (pixel | pixel << 8u) & 0x00FF00FFu;
    bits = (bits | bits << 4u) & 0x0F0F0F0Fu;
    bits = (bits | bits << 2u) & 0x33333333u;
    bits = (bits | bits << 1u) & 0x55555555u;
    uvec2 at = uvec2(bits.x | bits.y << 1u, this_frame.index);
    return at ^ pcg4d(uvec4(this_frame.seed ^ GBUFFER_SALT, 0u, 0u, 0u)).xy;
}

struct GBufferPixel {
    uvec4 gbuffer;
    PackedLobes lobes;
    uvec2 surface;
    uint offsets;
    float depth;
    vec2 motion;
};

GBufferPixel resolve_pixel(CameraRay ray, Hit hit, Mesh mesh) {
    SurfaceInteraction surface =
        resolve_surface_interaction(hit, mesh, ray.direction, ray.cone_width + ray.cone_spread * hit.t);
    vec3 emissive = shown_emission(surface);
    // Passes reconstruct positions from depth along the pixel's ray, so the depth is that of the ray's intersection
    // with the triangle's plane. The point that was found may lie beside the ray, by rounding or because raster snaps
    // vertices; its own depth would move the reconstructed position off the plane.
    float cosine = dot(ray.direction, surface.geometric_world_normal);
    float t = dot(surface.world_position - ray.origin, surface.geometric_world_normal) / cosine;
    float view_depth = (cosine < -1e-3 ? t : hit.t) * ray.depth_per_t;
    // Raster snaps vertices to 1/256 of a pixel, so that a pixel may show a triangle just beyond its edge, which is
    // behind the next triangle in a crease.
    float snapped = (ray.cone_width + ray.cone_spread * hit.t) / 256.0;
    uvec4 gbuffer_texel = pack_gbuffer(surface.material, emissive, surface.world_normal);
    PackedLobes lobes = no_packed_lobes();
    if (SCENE_LOBES) {
        lobes = pack_lobes(surface.material, surface.world_normal, unpack_octahedral_24(gbuffer_texel.w));
    }
    return GBufferPixel(
        gbuffer_texel,
        lobes,
        uvec2(pack_octahedral_2x16(surface.geometric_world_normal), hit.instance),
        pack_halves_up(gbuffer_ray_offset(surface, hit.instance, view_depth) + snapped, surface.lift),
        camera.near / view_depth,
        hit_motion_vector(hit, mesh)
    );
}

GBufferPixel resolve_empty_pixel(CameraRay ray) {
    return GBufferPixel(uvec4(0u), no_packed_lobes(), uvec2(0u, NO_INDEX), 0u, 0.0, background_motion_vector(ray));
}

void store_pixel(uvec2 place, GBufferPixel pixel) {
    ivec2 at = texel_of(place);
    imageStore(gbuffer, at, pixel.gbuffer);
    if (SCENE_LOBES) { gbuffer_lobes.at[element_index(place, camera.size)] = pixel.lobes; }
    imageStore(gbuffer_surface, at, uvec4(pixel.surface, 0u, 0u));
    imageStore(gbuffer_offsets, at, uvec4(pixel.offsets));
    imageStore(depth, at, vec4(pixel.depth));
    imageStore(motion_vectors, at, vec4(pixel.motion, 0.0, 0.0));
}

#endif
