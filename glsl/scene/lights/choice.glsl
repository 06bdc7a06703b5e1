// Which light, and which of its triangles or texels (parts), a light sample takes: by power, from two levels of alias
// tables. Walker, "An Efficient Method for Generating Discrete Random Variables with General Distributions" (1977).
// Differs from Solari, which takes all lights, and all triangles of a light, with equal probability.
#ifndef SCENE_LIGHTS_CHOICE_GLSL
#define SCENE_LIGHTS_CHOICE_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"

uint choose(uint row, AliasTableRow drawn, inout uint rng) {
    return rand_u(rng) < drawn.threshold ? row : drawn.alias;
}

uint choose_light(inout uint rng) {
    uint row = rand_range_u(scene_info.light_count, rng);
    return choose(row, light_sources.at[row].by_power, rng);
}

bool has_equal_parts(LightSource light) { return uvec2(light.parts) == uvec2(0u); }

uint choose_part(LightSource light, inout uint rng) {
    uint row = rand_range_u(light.part_count, rng);
    return has_equal_parts(light) ? row : choose(row, light.parts.at[row], rng);
}

// The probability of a part once its light is chosen; 0 only where nothing is emitted.
float part_probability(LightSource light, uint part) {
    return has_equal_parts(light) ? 1.0 / float(light.part_count) : light.parts.at[part].probability;
}

// The probability that a light sample takes this part of this light, where lights are chosen by power; 0 only where
// nothing is emitted.
float choice_probability_by_power(LightSource light, uint part) {
    return light.by_power.probability * part_probability(light, part);
}

#endif
