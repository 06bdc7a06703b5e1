// How a surface chooses a light: by a walk down the tree of lights, at each node by how much light each child may send
// to the surface. Lights at infinity are chosen by power. Conty Estevez and Kulla, "Importance Sampling of Many Lights
// with Adaptive Tree Splitting" (2018).
#ifndef SCENE_LIGHTS_TREE_GLSL
#define SCENE_LIGHTS_TREE_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/choice.glsl"

// What receives light: a point, and the normal of its shading.
struct Receiver {
    vec3 position;
    vec3 normal;
};

struct ChosenLight {
    uint index;
    float probability;
};

const float MIN_IMPORTANCE_COSINE = 0.02;
const float MIN_DISTANCE_SQUARED = 0.02;

// How much light a node may send to a receiver, up to a factor: its power over the product of the smallest and the
// largest distance, which is near the mean of 1 / distance^2 over the bounds, with a cosine at the receiver.
float importance(LightNode node, Receiver receiver) {
    vec3 to_center = node.center - receiver.position;
    vec3 nearest = max(abs(to_center) - node.half_size, 0.0), farthest = abs(to_center) + node.half_size;
    float squared = dot(farthest, farthest);
    float inverse = inversesqrt(max(max(dot(nearest, nearest), MIN_DISTANCE_SQUARED * squared) * squared, 1e-30));
    float height = dot(to_center, receiver.normal) + dot(node.half_size, abs(receiver.normal));
    return node.power * clamp(height * sqrt(inverse), MIN_IMPORTANCE_COSINE, 1.0) * inverse;
}

// The probability of the first child of a node, whose index is even.
float first_child_probability(uint first, Receiver receiver) {
    float a = importance(light_tree.at[first], receiver), b = importance(light_tree.at[first + 1u], receiver);
    return a + b > 0.0 ? a / (a + b) : 0.5;
}

ChosenLight descend_light_tree(Receiver receiver, inout uint rng) {
    float probability = 1.0;
    uint first = light_tree.at[0].first;
    while ((first & LIGHT_LEAF) == 0u) {
        float of_first = first_child_probability(first, receiver);
        bool second = !(rand_f(rng) < of_first);
        probability *= second ? 1.0 - of_first : of_first;
        first = light_tree.at[first + uint(second)].first;
    }
    return ChosenLight(first & ~LIGHT_LEAF, probability);
}

// The probability with which descend_light_tree ends in this leaf.
float leaf_probability(uint node, Receiver receiver) {
    float probability = 1.0;
    while (node != 0u) {
        float of_first = first_child_probability(node & ~1u, receiver);
        probability *= (node & 1u) != 0u ? 1.0 - of_first : of_first;
        node = light_tree.at[node].parent;
    }
    return probability;
}

ChosenLight choose_light(Receiver receiver, inout uint rng) {
    uint row = choose_light(rng);
    LightSource light = light_sources.at[row];
    if (light.node == NO_INDEX) { return ChosenLight(row, light.choice.probability); }
    ChosenLight chosen = descend_light_tree(receiver, rng);
    chosen.probability *= scene_info.finite_probability;
    return chosen;
}

// The probability with which a receiver chooses this light.
float light_choice_probability(uint row, Receiver receiver) {
    LightSource light = light_sources.at[row];
    if (light.node == NO_INDEX) { return light.choice.probability; }
    return scene_info.finite_probability * leaf_probability(light.node, receiver);
}

#endif
