// Draws light samples, and follows a ray to each: what is the density of the sample, and what at the hit?
#version 460
#include "common/random.glsl"
#include "scene/sampling.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 64) in;

struct Drawn {
    uint light_index;
    uint part;
    float probability;  // of light and part
    float sample_pdf;   // in solid angle at the receiver
    float hit_pdf;      // the same, where the ray hit the sample's triangle; -1 elsewhere
};

layout(set = 1, scalar) buffer DrawnBlock { Drawn at[]; } drawn;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= drawn.at.length()) { return; }
    uint rng = seed_rng(uvec2(i, 3u), 0u, 11u);
    vec3 receiver = vec3(0.0, -1.0, 0.0) - vec3(0.1, 2.0, 0.1) * rand_f(rng);
    LightSample light_sample = generate_random_light_sample(rng);
    ResolvedLightSample resolved = resolve_light_sample(light_sample);
    LightContribution light = calculate_resolved_light_contribution(resolved, receiver);
    float hit_pdf = -1.0;
    if (!is_at_infinity(resolved.kind) && light.solid_angle_pdf > 0.0) {
        Hit hit = trace_closest_hit(receiver, 0.0, light.wi, INFINITY, TRACE_BOTH_FACES);
        bool same = hit.instance != NO_INDEX && hit.triangle == light_sample.part
            && instances.at[hit.instance].light_index == light_sample.light_index;
        if (same) { hit_pdf = emissive_hit_pdf(resolve_surface_interaction(hit, light.wi, 0.0), light.wi, hit.t); }
    }
    drawn.at[i] = Drawn(
        light_sample.light_index, light_sample.part, light_sample_probability(light_sample), light.solid_angle_pdf,
        hit_pdf
    );
}
