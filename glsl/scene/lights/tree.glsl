// How a surface chooses a light: first between lights at infinity and all others, by how much light each group may
// send to the surface; then by a walk down the group's tree, at each node by how much each child may send. A leaf is
// a light, or a few neighboring triangles of an emissive mesh. The triangle of a leaf is chosen by power. Conty
// Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (2018).
#ifndef SCENE_LIGHTS_TREE_GLSL
#define SCENE_LIGHTS_TREE_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
#include "scene/bindings.glsl"  // LightNode, LightLeaf, and SceneInfo: where the trees are in the tables
#include "scene/lights/choice.glsl"

// The point for which a light is sampled, with its geometric normal: LightSampleContext in pbrt.
struct Receiver {
    vec3 position;
    vec3 normal;
    bool transmits;               // light from below counts too
    bool takes_all;               // each leaf is sampled once, and none is chosen
    float infinity_probability;   // with which a light at infinity is chosen
};

// Without a receiver, leaves are chosen by power alone.
const Receiver NO_RECEIVER = Receiver(vec3(0.0), vec3(0.0), false, false, 0.0);

struct ChosenLeaf {
    uint leaf;  // into light_leaves
    float probability;
};

const float MIN_COSINE = 0.02;
const float MIN_SQUARED_RATIO = 0.002;  // of the smallest distance to the largest
const float MIN_IMPORTANCE = 1e-37;
// The share of choices that ignores how much light may arrive, since walls may stop the strongest light.
const float EQUAL_SHARE = 0.5;

// The greatest height of a box above the receiver's tangent plane; also below it if the surface transmits light.
float greatest_height(vec3 to_center, vec3 half_size, Receiver receiver) {
    float height = dot(to_center, receiver.normal);
    if ((SCENE_TRANSMISSION || SCENE_LAYERS) && receiver.transmits) { height = abs(height); }
    return height + dot(half_size, abs(receiver.normal));
}

// Whether the bounds of a node, and of its siblings, are of directions.
bool bounds_directions(uint node) { return node >= scene_info.infinity_root; }

// How much light a node may send to a receiver, up to a factor: its power times `inverse` times a cosine. `inverse`,
// one over the product of the smallest and the largest distance to the bounds, is near the mean of 1 / distance^2 over
// them. The cosine at the receiver is estimated as the greatest height of the bounds above its tangent plane, divided
// by the geometric mean of these distances. The bounds of a node at infinity hold directions, at distance 1. 0 only for
// nodes below the tangent plane, so that no light is lost: is_on_valid_side.
float importance(LightNode node, bool at_infinity, Receiver receiver) {
    vec3 to_center = node.center - (at_infinity ? vec3(0.0) : receiver.position);
    vec3 farthest = abs(to_center) + node.half_size, nearest = max(abs(to_center) - node.half_size, 0.0);
    float squared = max(dot(farthest, farthest), 1e-30);
    float nearest_squared = max(dot(nearest, nearest), MIN_SQUARED_RATIO * squared);
    float inverse = at_infinity ? 1.0 : inversesqrt(squared) * inversesqrt(nearest_squared);
    float height = greatest_height(to_center, node.half_size, receiver);
    float sent = node.power * inverse * clamp(height * sqrt(inverse), MIN_COSINE, 1.0);
    return height > 0.0 ? max(sent, MIN_IMPORTANCE) : 0.0;
}

// The probability of choosing a light at infinity: half by what all of them may send, and all others, half by how many
// lights there are.
float infinity_probability(float near, float far) {
    if (!(far > 0.0)) { return 0.0; }
    return near > 0.0 ? mix(far / (near + far), scene_info.infinity_share, EQUAL_SHARE) : 1.0;
}

// The same for a receiver that chooses by the trees.
float infinity_probability(Receiver receiver) {
    if (scene_info.infinity_root == NO_INDEX) { return 0.0; }
    if (scene_info.light_root == NO_INDEX) { return 1.0; }
    float near = importance(light_tree.at[scene_info.light_root], false, receiver);
    float far = importance(light_tree.at[scene_info.infinity_root], true, receiver);
    return infinity_probability(near, scene_info.infinity_power * far);
}

Receiver make_receiver(vec3 position, vec3 normal, bool transmits, bool takes_all) {
    Receiver receiver = Receiver(position, normal, transmits, takes_all, 0.0);
    if (SCENE_LIGHT_TREE && !takes_all) { receiver.infinity_probability = infinity_probability(receiver); }
    return receiver;
}

// Walks down from a root. Where all children lie below the tangent plane, the probability is 0.
ChosenLeaf descend_light_tree(uint root, Receiver receiver, inout uint rng) {
    LightNode node = light_tree.at[root];
    uint count = node.child_count, first = node.first;
    float probability = 1.0;
    while (count > 0u) {
        uint chosen = first;
        bool at_infinity = bounds_directions(first);
        float sum = 0.0, chosen_importance = 0.0;
        for (uint child = first; child < first + count; child++) {
            float child_importance = importance(light_tree.at[child], at_infinity, receiver);
            if (choose_weighted(sum, child_importance, rng)) {
                chosen = child;
                chosen_importance = child_importance;
            }
        }
        probability *= sum > 0.0 ? chosen_importance / sum : 0.0;
        count = light_tree.at[chosen].child_count;
        first = light_tree.at[chosen].first;
    }
    return ChosenLeaf(first, probability);
}

// The probability with which a receiver chooses the leaf of this node.
float node_probability(uint node, Receiver receiver) {
    float probability = 1.0;
    uint parent = light_tree.at[node].parent;
    while (node != parent) {
        uint first = light_tree.at[parent].first, count = light_tree.at[parent].child_count;
        bool at_infinity = bounds_directions(node);
        float sum = 0.0, own = 0.0;
        for (uint child = first; child < first + count; child++) {
            float child_importance = importance(light_tree.at[child], at_infinity, receiver);
            sum += child_importance;
            own = child == node ? child_importance : own;
        }
        probability *= sum > 0.0 ? own / sum : 0.0;
        node = parent;
        parent = light_tree.at[node].parent;
    }
    bool far = node == scene_info.infinity_root;
    return probability * (far ? receiver.infinity_probability : 1.0 - receiver.infinity_probability);
}

ChosenLeaf choose_leaf(Receiver receiver, inout uint rng) {
    bool only = !SCENE_LIGHT_TREE || scene_info.leaf_count == 1u;  // of a batch, other worlds may have more leaves
    if (only) { return ChosenLeaf(choose_leaf(rng), 1.0); }
    bool far = rand_f(rng) < receiver.infinity_probability;
    ChosenLeaf chosen = descend_light_tree(far ? scene_info.infinity_root : scene_info.light_root, receiver, rng);
    chosen.probability *= far ? receiver.infinity_probability : 1.0 - receiver.infinity_probability;
    return chosen;
}

// The probability with which a receiver chooses this leaf; 1 where all are taken.
float leaf_choice_probability(uint row, Receiver receiver) {
    if (receiver.normal == vec3(0.0)) { return light_leaves.at[row].by_power.probability; }
    return receiver.takes_all || !SCENE_LIGHT_TREE ? 1.0 : node_probability(light_leaves.at[row].node, receiver);
}

// The same over the probability by power, for a light that is a single leaf.
float choice_ratio(LightSource light, Receiver receiver) {
    float by_power = light_probability_by_power(light);
    return by_power > 0.0 ? leaf_choice_probability(light.first_leaf, receiver) / by_power : 1.0;
}

#endif
