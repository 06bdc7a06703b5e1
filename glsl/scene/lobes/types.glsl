// A material seen from one direction: what its lobes need for all incoming directions.
#ifndef SCENE_LOBES_TYPES_GLSL
#define SCENE_LOBES_TYPES_GLSL

#include "generated/settings/layering.glsl"
#include "scene/lobes/coat.glsl"
#include "scene/lobes/glass.glsl"
#include "scene/lobes/sheen.glsl"

layout(constant_id = brdf_layering_id) const uint brdf_layering = LAYERING_CONSERVING;
// Every surface is base_color / pi, for comparison with closed forms.
layout(constant_id = brdf_lambert_id) const bool brdf_lambert = false;

const bool HAS_LOBES = SCENE_GLASS || SCENE_LAYERS;

struct Brdf {
    vec3 diffuse_color;  // for LAYERING_CONSERVING reduced by what the specular layer reflects towards wo
    vec3 dielectric_f0;
    vec3 metal_f0;
    float metallic;
    float roughness;
    float perceptual_roughness;
    bool mirror;
    float multiscatter;          // 1 / Ess(wo) - 1, where Ess is the single-scattering albedo
    float pdf_per_d;             // ggx_vndf_pdf_per_d
    // With which sample_brdf takes the specular lobe instead of the diffuse one.
    float specular_probability;
    float layer_weight;  // of a dielectric's specular lobe
    float transmission;  // the share of the dielectric that is glass
    // Where HAS_LOBES:
    float anisotropy;  // strength
    vec2 anisotropic_roughness;
    vec2 anisotropy_direction;
    Coat coat;
    Sheen sheen;
    Glass glass;
    vec3 lobe_probabilities;  // with which sample_brdf takes the coat, sheen and glass
};

#endif
