// Chooses lights from the tree of lights for receivers, and computes the probability of every leaf at each receiver.
#version 460
#include "common/random.glsl"
#include "scene/lights/tree.glsl"

layout(local_size_x = 64) in;

struct RisLightSample {
    uint light;
    float probability;
};

layout(set = 1, scalar) readonly buffer ReceiversBlock { Receiver at[]; } receivers;
// The same number of draws for each receiver, receiver by receiver.
layout(set = 1, scalar) writeonly buffer DrawnBlock { RisLightSample at[]; } drawn;
// Of each leaf, receiver by receiver.
layout(set = 1, scalar) writeonly buffer ProbabilitiesBlock { float at[]; } probabilities;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i < drawn.at.length()) {
        uint rng = seed_rng(uvec2(i, 5u), 0u, 17u);
        ChosenLeaf chosen = choose_leaf(receivers.at[i / (drawn.at.length() / receivers.at.length())], rng);
        drawn.at[i] = RisLightSample(chosen.leaf, chosen.probability);
    }
    if (i < probabilities.at.length()) {
        uint leaf_count = scene_info.leaf_count;
        probabilities.at[i] = leaf_choice_probability(i % leaf_count, receivers.at[i / leaf_count]);
    }
}
