// Chooses a leaf of the light tree (a light, or a cluster of triangles of an emissive mesh), and a part of it (a
// triangle or a texel), by power, from two levels of alias tables. Walker, "An Efficient Method for Generating Discrete
// Random Variables with General Distributions" (1977). Differs from Solari, which takes all lights, and all triangles
// of a light, with equal probability.
#ifndef SCENE_LIGHTS_CHOICE_GLSL
#define SCENE_LIGHTS_CHOICE_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"  // LightSource and its parts, LightLeaf, AliasTableRow

// The second step of the alias method, for a row that was drawn uniformly.
uint choose(uint row, AliasTableRow drawn, inout uint rng) {
    return rand_u(rng) < drawn.threshold ? row : drawn.alias;
}

uint choose_leaf(inout uint rng) {
    uint row = scene_info.first_leaf + rand_range_u(scene_info.leaf_count, rng);
    return choose(row, light_leaves.at[row].by_power, rng);
}

// Whether the parts of each of the light's leaves are equally likely.
bool has_equal_parts(LightSource light) { return uvec2(light.parts) == uvec2(0u); }

uint choose_part(LightLeaf leaf, inout uint rng) {
    LightSource light = light_sources.at[leaf.light];
    uint row = leaf.first_part + rand_range_u(leaf.part_count, rng);
    return has_equal_parts(light) ? row : choose(row, light.parts.at[row], rng);
}

struct PartOfLeaf {
    uint leaf;         // into light_leaves
    float probability; // of the part, given the leaf; 0 only where nothing is emitted
};

// Finds the leaf of a part. Leaves are made by halving the list of parts LightSource.halvings times (NO_INDEX: until
// each part is a leaf), with the larger half first, as in solari_vk/bound/spatial_order.py.
PartOfLeaf part_of_leaf(LightSource light, uint part) {
    if (light.halvings == NO_INDEX) { return PartOfLeaf(light.first_leaf + part, 1.0); }
    uint leaf = 0u, first = 0u, count = light.part_count;
    for (uint i = 0u; i < light.halvings; i++) {
        uint lower = count - count / 2u;
        bool above = part >= first + lower;
        leaf = 2u * leaf + uint(above);
        first += above ? lower : 0u;
        count = above ? count - lower : lower;
    }
    float probability = has_equal_parts(light) ? 1.0 / float(count) : light.parts.at[part].probability;
    return PartOfLeaf(light.first_leaf + leaf, probability);
}

// The probability that a light sample takes this part of this light, where leaves are chosen by power; 0 only where
// nothing is emitted.
float choice_probability_by_power(LightSource light, uint part) {
    PartOfLeaf found = part_of_leaf(light, part);
    return light_leaves.at[found.leaf].by_power.probability * found.probability;
}

// For a light that is a single leaf: the probability that a light sample takes it, where leaves are chosen by power.
float light_probability_by_power(LightSource light) {
    return light_leaves.at[light.first_leaf].by_power.probability;
}

#endif
