// Tracing rays through the trees of scene/trees/ in the shader itself, for devices without ray queries, and for those
// on which this is faster. scene/trace.glsl includes it; the hits are those of ray queries.
#ifndef SCENE_TRACE_COMPUTE_GLSL
#define SCENE_TRACE_COMPUTE_GLSL

#include "scene/trees/edges.glsl"
#include "scene/trees/tree.glsl"

// VkGeometryInstanceFlagsKHR.
const uint FACING_CULL_DISABLE = 1u;
const uint FORCE_NO_OPAQUE = 8u;
// In the stack, below all, and between what is left of the tree over instances and of a mesh's. No leaf has them.
const uint RAY_ENDS = 0xFFFFFFFEu;
const uint MESH_ENDS = 0xFFFFFFFFu;
// A ray leaves at most one child of each node behind.
const uint STACK_SIZE = 2u * MAX_TREE_HEIGHT + 3u;
const float LEAST_DIRECTION = 1e-37;  // its inverse is finite

// A ray in world space, or in that of a mesh.
struct TreeRay {
    vec3 origin;
    vec3 inverse;  // of the direction
    vec3 shear;    // x and y over z of the direction in its own order of axes, and the inverse of z
    uint longest;  // axis of the direction, which is z in that order
    bool swaps;    // x and y change places, so that triangles keep their winding
};

TreeRay make_tree_ray(vec3 origin, vec3 direction) {
    TreeRay ray;
    ray.origin = origin;
    vec3 size = abs(direction);
    vec3 nonzero = mix(direction, vec3(LEAST_DIRECTION), lessThan(size, vec3(LEAST_DIRECTION)));
    ray.inverse = 1.0 / nonzero;
    ray.longest = size.x >= size.y ? (size.x >= size.z ? 0u : 2u) : (size.y >= size.z ? 1u : 2u);
    return ray;
}

// A vector in the order of axes that ends with the longest of the direction.
vec3 in_order(TreeRay ray, vec3 v) {
    vec3 ordered = ray.longest == 0u ? v.yzx : ray.longest == 1u ? v.zxy : v;
    return ray.swaps ? ordered.yxz : ordered;
}

void prepare_triangles(inout TreeRay ray, vec3 direction) {
    ray.swaps = direction[ray.longest] < 0.0;
    precise vec3 d = in_order(ray, direction);
    precise float z = 1.0 / d.z;
    ray.shear = vec3(d.xy * z, z);
}

// object_from_world: as trees have it, whose columns are the matrix's rows.
void ray_in_object_space(
    mat3x4 object_from_world, vec3 origin, vec3 direction, out precise vec3 from, out precise vec3 along
) {
    mat4x3 m = transpose(object_from_world);
    from = ((m[3] + origin.x * m[0]) + origin.y * m[1]) + origin.z * m[2];
    along = (direction.x * m[0] + direction.y * m[1]) + direction.z * m[2];
}

// Whether a ray meets a box within [t_min, t_max], and where. Rounds outwards: Ize, "Robust BVH Ray Traversal" (2013).
bool meets_box(TreeRay ray, vec3 low, vec3 high, float t_min, float t_max, out float near) {
    vec3 a = (low - ray.origin) * ray.inverse, b = (high - ray.origin) * ray.inverse;
    vec3 first = min(a, b), last = max(a, b);
    near = max(max(first.x, first.y), max(first.z, t_min));
    float far = min(min(last.x, last.y), last.z) * 1.0000008;
    return near <= min(far, t_max);
}

SeenTriangle see_triangle(TreeRay ray, TreeTriangle triangle) {
    precise vec3 a = in_order(ray, triangle.a - ray.origin);
    precise vec3 b = in_order(ray, triangle.b - ray.origin);
    precise vec3 c = in_order(ray, triangle.c - ray.origin);
    precise vec2 p = a.xy - ray.shear.xy * a.z, q = b.xy - ray.shear.xy * b.z, r = c.xy - ray.shear.xy * c.z;
    return SeenTriangle(p, q, r, vec3(a.z, b.z, c.z));
}

// Where a ray meets a triangle, as `meets_edges` has it.
bool resolve_hit(TreeRay ray, TreeTriangle triangle, out vec3 found, out bool front_face) {
    return meets_edges(see_triangle(ray, triangle), ray.shear.z, found, front_face);
}

// The same, after a test that most triangles don't pass: many cards compute doubles slowly.
bool meets_triangle(TreeRay ray, TreeTriangle triangle, out vec3 found, out bool front_face) {
    SeenTriangle seen = see_triangle(ray, triangle);
    vec2 p = seen.p, q = seen.q, r = seen.r;
    // They are missed by more than rounding: 2^-24 of each product and of their difference.
    vec3 gains = vec3(r.x * q.y, p.x * r.y, q.x * p.y), losses = vec3(r.y * q.x, p.y * r.x, q.y * p.x);
    vec3 edges = gains - losses, rounding = 4.0 * ROUNDING_UNIT * (abs(gains) + abs(losses));
    if (any(lessThan(edges, -rounding)) && any(greaterThan(edges, rounding))) { return false; }
    return meets_edges(seen, ray.shear.z, found, front_face);
}

// In loads of 16 bytes: of a structure drivers load number by number.
layout(buffer_reference, scalar, buffer_reference_align = 16) readonly buffer Quads { vec4 at[]; };

TreeNode load_node(uvec2 nodes, uint slot) {
    Quads quads = Quads(nodes);
    vec4 a = quads.at[4u * slot], b = quads.at[4u * slot + 1u];
    vec4 c = quads.at[4u * slot + 2u], d = quads.at[4u * slot + 3u];
    return TreeNode(
        a.xyz, floatBitsToUint(a.w), b.xyz, floatBitsToUint(b.w),
        c.xyz, floatBitsToUint(c.w), d.xyz, floatBitsToUint(d.w)
    );
}

TreeTriangle load_triangle(uvec2 triangles, uint place) {
    Quads quads = Quads(triangles);
    vec4 a = quads.at[3u * place], b = quads.at[3u * place + 1u], c = quads.at[3u * place + 2u];
    return TreeTriangle(a.xyz, floatBitsToUint(a.w), b.xyz, floatBitsToUint(b.w), c.xyz, floatBitsToUint(c.w));
}

// The stack: what a ray has still to look at, as the children of nodes have it.
uint waiting[STACK_SIZE];

// From a child of a node to the next leaf that the ray may hit, or to what waits below the tree's on the stack. Threads
// of a wave look at their leaves together: Aila and Laine.
uint next_leaf(TreeRay ray, uvec2 nodes, uint next, float t_min, float t_max, inout uint top) {
    while ((next & LEAF) == 0u) {
        TreeNode node = load_node(nodes, next);
        float first, second;
        bool meets_first = meets_box(ray, node.first_low, node.first_high, t_min, t_max, first);
        bool meets_second = meets_box(ray, node.second_low, node.second_high, t_min, t_max, second);
        if (meets_first && meets_second) {
            bool second_is_nearer = second < first;
            waiting[top++] = second_is_nearer ? node.first : node.second;
            next = second_is_nearer ? node.second : node.first;
        } else if (meets_first || meets_second) {
            next = meets_first ? node.first : node.second;
        } else {
            next = waiting[--top];
        }
    }
    return next;
}

// Which triangle of the flat tree a ray hits: where, the instance's slot or NO_INDEX, and the number in its mesh.
struct FlatHit {
    float t;
    uint slot;
    uint triangle;
};

// The closest hit in a flat tree, or the first that is found with TRACE_ANY_HIT.
FlatHit traverse_flat(
    uvec2 nodes, uvec2 slots, TreeRay ray, vec3 direction, float t_min, float t_max, uint mask, uint flags
) {
    FlatHit hit = FlatHit(t_max, NO_INDEX, 0u);
    TreeNode entrance = TreeNodes(nodes).at[0];
    uvec2 triangles = leaves_behind(nodes, entrance.slot_count);
    prepare_triangles(ray, direction);
    waiting[0] = RAY_ENDS;
    uint top = 1u;
    uint next = entrance.first == NO_ROOT ? RAY_ENDS : entrance.first;
    while (true) {
        next = next_leaf(ray, nodes, next, t_min, hit.t, top);
        if (next == RAY_ENDS) { return hit; }
        uint begin = next & LEAF_FIRST_MASK;
        uint end = begin + ((next & ~LEAF) >> LEAF_COUNT_SHIFT) + 1u;
        for (uint place = begin; place < end; place++) {
            TreeTriangle triangle = load_triangle(triangles, place);
            vec3 found;
            bool front_face;
            if (!meets_triangle(ray, triangle, found, front_face)) { continue; }
            if (!(found.x > t_min && found.x < hit.t)) { continue; }
            if ((TreeSlots(slots).at[triangle.slot].mask & mask) == 0u) { continue; }
            if (flags == TRACE_FRONT_FACES) {
                uint of_instance = TreeSlots(slots).at[triangle.slot].flags;
                bool is_front = front_face != ((of_instance & IS_MIRRORED) != 0u);
                if (!is_front && (of_instance & FACING_CULL_DISABLE) == 0u) { continue; }
            }
            hit = FlatHit(found.x, triangle.slot, triangle.number);
            if (flags == TRACE_ANY_HIT) { return hit; }
        }
        next = waiting[--top];
    }
}

// A hit in the flat tree as the tree of its mesh gives it, so that hits don't depend on which tree an instance is in:
// in world space, vertices and with them t are rounded otherwise.
Hit hit_in_object_space(FlatHit flat_hit, uvec2 slots, vec3 origin, vec3 direction) {
    uint row = TreeSlots(slots).at[flat_hit.slot].row;
    Mesh mesh = meshes.at[instances.at[row].ray_mesh];
    uvec3 vertices = mesh.triangles.at[flat_hit.triangle];
    TreeTriangle triangle;
    triangle.a = mesh.positions.at[vertices.x];
    triangle.b = mesh.positions.at[vertices.y];
    triangle.c = mesh.positions.at[vertices.z];
    vec3 from, along, found;
    ray_in_object_space(TreeSlots(slots).at[flat_hit.slot].object_from_world, origin, direction, from, along);
    TreeRay ray = make_tree_ray(from, along);
    prepare_triangles(ray, along);
    bool front_face;
    // What hits an edge in world space may miss it by rounding here; the weights are right up to that. Triangles that
    // are much finer than others of their mesh may be missed by more.
    resolve_hit(ray, triangle, found, front_face);
    float least = min(min(found.y, found.z), 1.0 - found.y - found.z);
    if (!(least > -0.01)) { found = vec3(flat_hit.t, vec2(1.0 / 3.0)); }
    return Hit(found.x, row, flat_hit.triangle, found.yz, front_face);
}

// The closest hit of a ray, or the first that is found with TRACE_ANY_HIT. is_shadow: `through` becomes what blended
// surfaces on the way let through, in place of deciding at random which of them the ray passes.
Hit traverse(
    uvec2 structure, vec3 origin, float t_min, vec3 direction, float t_max, uint mask, uint flags, uvec2 alpha_seed,
    const bool is_shadow, inout RayTransmittance through
) {
    Hit hit = NO_HIT;
    uint passed_edges = 0u;
    TreeRay ray = make_tree_ray(origin, direction);
    TreeNode entrance = TreeNodes(structure).at[0];
    uvec2 nodes = structure;
    uvec2 instances_behind = leaves_behind(structure, entrance.slot_count);
    uvec2 slots = slots_behind(instances_behind, entrance.slot_count);
    FlatHit flat_hit = FlatHit(t_max, NO_INDEX, 0u);
    if (flat_tree_of(entrance) != uvec2(0u)) {
        flat_hit = traverse_flat(flat_tree_of(entrance), slots, ray, direction, t_min, t_max, mask, flags);
        t_max = flat_hit.t;
    }
    bool ends = flags == TRACE_ANY_HIT && flat_hit.slot != NO_INDEX;
    waiting[0] = RAY_ENDS;
    uint top = 1u;
    TreeInstance instance;
    bool in_mesh = false;
    uint next = ends || entrance.first == NO_ROOT ? RAY_ENDS : entrance.first;
    while (true) {
        next = next_leaf(ray, nodes, next, t_min, t_max, top);
        if (next == RAY_ENDS) { break; }
        if (next == MESH_ENDS) {
            ray = make_tree_ray(origin, direction);
            nodes = structure;
            in_mesh = false;
        } else if (!in_mesh) {
            instance = TreeInstances(instances_behind).at[next & LEAF_FIRST_MASK];
            if ((instance.mask & mask) != 0u) {
                vec3 from, along;
                ray_in_object_space(instance.object_from_world, origin, direction, from, along);
                ray = make_tree_ray(from, along);
                prepare_triangles(ray, along);
                waiting[top++] = MESH_ENDS;
                nodes = instance.nodes;
                in_mesh = true;
                next = TreeNodes(nodes).at[0].first;
                continue;
            }
        } else {
            uint begin = next & LEAF_FIRST_MASK;
            uint end = begin + ((next & ~LEAF) >> LEAF_COUNT_SHIFT) + 1u;
            for (uint place = begin; place < end; place++) {
                TreeTriangle triangle = load_triangle(instance.triangles, place);
                vec3 found;
                bool front_face;
                if (!meets_triangle(ray, triangle, found, front_face)) { continue; }
                if (!(found.x > t_min && found.x < t_max)) { continue; }
                bool hides_back = (instance.flags & FACING_CULL_DISABLE) == 0u;
                if (flags == TRACE_FRONT_FACES && hides_back && !front_face) { continue; }
                if (SCENE_ALPHA && (instance.flags & FORCE_NO_OPAQUE) != 0u) {
                    vec4 filter_opacity = resolve_filter_opacity(
                        instance.row, triangle.number, found.yz, direction, flags == TRACE_FRONT_FACES
                    );
                    if (is_shadow) {
                        if (filter_opacity.w < 1.0) {
                            if (SCENE_BLEND) {
                                attenuate_by_surface(
                                    through, passed_edges, filter_opacity, instance.row, triangle.number, found.yz
                                );
                            }
                            continue;
                        }
                    } else if (!accepts_hit(filter_opacity.w, alpha_seed, instance.row, triangle.number, found.yz)) {
                        continue;
                    }
                }
                hit = Hit(found.x, instance.row, triangle.number, found.yz, front_face);
                if (flags == TRACE_ANY_HIT) { return hit; }
                flat_hit.slot = NO_INDEX;
                t_max = found.x;
            }
        }
        next = waiting[--top];
    }
    if (flat_hit.slot == NO_INDEX) { return hit; }
    return hit_in_object_space(flat_hit, slots, origin, direction);
}

Hit trace_closest_hit(vec3 origin, float t_min, vec3 direction, float t_max, uint flags, uvec2 alpha_seed) {
    RayTransmittance through = FULL_TRANSMITTANCE;
    return traverse(tlas, origin, t_min, direction, t_max, SCENE_MASK, flags, alpha_seed, false, through);
}

// Returns whether nothing opaque is hit. Both faces of every triangle cast shadows.
bool trace_transmittance_in(
    Structure structure, vec3 origin, float t_min, vec3 direction, float t_max, uint mask,
    out RayTransmittance through
) {
    through = FULL_TRANSMITTANCE;
    Hit hit = traverse(
        structure, origin, t_min, direction, t_max, mask, TRACE_ANY_HIT, uvec2(0u), true, through
    );
    return hit.instance == NO_INDEX;
}

#endif
