// Draws light samples, the first half by power, the others by the tree of lights, and follows a ray to each: what is
// the density of the sample, and what at the hit?
#version 460
#include "common/random.glsl"
#include "scene/walk.glsl"

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
    vec3 position = vec3(0.0, -1.0, 0.0) - vec3(0.1, 2.0, 0.1) * rand_f(rng);
    bool by_power = i < drawn.at.length() / 2;
    Receiver receiver = by_power ? NO_RECEIVER : Receiver(position, vec3(0.0, 1.0, 0.0));
    LightSample light_sample;
    ResolvedLightSample resolved;
    if (by_power) {
        light_sample = generate_random_light_sample(rng);
        resolved = resolve_light_sample(light_sample);
    } else {
        ChosenLeaf chosen = choose_leaf(receiver, rng);
        light_sample = sample_leaf(chosen.leaf, rng);
        resolved = resolve_light_sample(light_sample, chosen.probability);
    }
    LightContribution light = calculate_resolved_light_contribution(resolved, position);
    float hit_pdf = -1.0;
    if (!is_at_infinity(resolved.kind) && light.solid_angle_pdf > 0.0) {
        Hit hit = trace_closest_hit(position, 0.0, light.wi, INFINITY, TRACE_BOTH_FACES);
        bool same = hit.instance != NO_INDEX && hit.triangle == light_sample.part
            && instances.at[hit.instance].light_index == light_sample.light_index;
        if (same) { hit_pdf = hit_light_pdf(receiver, hit, resolve_surface_interaction(hit, light.wi, 0.0), light.wi); }
    }
    drawn.at[i] = Drawn(
        light_sample.light_index, light_sample.part, light_sample_probability(light_sample), light.solid_angle_pdf,
        hit_pdf
    );
}
