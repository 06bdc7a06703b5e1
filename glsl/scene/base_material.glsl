// The base of a material at a surface point: what the diffuse and the specular lobe need, and other lobes too.
#ifndef SCENE_BASE_MATERIAL_GLSL
#define SCENE_BASE_MATERIAL_GLSL

#include "common/math.glsl"
#include "common/packing.glsl"
#include "scene/bindings.glsl"
#include "scene/lobes/iridescence.glsl"
#include "scene/textures.glsl"

// All surfaces are Lambertian, base color / pi, for comparison with closed forms.
layout(constant_id = lambertian_surfaces_id) const bool lambertian_surfaces = false;

struct BaseMaterial {
    vec3 color;
    vec3 reflectance;           // of a dielectric: see reflectance_f0
    float perceptual_roughness;
    float roughness;            // its square: alpha of GGX
    float metallic;
    bool solid;                 // whether light that passes enters a volume; otherwise it passes a thin wall
    bool inside;                // whether the surface is seen from within its volume
    float specular_weight;      // of a dielectric's reflections
    float anisotropy;           // strength
    vec2 anisotropy_direction;  // along which reflections are rougher, in the frame orthonormalize(shading normal)
    ThinFilm film;
    bool unlit;                 // reflects nothing, at grazing angles too
};

BaseMaterial make_base(vec3 color, vec3 reflectance, float perceptual_roughness, float metallic) {
    float roughness = min(square(perceptual_roughness), 1.0);  // Mesa 26.2 rounds 1 * 1 up
    return BaseMaterial(
        color, reflectance, perceptual_roughness, roughness, metallic, false, false, 1.0, 0.0, vec2(1.0, 0.0), NO_FILM,
        false
    );
}

// ---- textures ---------------------------------------------------------------------------------------

float sampled_or_one(uint texture_index, TexturePoint point, uint channel) {
    return texture_index == NO_INDEX ? 1.0 : sample_texture(texture_index, point)[channel];
}

vec3 sampled_color_or_one(uint texture_index, TexturePoint point) {
    return texture_index == NO_INDEX ? vec3(1.0) : sample_texture(texture_index, point).rgb;
}

vec3 resolve_reflectance(Material material, TexturePoint point) {
    if (!SCENE_LAYERS || material.specular_color_texture == NO_INDEX) { return material.reflectance; }
    return material.reflectance * sqrt(sample_texture(material.specular_color_texture, point).rgb);
}

float resolve_specular_weight(Material material, TexturePoint point) {
    return SCENE_LAYERS ? material.specular * sampled_or_one(material.specular_texture, point, 3u) : 1.0;
}

// The direction is still in tangent space.
void resolve_anisotropy(inout BaseMaterial base, Material material, TexturePoint point) {
    base.anisotropy = material.anisotropy;
    vec2 along = vec2(cos(material.anisotropy_rotation), sin(material.anisotropy_rotation));
    base.anisotropy_direction = along;
    if (material.anisotropy_texture == NO_INDEX) { return; }
    vec3 texel = sample_texture(material.anisotropy_texture, point).rgb;
    vec2 turned = mat2(along, vec2(-along.y, along.x)) * (2.0 * texel.xy - 1.0);
    base.anisotropy *= texel.z;
    base.anisotropy_direction = safe_normalize(vec3(turned, 0.0), vec3(along, 0.0)).xy;
}

// Turns the direction of anisotropy from tangent space to the frame of the shading normal. Without tangents a material
// reflects alike in all directions.
void orient_anisotropy(inout BaseMaterial base, mat3 frame, mat3 tangent_frame) {
    vec2 along = ((mat2x3(tangent_frame[0], tangent_frame[1]) * base.anisotropy_direction) * frame).xy;
    if (along == vec2(0.0)) {
        base.anisotropy = 0.0;
    } else {
        base.anisotropy_direction = normalize(along);
    }
}

ThinFilm resolve_film(Material material, TexturePoint point) {
    vec2 thickness = material.iridescence_thickness;
    return ThinFilm(
        material.iridescence * sampled_or_one(material.iridescence_texture, point, 0u), material.iridescence_ior,
        mix(thickness.x, thickness.y, sampled_or_one(material.iridescence_thickness_texture, point, 1u))
    );
}

BaseMaterial resolve_base(Material material, vec3 vertex_color, TexturePoint point, bool front_face) {
    vec3 color = material.base_color * vertex_color;
    if (material.base_color_texture != NO_INDEX) { color *= sample_texture(material.base_color_texture, point).rgb; }
    float perceptual_roughness = material.perceptual_roughness, metallic = material.metallic;
    if (material.metallic_roughness_texture != NO_INDEX) {
        vec2 factors = sample_texture(material.metallic_roughness_texture, point).gb;
        perceptual_roughness *= factors.x;
        metallic *= factors.y;
    }
    BaseMaterial base = make_base(color, resolve_reflectance(material, point), perceptual_roughness, metallic);
    base.specular_weight = resolve_specular_weight(material, point);
    if (SCENE_LAYERS) { resolve_anisotropy(base, material, point); }
    if (SCENE_IRIDESCENCE) { base.film = resolve_film(material, point); }
    if (SCENE_TRANSMISSION) {
        base.solid = (material.flags & MATERIAL_SOLID) != 0u;
        base.inside = base.solid && !front_face;
    }
    return base;
}

// ---- packing of what the G-buffer has no other place for --------------------------------------------

// specular weight 8, anisotropy 8, its direction 8, solid 1, inside 1 | reflectance rgb9e5. `frame` is that of the
// direction, `packed_frame` that of the packed normal.
uvec2 pack_base(BaseMaterial base, mat3 frame, mat3 packed_frame) {
    vec2 along = (frame * vec3(base.anisotropy_direction, 0.0) * packed_frame).xy;
    float turn = fract(atan(along.y, along.x) / (2.0 * PI));
    uint bits = pack_unorm(base.specular_weight, 8u) | pack_unorm(base.anisotropy, 8u) << 8u
        | (uint(turn * 256.0 + 0.5) & 0xFFu) << 16u | uint(base.solid) << 24u | uint(base.inside) << 25u;
    return uvec2(bits, pack_rgb9e5(base.reflectance));
}

BaseMaterial unpack_base(BaseMaterial base, uvec2 packed) {
    uint bits = packed.x;
    base.reflectance = unpack_rgb9e5(packed.y);
    base.specular_weight = unpack_unorm(bits, 8u);
    base.anisotropy = unpack_unorm(bits >> 8u, 8u);
    float angle = float(bits >> 16u & 0xFFu) * (2.0 * PI / 256.0);
    base.anisotropy_direction = vec2(cos(angle), sin(angle));
    base.solid = (bits >> 24u & 1u) != 0u;
    base.inside = (bits >> 25u & 1u) != 0u;
    return base;
}

#endif
