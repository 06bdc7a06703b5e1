// The surface model for tests: samples, values at given directions, or the albedo by quadrature, as MODE says.
#version 460
#include "generated/conformance/brdf_runs.glsl"
#include "scene/brdf.glsl"

layout(local_size_x = 64) in;

layout(constant_id = 60) const uint MODE = MODE_DRAW;

struct TestMaterial {
    vec3 base_color;
    vec3 reflectance;
    float metallic;
    float perceptual_roughness;
};

layout(set = 1, binding = 20, scalar) readonly buffer TestMaterialsBlock { TestMaterial at[]; } test_materials;
// One direction for each row, or one for all.
layout(set = 1, binding = 21, scalar) readonly buffer OutgoingBlock { vec3 at[]; } outgoing;
layout(set = 1, binding = 22, scalar) readonly buffer IncomingBlock { vec3 at[]; } incoming;
layout(set = 1, binding = 23, scalar) buffer ResultsBlock { vec3 at[]; } results;  // rows of RESULT_COUNT

ResolvedMaterial resolve(TestMaterial m) {
    return ResolvedMaterial(
        m.base_color, vec3(0.0), m.reflectance, m.perceptual_roughness, square(m.perceptual_roughness), m.metallic
    );
}

// Integrates each lobe over the points that its sampling maps to, where the integrand is smooth.
vec3 integrate_albedo(Brdf brdf, vec3 wo) {
    const uint point_count = 4096u;
    vec3 sum = vec3(0.0);
    for (uint i = 0u; i < point_count; i++) {
        vec2 u = vec2(fract(float(i) * 0.618033988749895), (float(i) + 0.5) / float(point_count));
        vec3 wi = sample_cosine_hemisphere(u.yx);
        sum += evaluate_diffuse_brdf(brdf, wo, wi) * PI / wi.z;
        if (brdf.mirror || brdf_lambert) { continue; }
        float from_end = 1.0 - u.y;
        wi = sample_ggx_vndf(wo, brdf.roughness, vec2(u.x, 1.0 - from_end * from_end));
        if (wi.z > 0.0) {
            float pdf = brdf.pdf_per_d * D_GGX(brdf.roughness, normalize(wo + wi));
            sum += 2.0 * from_end * evaluate_specular_brdf(brdf, wo, wi) / pdf;
        }
    }
    return sum / float(point_count) + (brdf.mirror && !brdf_lambert ? specular_fresnel(brdf, wo.z) : vec3(0.0));
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= results.at.length() / RESULT_COUNT) { return; }
    TestMaterial material = test_materials.at[min(i, test_materials.at.length() - 1u)];
    vec3 wo = outgoing.at[min(i, outgoing.at.length() - 1u)];
    Brdf brdf = prepare_brdf(resolve(material), wo);
    if (MODE == MODE_ALBEDO) {
        results.at[i * RESULT_COUNT] = integrate_albedo(brdf, wo);
        return;
    }
    uint rng = seed_rng(uvec2(i, 0u), 0u, 11u);
    BrdfSample drawn = BrdfSample(incoming.at[min(i, incoming.at.length() - 1u)], vec3(0.0), 0.0, false);
    if (MODE == MODE_DRAW) { drawn = sample_brdf(brdf, wo, rng); }
    float pdf = brdf_pdf(brdf, wo, drawn.wi);
    results.at[i * RESULT_COUNT] = drawn.wi;
    results.at[i * RESULT_COUNT + 1u] = MODE == MODE_DRAW ? drawn.weight : evaluate_diffuse_brdf(brdf, wo, drawn.wi);
    results.at[i * RESULT_COUNT + 2u] = vec3(pdf, drawn.pdf, brdf.specular_probability);
    results.at[i * RESULT_COUNT + 3u] = MODE == MODE_DRAW
        ? evaluate_brdf(brdf, wo, drawn.wi)
        : evaluate_specular_brdf(brdf, wo, drawn.wi);
}
