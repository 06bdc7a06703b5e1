// Diffuse transmission: the part of the diffuse lobe's light that leaves a leaf or a lampshade on its other side, with
// a color of its own. It is Lambert, below the dielectric on either side: KHR_materials_diffuse_transmission.
#ifndef SCENE_LOBES_DIFFUSE_TRANSMISSION_GLSL
#define SCENE_LOBES_DIFFUSE_TRANSMISSION_GLSL

#include "scene/base_material.glsl"
#include "scene/lobes/diffuse.glsl"

// ---- of a material ----------------------------------------------------------------------------------

struct DiffuseTransmissionParameters {
    float weight;  // the share of the diffuse lobe that it replaces
    vec3 color;
};

const DiffuseTransmissionParameters NO_DIFFUSE_TRANSMISSION = DiffuseTransmissionParameters(0.0, vec3(1.0));

DiffuseTransmissionParameters resolve_diffuse_transmission(Material material, TexturePoint point) {
    return DiffuseTransmissionParameters(
        material.diffuse_transmission * sampled_or_one(material.diffuse_transmission_texture, point, 3u),
        material.diffuse_transmission_color * sampled_color_or_one(material.diffuse_transmission_color_texture, point)
    );
}

// weight 8, color 3x8
uint pack_diffuse_transmission(DiffuseTransmissionParameters lobe) {
    return pack_unorm(lobe.weight, 8u) | pack_unorm(lobe.color.x, 8u) << 8u | pack_unorm(lobe.color.y, 8u) << 16u
        | pack_unorm(lobe.color.z, 8u) << 24u;
}

DiffuseTransmissionParameters unpack_diffuse_transmission(uint bits) {
    return DiffuseTransmissionParameters(
        unpack_unorm(bits, 8u),
        vec3(unpack_unorm(bits >> 8u, 8u), unpack_unorm(bits >> 16u, 8u), unpack_unorm(bits >> 24u, 8u))
    );
}

// ---- seen from a direction --------------------------------------------------------------------------

// The diffuse lobe of the other side, and how often samples of the diffuse lobe take it.
struct DiffuseTransmission {
    Diffuse beyond;
    float probability;
};

// `reflected` is the color of the diffuse lobe on the side of wo. See prepare_diffuse.
DiffuseTransmission prepare_diffuse_transmission(vec3 color, vec3 reflected, Specular specular, vec3 dielectric) {
    float share = luminance(color);
    return DiffuseTransmission(
        prepare_diffuse(color, specular, dielectric), share > 0.0 ? share / (share + luminance(reflected)) : 0.0
    );
}

// wo is above the surface, wi below.
vec3 evaluate_diffuse_transmission(DiffuseTransmission lobe, Specular specular, vec3 wo, vec3 wi) {
    return evaluate_diffuse(lobe.beyond, specular, wo, vec3(wi.xy, -wi.z));
}

// What it adds to the pdf of the diffuse lobe.
float diffuse_transmission_pdf(DiffuseTransmission lobe, vec3 wi) { return -lobe.probability * diffuse_pdf(wi); }

// ---- as a row of scene/lobes/list.glsl ----------------------------------------------------------------

DiffuseTransmissionParameters resolve_lobe(
    DiffuseTransmissionParameters none, Material material, TexturePoint point
) {
    return resolve_diffuse_transmission(material, point);
}

uint pack_lobe(DiffuseTransmissionParameters lobe, mat3 frame) { return pack_diffuse_transmission(lobe); }

DiffuseTransmissionParameters unpack_lobe(DiffuseTransmissionParameters none, uint bits, mat3 frame) {
    return unpack_diffuse_transmission(bits);
}

#endif
