// The surface model for tests: samples, values at given directions, the albedo, or its estimate by kinds of lobes, as
// MODE says. The albedo is
// integrated over each lobe, or, for surfaces with all kinds of lobes, over samples.
#version 460
#include "scene/textures.glsl"
#define sample_texture(texture_index, point) vec4(1.0)  // materials here have none
#include "scene/brdf.glsl"

layout(local_size_x = 64) in;

// As support/frames.py numbers them.
const uint MODE_DRAW = 0u, MODE_EVALUATE = 1u, MODE_ALBEDO = 2u, MODE_SAMPLED_ALBEDO = 3u;
const uint MODE_LOBE_ALBEDOS = 4u, RESULT_COUNT = 4u;

layout(constant_id = MODE_id) const uint MODE = MODE_DRAW;

struct TestMaterial {
    Material material;
    uint inside;
    vec3 coat_normal;
    vec2 anisotropy_direction;
};

layout(set = 1, scalar) readonly buffer TestMaterialsBlock { TestMaterial at[]; } test_materials;
// One direction for each row, or one for all.
layout(set = 1, scalar) readonly buffer OutgoingBlock { vec3 at[]; } outgoing;
layout(set = 1, scalar) readonly buffer IncomingBlock { vec3 at[]; } incoming;
layout(set = 1, scalar) buffer ResultsBlock { vec3 at[]; } results;  // rows of RESULT_COUNT

ResolvedMaterial resolve(TestMaterial m) {
    TexturePoint nowhere;  // the materials have no textures
    nowhere.uv = vec2(0.0);
    nowhere.footprint_lod = 0.0;
    nowhere.surface_lod = 0.0;
    ResolvedMaterial material = resolve_material(m.material, vec3(1.0), nowhere, m.inside == 0u);
    material.coat.normal = m.coat_normal;
    material.base.anisotropy_direction = m.anisotropy_direction;
    return material;
}

// Integrates each lobe over the points that its sampling maps to, where the integrand is smooth.
vec3 integrate_albedo(Brdf brdf, vec3 wo) {
    const uint point_count = 4096u;
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < point_count; i++) {
        vec2 u = vec2(fract(float(i) * 0.618033988749895), (float(i) + 0.5) / float(point_count));
        vec3 wi = sample_cosine_hemisphere(u.yx);
        sum += evaluate_diffuse_brdf(brdf, wo, wi) * PI / wi.z;
        if (is_mirror(brdf.specular) || lambertian_surfaces) { continue; }
        float from_end = 1.0 - u.y;
        wi = sample_specular(brdf.specular, wo, vec2(u.x, 1.0 - from_end * from_end));
        if (wi.z > 0.0) {
            float pdf = specular_pdf(brdf.specular, wo, wi);
            sum += 2.0 * from_end * evaluate_specular_brdf(brdf, wo, wi) / pdf;
        }
    }
    bool mirror = is_mirror(brdf.specular) && !lambertian_surfaces;
    return sum / float(point_count) + (mirror ? specular_fresnel(brdf.specular, wo.z) : vec3(0.0));
}

// The mean weight of samples over a lattice (Roberts's R3 sequence).
vec3 sampled_albedo(Brdf brdf, vec3 wo) {
    const uint point_count = 16384u;
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < point_count; i++) {
        vec3 u = fract(float(i) * vec3(0.8191725133961645, 0.6710436067037893, 0.5497004779019703) + 0.5);
        sum += sample_brdf(brdf, wo, u.x, u.yz).weight;
    }
    return sum / float(point_count);
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= results.at.length() / RESULT_COUNT) { return; }
    TestMaterial material = test_materials.at[min(i, test_materials.at.length() - 1u)];
    vec3 wo = outgoing.at[min(i, outgoing.at.length() - 1u)];
    Brdf brdf = prepare_brdf(resolve(material), wo);
    if (MODE == MODE_ALBEDO || MODE == MODE_SAMPLED_ALBEDO) {
        vec3 albedo = MODE == MODE_ALBEDO ? integrate_albedo(brdf, wo) : sampled_albedo(brdf, wo);
        results.at[i * RESULT_COUNT] = albedo;
        return;
    }
    if (MODE == MODE_LOBE_ALBEDOS) {
        LobeAlbedos albedos = lobe_albedos(resolve(material), wo);
        results.at[i * RESULT_COUNT] = albedos.diffuse;
        results.at[i * RESULT_COUNT + 1u] = albedos.specular;
        return;
    }
    uint rng = seed_rng(uvec2(i, 0u), 0u, 11u);
    BrdfSample drawn = without_values(incoming.at[min(i, incoming.at.length() - 1u)], vec3(0.0), 0.0, false);
    if (MODE == MODE_DRAW) { drawn = sample_brdf(brdf, wo, rng); }
    float pdf = brdf_pdf(brdf, wo, drawn.wi);
    results.at[i * RESULT_COUNT] = drawn.wi;
    results.at[i * RESULT_COUNT + 1u] = MODE == MODE_DRAW ? drawn.weight : evaluate_diffuse_brdf(brdf, wo, drawn.wi);
    results.at[i * RESULT_COUNT + 2u] = vec3(pdf, drawn.pdf, brdf.specular_probability);
    results.at[i * RESULT_COUNT + 3u] = MODE == MODE_DRAW
        ? brdf_times_cosine(brdf, wo, drawn.wi)
        : evaluate_specular_brdf(brdf, wo, drawn.wi);
}
