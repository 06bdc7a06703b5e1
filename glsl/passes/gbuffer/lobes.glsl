// Packing of the lobes that few materials have, in scenes that have any. Of a surface of the previous frame they are
// unknown: it has none, as only the weights of reused samples depend on it.
#ifndef PASSES_GBUFFER_LOBES_GLSL
#define PASSES_GBUFFER_LOBES_GLSL

#include "common/packing.glsl"
#include "scene/material_lobes.glsl"

// transmission 8, index of refraction 10, solid 1, inside 1, specular weight 8 | coat 8, its roughness 8, roughness of
// sheen 8, anisotropy 8 | color of sheen 3x8, direction of anisotropy 8 | coat's normal octahedral 2x16; of scenes
// without such lobes one texel
layout(set = 1, rgba32ui) uniform uimage2D gbuffer_lobes;

const float LARGEST_IOR_RATIO = 0.75;  // (ior - 1) / (ior + 1) for an index of refraction of 7

// `packed_normal` is the shading normal as the G-buffer has it, to whose frame directions are packed.
uvec4 pack_lobes(MaterialLobes lobes, vec3 world_normal, vec3 packed_normal) {
    mat3 frame = orthonormalize(world_normal), packed_frame = orthonormalize(packed_normal);
    vec2 along = (frame * vec3(lobes.anisotropy_direction, 0.0) * packed_frame).xy;
    float turn = fract(atan(along.y, along.x) / (2.0 * PI));
    float ratio = (lobes.ior - 1.0) / (lobes.ior + 1.0) / LARGEST_IOR_RATIO;
    return uvec4(
        pack_unorm(lobes.transmission, 8u) | pack_unorm(ratio, 10u) << 8u | uint(lobes.solid) << 18u
            | uint(lobes.inside) << 19u | pack_unorm(lobes.specular_weight, 8u) << 20u,
        pack_unorm(lobes.coat, 8u) | pack_unorm(lobes.coat_roughness, 8u) << 8u
            | pack_unorm(lobes.sheen_roughness, 8u) << 16u | pack_unorm(lobes.anisotropy, 8u) << 24u,
        pack_unorm(lobes.sheen_color.x, 8u) | pack_unorm(lobes.sheen_color.y, 8u) << 8u
            | pack_unorm(lobes.sheen_color.z, 8u) << 16u | (uint(turn * 256.0 + 0.5) & 0xFFu) << 24u,
        pack_octahedral_2x16(frame * lobes.coat_normal)
    );
}

MaterialLobes unpack_lobes(uvec4 texel, vec3 world_normal) {
    MaterialLobes lobes = NO_LOBES;
    lobes.transmission = unpack_unorm(texel.x, 8u);
    float ratio = LARGEST_IOR_RATIO * unpack_unorm(texel.x >> 8u, 10u);
    lobes.ior = (1.0 + ratio) / (1.0 - ratio);
    lobes.solid = (texel.x >> 18u & 1u) != 0u;
    lobes.inside = (texel.x >> 19u & 1u) != 0u;
    lobes.specular_weight = unpack_unorm(texel.x >> 20u, 8u);
    lobes.coat = unpack_unorm(texel.y, 8u);
    lobes.coat_roughness = unpack_unorm(texel.y >> 8u, 8u);
    lobes.sheen_roughness = unpack_unorm(texel.y >> 16u, 8u);
    lobes.anisotropy = unpack_unorm(texel.y >> 24u, 8u);
    lobes.sheen_color =
        vec3(unpack_unorm(texel.z, 8u), unpack_unorm(texel.z >> 8u, 8u), unpack_unorm(texel.z >> 16u, 8u));
    float angle = float(texel.z >> 24u) * (2.0 * PI / 256.0);
    lobes.anisotropy_direction = vec2(cos(angle), sin(angle));
    lobes.coat_normal = unpack_octahedral_2x16(texel.w) * orthonormalize(world_normal);
    return lobes;
}

#endif
