// A material at a surface point, seen from one side, with the parameters of all lobes of scene/lobes/list.glsl.
#ifndef SCENE_MATERIAL_GLSL
#define SCENE_MATERIAL_GLSL

#include "scene/base_material.glsl"
#include "scene/lobes/list.glsl"

// Directions are in the frame orthonormalize(shading normal).
#define PARAMETERS(name, Lobe, Parameters, NONE, FEATURE, Bits) Parameters name;
struct ResolvedMaterial {
    BaseMaterial base;
    vec3 emissive;
    ALL_LOBES(PARAMETERS)
};

#define LEAVE_OUT(name, Lobe, Parameters, NONE, FEATURE, Bits) material.name = NONE;
ResolvedMaterial without_lobes(BaseMaterial base, vec3 emissive) {
    ResolvedMaterial material;
    material.base = base;
    material.emissive = emissive;
    ALL_LOBES(LEAVE_OUT)
    return material;
}

// Sampled at the finest level for every ray, so that light samples and rays that hit the light see the same radiance.
vec3 resolve_emissive(Material material, TexturePoint point) {
    if (material.emissive_texture == NO_INDEX) { return material.emissive; }
    point.footprint_lod = FINEST_LOD;
    return material.emissive * sample_texture(material.emissive_texture, point).rgb;
}

// All but directions: that of anisotropy is still in tangent space.
#define RESOLVE(name, Lobe, Parameters, NONE, FEATURE, Bits) \
    if (FEATURE) { resolved.name = resolve_lobe(NONE, material, point); }
ResolvedMaterial resolve_material(Material material, vec3 vertex_color, TexturePoint point, bool front_face) {
    BaseMaterial base = resolve_base(material, vertex_color, point, front_face);
    ResolvedMaterial resolved = without_lobes(base, resolve_emissive(material, point));
    ALL_LOBES(RESOLVE)
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

// ---- packing, for the G-buffer ----------------------------------------------------------------------

#define PACKED(name, Lobe, Parameters, NONE, FEATURE, Bits) Bits name;
struct PackedLobes {
    uvec2 base;
    uint film;
    ALL_LOBES(PACKED)
};

#define LEAVE_EMPTY(name, Lobe, Parameters, NONE, FEATURE, Bits) packed.name = Bits(0u);
PackedLobes no_packed_lobes() {
    PackedLobes packed;
    packed.base = uvec2(0u);
    packed.film = 0u;
    ALL_LOBES(LEAVE_EMPTY)
    return packed;
}

// `packed_normal` is the shading normal as the G-buffer has it, to whose frame directions are packed.
#define PACK(name, Lobe, Parameters, NONE, FEATURE, Bits) packed.name = pack_lobe(material.name, frame);
PackedLobes pack_lobes(ResolvedMaterial material, vec3 world_normal, vec3 packed_normal) {
    mat3 frame = orthonormalize(world_normal), packed_frame = orthonormalize(packed_normal);
    PackedLobes packed;
    packed.base = pack_base(material.base, frame, packed_frame);
    packed.film = pack_film(material.base.film);
    ALL_LOBES(PACK)
    return packed;
}

#define UNPACK(name, Lobe, Parameters, NONE, FEATURE, Bits) material.name = unpack_lobe(NONE, packed.name, frame);
ResolvedMaterial unpack_lobes(
    ResolvedMaterial material, PackedLobes packed, vec3 world_normal, vec3 geometric_world_normal
) {
    mat3 frame = orthonormalize(world_normal);
    if (SCENE_IRIDESCENCE) { material.base.film = unpack_film(packed.film); }
    material.base = unpack_base(material.base, packed.base);
    ALL_LOBES(UNPACK)
    material.coat.surface_normal = geometric_world_normal * frame;
    return material;
}

#endif
