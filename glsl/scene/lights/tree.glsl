// How a surface chooses a light: by a walk down the tree of lights, at each node by how much light each child may send
// to the surface. A leaf is a light, or a few neighboring triangles of an emissive mesh. The triangle of a leaf, and
// lights at infinity, are chosen by power. Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive
// Tree Splitting" (2018).
#ifndef SCENE_LIGHTS_TREE_GLSL
#define SCENE_LIGHTS_TREE_GLSL

#include "common/math.glsl"
#include "common/random.glsl"
#include "scene/bindings.glsl"  // LightNode, LightLeaf, and SceneInfo: where the tree is in the tables
#include "scene/lights/choice.glsl"
#include "scene/lights/portal_sampling.glsl"  // has_portals

// The point for which a light is sampled, with its shading normal: LightSampleContext in pbrt.
struct Receiver {
    vec3 position;
    vec3 normal;
};

// Without a receiver, leaves are chosen by power alone.
const Receiver NO_RECEIVER = Receiver(vec3(0.0), vec3(0.0));

struct ChosenLeaf {
    uint leaf;  // into light_leaves
    float probability;
};

const float MIN_COSINE = 0.02;
const float MIN_SQUARED_RATIO = 0.002;  // of the smallest distance to the largest
const float MIN_IMPORTANCE = 1e-37;

// How much light a node may send to a receiver, up to a factor: its power times `inverse` times a cosine. `inverse`,
// one over the product of the smallest and the largest distance to the bounds, is near the mean of 1 / distance^2 over
// them. The cosine at the receiver is estimated as the greatest height of the bounds above its tangent plane, divided
// by the geometric mean of these distances. Never 0, so that no light is lost.
float importance(LightNode node, Receiver receiver) {
    vec3 to_center = node.center - receiver.position;
    vec3 farthest = abs(to_center) + node.half_size, nearest = max(abs(to_center) - node.half_size, 0.0);
    float squared = max(dot(farthest, farthest), 1e-30);
    float nearest_squared = max(dot(nearest, nearest), MIN_SQUARED_RATIO * squared);
    float inverse = inversesqrt(squared) * inversesqrt(nearest_squared);
    float height = dot(to_center, receiver.normal) + dot(node.half_size, abs(receiver.normal));
    return max(node.power * inverse * clamp(height * sqrt(inverse), MIN_COSINE, 1.0), MIN_IMPORTANCE);
}

// ---- strata -----------------------------------------------------------------------------------------

// A shader that takes a sample of each stratum of the lights, and traces one of them (sample_light in scene/walk.glsl),
// defines LIGHT_STRATA as SCENE_LIGHT_STRATA, which is whether a scene has several: each leaf where they are few, else
// the tree and the lights at infinity. Others choose among all lights.
#ifndef LIGHT_STRATA
#define LIGHT_STRATA false
#endif

// Portals aren't among few lights: samples of the environment that miss them would be taken for the strongest.
bool has_few_leaves() {
    return scene_info.leaf_count > 1u && scene_info.leaf_count <= FEW_LEAVES && !has_portals();
}

uint stratum_count() {
    if (has_few_leaves()) { return scene_info.leaf_count; }
    float of_tree = scene_info.tree_probability;
    return of_tree > 0.0 && of_tree < 1.0 ? 2u : 1u;
}

bool is_at_infinity(LightLeaf leaf) { return leaf.light >= scene_info.first_light_at_infinity; }

// One of the lights at infinity, by power. There are few of them.
ChosenLeaf choose_leaf_at_infinity(inout uint rng) {
    ChosenLeaf chosen = ChosenLeaf(scene_info.first_leaf, 0.0);
    uint end = scene_info.first_leaf + scene_info.leaf_count;
    float sum = 0.0;
    for (uint i = light_sources.at[scene_info.first_light_at_infinity].first_leaf; i < end; i++) {
        float probability = light_leaves.at[i].by_power.probability;
        if (choose_weighted(sum, probability, rng)) { chosen = ChosenLeaf(i, probability); }
    }
    chosen.probability /= max(sum, 1e-30);
    return chosen;
}

// ---- choices ----------------------------------------------------------------------------------------

ChosenLeaf descend_light_tree(Receiver receiver, inout uint rng) {
    LightNode root = light_tree.at[scene_info.light_root];
    uint count = root.child_count, first = root.first;
    float probability = 1.0;
    while (count > 0u) {
        uint chosen = first;
        float sum = 0.0, chosen_importance = 0.0;
        for (uint child = first; child < first + count; child++) {
            float child_importance = importance(light_tree.at[child], receiver);
            if (choose_weighted(sum, child_importance, rng)) {
                chosen = child;
                chosen_importance = child_importance;
            }
        }
        probability *= chosen_importance / sum;
        count = light_tree.at[chosen].child_count;
        first = light_tree.at[chosen].first;
    }
    return ChosenLeaf(first, probability);
}

// The probability with which descend_light_tree ends in this node.
float node_probability(uint node, Receiver receiver) {
    float probability = 1.0;
    uint root = scene_info.light_root;
    while (node != root) {
        uint parent = light_tree.at[node].parent;
        uint first = light_tree.at[parent].first, count = light_tree.at[parent].child_count;
        float sum = 0.0, own = 0.0;
        for (uint child = first; child < first + count; child++) {
            float child_importance = importance(light_tree.at[child], receiver);
            sum += child_importance;
            own = child == node ? child_importance : own;
        }
        probability *= own / sum;
        node = parent;
    }
    return probability;
}

bool in_tree(LightLeaf leaf) { return SCENE_LIGHT_TREE && leaf.node != NO_INDEX; }

// Chooses by power among all leaves: a leaf that isn't in the tree is taken; else the tree chooses.
ChosenLeaf choose_leaf(Receiver receiver, inout uint rng) {
    if (!SCENE_LIGHT_TREE || scene_info.tree_probability < 1.0) {
        uint row = choose_leaf(rng);
        LightLeaf leaf = light_leaves.at[row];
        if (!in_tree(leaf)) { return ChosenLeaf(row, leaf.by_power.probability); }
    }
    ChosenLeaf chosen = descend_light_tree(receiver, rng);
    chosen.probability *= scene_info.tree_probability;
    return chosen;
}

// Chooses in one of the strata.
ChosenLeaf choose_leaf_of(uint stratum, Receiver receiver, inout uint rng) {
    if (has_few_leaves()) { return ChosenLeaf(scene_info.first_leaf + stratum, 1.0); }
    if (stratum == 1u) { return choose_leaf_at_infinity(rng); }
    if (scene_info.tree_probability > 0.0) { return descend_light_tree(receiver, rng); }
    uint row = choose_leaf(rng);
    return ChosenLeaf(row, light_leaves.at[row].by_power.probability);
}

// The probability with which a receiver chooses this leaf, of its stratum if there are strata.
float leaf_choice_probability(uint row, Receiver receiver) {
    LightLeaf leaf = light_leaves.at[row];
    if (LIGHT_STRATA && has_few_leaves()) { return 1.0; }
    bool of_several = LIGHT_STRATA && stratum_count() > 1u;
    if (!in_tree(leaf) || receiver.normal == vec3(0.0)) {
        return leaf.by_power.probability / (of_several ? 1.0 - scene_info.tree_probability : 1.0);
    }
    return node_probability(leaf.node, receiver) * (of_several ? 1.0 : scene_info.tree_probability);
}

#endif
