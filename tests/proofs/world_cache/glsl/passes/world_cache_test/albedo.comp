// The albedo that the world cache uses for a surface, and the sum of its BRDF over directions.
#version 460
#include "passes/world_cache/query.glsl"

struct Case {
    vec3 base_color;
    float reflectance;
    float perceptual_roughness;
    float metallic;
    float cosine;
};
layout(set = 1, scalar) readonly buffer CasesBlock { Case at[]; } cases;
layout(set = 1, scalar) buffer AlbedosBlock { vec3 at[]; } albedos;  // ours, then summed

layout(local_size_x = 8) in;

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index >= cases.at.length()) { return; }
    Case c = cases.at[index];
    BaseMaterial base = make_base(c.base_color, vec3(c.reflectance), c.perceptual_roughness, c.metallic);
    ResolvedMaterial material = without_lobes(base, vec3(0.0));
    vec3 wo = vec3(sqrt(1.0 - square(c.cosine)), 0.0, c.cosine);
    Brdf brdf = prepare_brdf(material, wo);
    const uint COUNT = 256u;
    vec3 sum = vec3(0.0);
    uint rng = 1u;
    for (uint i = 0u; i < COUNT * COUNT; i++) {
        BrdfSample next = sample_brdf(brdf, wo, rng);
        sum += next.weight;
    }
    albedos.at[2u * index] = surface_albedo(material, wo);
    albedos.at[2u * index + 1u] = sum / float(COUNT * COUNT);
}
