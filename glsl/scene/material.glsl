// A material at a surface point, seen from one side, with the list of the lobes that few materials have. What a lobe is
// stands in its file in scene/lobes; scene/brdf.glsl lists how they reflect.
#ifndef SCENE_MATERIAL_GLSL
#define SCENE_MATERIAL_GLSL

#include "scene/base_material.glsl"
#include "scene/lobes/coat.glsl"
#include "scene/lobes/diffuse_transmission.glsl"
#include "scene/lobes/glass.glsl"
#include "scene/lobes/sheen.glsl"

// Directions are in the frame orthonormalize(shading normal).
struct ResolvedMaterial {
    BaseMaterial base;
    vec3 emissive;
    GlassParameters glass;
    CoatParameters coat;
    SheenParameters sheen;
    DiffuseTransmissionParameters diffuse_transmission;
};

ResolvedMaterial without_lobes(BaseMaterial base, vec3 emissive) {
    return ResolvedMaterial(base, emissive, NO_GLASS, NO_COAT, NO_SHEEN, NO_DIFFUSE_TRANSMISSION);
}

// Sampled at the finest level for every ray, so that light samples and rays that hit the light see the same radiance.
vec3 resolve_emissive(Material material, TexturePoint point) {
    if (material.emissive_texture == NO_INDEX) { return material.emissive; }
    point.footprint_lod = point.second_footprint_lod = FINEST_LOD;
    return material.emissive * sample_texture(material.emissive_texture, point).rgb;
}

// All but directions: that of anisotropy is still in tangent space.
ResolvedMaterial resolve_material(Material material, vec3 vertex_color, TexturePoint point, bool front_face) {
    BaseMaterial base = resolve_base(material, vertex_color, point, front_face);
    ResolvedMaterial resolved = without_lobes(base, resolve_emissive(material, point));
    if (SCENE_GLASS) { resolved.glass = resolve_glass(material, point); }
    if (SCENE_LAYERS) {
        resolved.coat = resolve_coat(material, point);
        resolved.sheen = resolve_sheen(material, point);
    }
    if (SCENE_DIFFUSE_TRANSMISSION) {
        resolved.diffuse_transmission = resolve_diffuse_transmission(material, point);
    }
    return resolved;
}

vec3 transmitted_color(ResolvedMaterial material) {
    return material.diffuse_transmission.color * material.diffuse_transmission.weight * (1.0 - material.base.metallic);
}

// The color of the diffuse lobe, on both sides, without what lies over it.
vec3 diffuse_color(ResolvedMaterial material) {
    vec3 reflected = material.base.color * (1.0 - material.base.metallic);
    if (!SCENE_DIFFUSE_TRANSMISSION) { return reflected; }
    return reflected * (1.0 - material.diffuse_transmission.weight) + transmitted_color(material);
}

// Whether light passes below the surface.
bool transmits(ResolvedMaterial material) {
    if (!SCENE_TRANSMISSION || lambertian_surfaces) { return false; }
    return max(material.glass.transmission, material.diffuse_transmission.weight) > 0.0 && material.base.metallic < 1.0;
}

// What layers reflect, and let pass to what lies below them, towards a direction. Each layer takes from the light below
// what it reflects, as glTF orders them: a coat over sheen over all else.
struct LayerAlbedos {
    float coat;
    float sheen;        // of white fibers, without the coat
    float below_sheen;
};

// `coat` is its weight; `cosine` and `coat_cosine` are those of the direction with the two normals.
LayerAlbedos layer_albedos(ResolvedMaterial material, float coat, float cosine, float coat_cosine) {
    if (material.base.inside) { return LayerAlbedos(0.0, 0.0, 1.0); }
    float sheen = sheen_albedo(material.sheen.perceptual_roughness, cosine);
    return LayerAlbedos(
        coat_albedo(coat, material.coat.perceptual_roughness, coat_cosine), sheen,
        1.0 - max_component(material.sheen.color) * sheen
    );
}

// ---- packing, for the G-buffer ----------------------------------------------------------------------

struct PackedLobes {
    uvec2 base;
    uint glass;
    uvec2 coat;
    uint sheen;
    uint diffuse_transmission;
    uint film;
};

const PackedLobes NO_PACKED_LOBES = PackedLobes(uvec2(0u), 0u, uvec2(0u), 0u, 0u, 0u);

// `packed_normal` is the shading normal as the G-buffer has it, to whose frame directions are packed.
PackedLobes pack_lobes(ResolvedMaterial material, vec3 world_normal, vec3 packed_normal) {
    mat3 frame = orthonormalize(world_normal), packed_frame = orthonormalize(packed_normal);
    return PackedLobes(
        pack_base(material.base, frame, packed_frame), pack_glass(material.glass), pack_coat(material.coat, frame),
        pack_sheen(material.sheen), pack_diffuse_transmission(material.diffuse_transmission),
        pack_film(material.base.film)
    );
}

ResolvedMaterial unpack_lobes(ResolvedMaterial material, PackedLobes packed, vec3 world_normal) {
    if (SCENE_IRIDESCENCE) { material.base.film = unpack_film(packed.film); }
    return ResolvedMaterial(
        unpack_base(material.base, packed.base), material.emissive, unpack_glass(packed.glass),
        unpack_coat(packed.coat, orthonormalize(world_normal)), unpack_sheen(packed.sheen),
        unpack_diffuse_transmission(packed.diffuse_transmission)
    );
}

#endif
