// The lobes that few materials have, at a surface point: glass, and what lies over or changes the specular lobe.
#ifndef SCENE_MATERIAL_LOBES_GLSL
#define SCENE_MATERIAL_LOBES_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/textures.glsl"

// Directions are in the frame orthonormalize(shading normal).
struct MaterialLobes {
    float transmission;  // the share of a dielectric's base that is glass instead of diffuse
    float ior;           // its index of refraction
    bool solid;          // whether light enters a volume; otherwise it passes a thin wall
    bool inside;         // whether the surface is seen from within its volume
    bool passed_straight;  // whether rays have found the light that passes straight
    float specular_weight;  // of a dielectric's reflections
    float coat;
    float coat_roughness;   // perceptual
    vec3 coat_normal;
    vec3 sheen_color;
    float sheen_roughness;  // perceptual
    float anisotropy;       // strength
    vec2 anisotropy_direction;  // along which the specular lobe is rougher
};

const MaterialLobes NO_LOBES = MaterialLobes(
    0.0, 1.5, false, false, false, 1.0, 0.0, 0.0, vec3(0.0, 0.0, 1.0), vec3(0.0), 0.0, 0.0, vec2(1.0, 0.0)
);

float sampled_or_one(uint texture_index, TexturePoint point, uint channel) {
    return texture_index == NO_INDEX ? 1.0 : sample_texture(texture_index, point)[channel];
}

vec3 resolve_reflectance(Material material, TexturePoint point) {
    if (!SCENE_LAYERS || material.specular_color_texture == NO_INDEX) { return material.reflectance; }
    return material.reflectance * sqrt(sample_texture(material.specular_color_texture, point).rgb);
}

// The lobes but for their directions: the anisotropy's is still in tangent space.
MaterialLobes resolve_lobes(Material material, TexturePoint point, bool front_face) {
    MaterialLobes lobes = NO_LOBES;
    if (SCENE_GLASS) {
        lobes.transmission = material.transmission * sampled_or_one(material.transmission_texture, point, 0u);
        lobes.ior = material.ior;
        lobes.solid = (material.flags & MATERIAL_SOLID) != 0u;
        lobes.inside = lobes.solid && material.transmission > 0.0 && !front_face;
    }
    if (SCENE_LAYERS) {
        lobes.specular_weight = material.specular * sampled_or_one(material.specular_texture, point, 3u);
        lobes.coat = material.clearcoat * sampled_or_one(material.clearcoat_texture, point, 0u);
        lobes.coat_roughness = material.clearcoat_roughness
            * sampled_or_one(material.clearcoat_roughness_texture, point, 1u);
        lobes.sheen_color = material.sheen_color;
        if (material.sheen_color_texture != NO_INDEX) {
            lobes.sheen_color *= sample_texture(material.sheen_color_texture, point).rgb;
        }
        lobes.sheen_roughness = material.sheen_roughness
            * sampled_or_one(material.sheen_roughness_texture, point, 3u);
        lobes.anisotropy = material.anisotropy;
        vec2 along = vec2(cos(material.anisotropy_rotation), sin(material.anisotropy_rotation));
        lobes.anisotropy_direction = along;
        if (material.anisotropy_texture != NO_INDEX) {
            vec3 texel = sample_texture(material.anisotropy_texture, point).rgb;
            vec2 turned = mat2(along, vec2(-along.y, along.x)) * (2.0 * texel.xy - 1.0);
            lobes.anisotropy *= texel.z;
            lobes.anisotropy_direction = safe_normalize(vec3(turned, 0.0), vec3(along, 0.0)).xy;
        }
    }
    return lobes;
}

// Turns the lobes' directions from the world and from tangent space to the shading normal's frame. Without tangents a
// material reflects alike in all directions.
void orient_lobes(inout MaterialLobes lobes, vec3 shading_normal, vec3 coat_normal, mat3 tangent_frame) {
    mat3 frame = orthonormalize(shading_normal);
    lobes.coat_normal = coat_normal * frame;
    vec2 along = ((mat2x3(tangent_frame[0], tangent_frame[1]) * lobes.anisotropy_direction) * frame).xy;
    if (along == vec2(0.0)) {
        lobes.anisotropy = 0.0;
    } else {
        lobes.anisotropy_direction = normalize(along);
    }
}

#endif
