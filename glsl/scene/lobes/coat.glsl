// The clearcoat: a layer of GGX over all other lobes.
#ifndef SCENE_LOBES_COAT_GLSL
#define SCENE_LOBES_COAT_GLSL

#include "scene/base_material.glsl"
#include "scene/brdf_table.glsl"
#include "scene/lobes/interface.glsl"
#include "scene/microfacet.glsl"

const float COAT_F0 = 0.04;  // of an index of refraction of 1.5

// ---- of a material ----------------------------------------------------------------------------------

struct CoatParameters {
    float weight;
    float perceptual_roughness;
    vec3 normal;
    vec3 surface_normal;  // the geometric one, on the side from which the surface is seen
};

const CoatParameters NO_COAT = CoatParameters(0.0, 0.0, vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, 1.0));

// Without its normals.
CoatParameters resolve_coat(Material material, TexturePoint point) {
    return CoatParameters(
        material.clearcoat * sampled_or_one(material.clearcoat_texture, point, 0u),
        material.clearcoat_roughness * sampled_or_one(material.clearcoat_roughness_texture, point, 1u),
        NO_COAT.normal, NO_COAT.surface_normal
    );
}

// weight 8, roughness 8 | normal octahedral 2x16, in world space. `frame` is that of the shading normal.
uvec2 pack_coat(CoatParameters coat, mat3 frame) {
    return uvec2(
        pack_unorm(coat.weight, 8u) | pack_unorm(coat.perceptual_roughness, 8u) << 8u,
        pack_octahedral_2x16(frame * coat.normal)
    );
}

// Without `surface_normal`.
CoatParameters unpack_coat(uvec2 bits, mat3 frame) {
    return CoatParameters(
        unpack_unorm(bits.x, 8u), unpack_unorm(bits.x >> 8u, 8u), unpack_octahedral_2x16(bits.y) * frame,
        NO_COAT.surface_normal
    );
}

// ---- seen from a direction --------------------------------------------------------------------------

struct Coat {
    float weight;
    float roughness;
    float perceptual_roughness;
    mat3 frame;  // its z axis is the coat's normal
    vec3 wo;     // in that frame
    vec3 surface_normal;
    float pdf_per_d;
    float multiscatter;
    bool inside;  // wo is below it
};

bool is_mirror_coat(Coat coat) { return coat.roughness <= MIRROR_ROUGHNESS; }

// Whether there is a coat, and it reflects in more than one direction.
bool is_rough_coat(Coat coat) { return coat.weight > 0.0 && !is_mirror_coat(coat); }

vec2 coat_albedo_terms(float perceptual_roughness, float cosine) {
    return albedo_terms(square(perceptual_roughness) <= MIRROR_ROUGHNESS, perceptual_roughness, cosine);
}

// The share of uniform incoming light that the coat reflects.
float coat_albedo(float weight, float perceptual_roughness, float cosine) {
    return weight * specular_albedo(vec3(COAT_F0), coat_albedo_terms(perceptual_roughness, cosine)).x;
}

Coat prepare_coat(CoatParameters parameters, bool inside, vec3 wo) {
    Coat coat;
    coat.frame = orthonormalize(parameters.normal);
    coat.wo = wo * coat.frame;
    coat.surface_normal = parameters.surface_normal;
    coat.inside = inside;
    coat.weight = inside || !(coat.wo.z > 0.0) ? 0.0 : parameters.weight;
    coat.perceptual_roughness = parameters.perceptual_roughness;
    coat.roughness = square(coat.perceptual_roughness);
    vec2 ab = coat_albedo_terms(coat.perceptual_roughness, coat.wo.z);
    coat.multiscatter = 1.0 / (ab.x + ab.y) - 1.0;
    coat.pdf_per_d = 0.0;
    if (is_rough_coat(coat)) {
        coat.pdf_per_d = ggx_vndf_pdf_per_d(coat.wo, coat.roughness);
    }
    return coat;
}

// The largest share of light that the coat keeps from what lies below it, for light from wi to wo. Directions within a
// volume don't pass it.
float lobe_cover(Coat coat, vec3 wo, vec3 wi) {
    bool wi_inside = wi.z < 0.0 != coat.inside;
    float roughness = coat.perceptual_roughness;
    float seen = coat.inside ? 0.0 : coat_albedo(coat.weight, roughness, abs(coat.wo.z));
    float lit = wi_inside ? 0.0 : coat_albedo(coat.weight, roughness, abs(dot(wi, coat.frame[2])));
    return max(seen, lit);
}

// Whether a direction is above the surface, whose base may be tilted by a normal map.
bool is_above_surface(Coat coat, vec3 wi) { return dot(wi, coat.surface_normal) > 0.0; }

float coat_fresnel(Coat coat, float cosine) {
    return coat.weight * fresnel(vec3(COAT_F0), cosine).x * (1.0 + COAT_F0 * coat.multiscatter);
}

float evaluate_coat(Coat coat, vec3 wi) {
    vec3 coat_wi = wi * coat.frame;
    if (!is_rough_coat(coat) || !(coat_wi.z > 0.0)) { return 0.0; }
    vec3 half_vector = normalize(coat.wo + coat_wi);
    float V = V_SmithGGXCorrelated(coat.roughness, coat.wo.z, coat_wi.z);
    return coat_fresnel(coat, dot(coat_wi, half_vector)) * D_GGX(coat.roughness, half_vector) * V * coat_wi.z;
}

float coat_pdf(Coat coat, vec3 wi) {
    vec3 coat_wi = wi * coat.frame;
    if (!is_rough_coat(coat) || !(coat_wi.z > 0.0)) { return 0.0; }
    return coat.pdf_per_d * D_GGX(coat.roughness, normalize(coat.wo + coat_wi));
}

vec3 sample_coat(Coat coat, vec2 u) {
    vec3 wo = coat.wo;
    vec3 wi = is_mirror_coat(coat) ? vec3(-wo.xy, wo.z) : sample_ggx_vndf(wo, coat.roughness, u);
    return wi.z > 0.0 ? coat.frame * wi : vec3(0.0);
}

// ---- as a row of scene/lobes/list.glsl ----------------------------------------------------------------

CoatParameters resolve_lobe(CoatParameters none, Material material, TexturePoint point) {
    return resolve_coat(material, point);
}

uvec2 pack_lobe(CoatParameters coat, mat3 frame) { return pack_coat(coat, frame); }
CoatParameters unpack_lobe(CoatParameters none, uvec2 bits, mat3 frame) { return unpack_coat(bits, frame); }

void limit_roughness(inout CoatParameters coat, float smallest) {
    coat.perceptual_roughness = max(coat.perceptual_roughness, smallest);
}

Coat prepare_lobe(CoatParameters parameters, BaseMaterial base, vec3 wo) {
    return prepare_coat(parameters, base.inside, wo);
}

LobeAlbedo lobe_albedo(CoatParameters coat, BaseMaterial base, vec3 wo) {
    float albedo = coat_albedo(coat.weight, coat.perceptual_roughness, max(dot(wo, coat.normal), 0.0));
    return LobeAlbedo(vec3(1.0), base.inside ? 0.0 : albedo, false);
}

LobeAlbedo lobe_albedo(Coat coat, vec3 wo) {
    float albedo = coat_albedo(coat.weight, coat.perceptual_roughness, coat.wo.z);
    return LobeAlbedo(vec3(1.0), coat.inside ? 0.0 : albedo, false);
}

vec3 diffuse_value(Coat coat, vec3 wo, vec3 wi) { return vec3(0.0); }
vec3 specular_value(Coat coat, vec3 wo, vec3 wi) {
    return vec3(is_above_surface(coat, wi) ? evaluate_coat(coat, wi) : 0.0);
}

float lobe_pdf(Coat coat, vec3 wo, vec3 wi) { return is_above_surface(coat, wi) ? coat_pdf(coat, wi) : 0.0; }

LobeSample sample_lobe(Coat coat, vec3 wo, float choice, vec2 u) {
    vec3 wi = sample_coat(coat, u);
    // What a coat sends below the surface is no sample of a lobe that transmits.
    if (!is_above_surface(coat, wi)) { return invalid_lobe_sample(); }
    if (!is_mirror_coat(coat)) { return spread_sample(wi, false); }
    return mirrored_sample(wi, vec3(1.0), coat_fresnel(coat, coat.wo.z));
}

float lobe_spread(Coat coat, float probability) { return is_rough_coat(coat) ? coat.perceptual_roughness : 0.0; }
void remove_diffuse(inout Coat coat) {}
void leave_out(inout Coat coat) { coat = prepare_coat(NO_COAT, false, vec3(0.0, 0.0, 1.0)); }

#endif
