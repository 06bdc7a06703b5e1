// Sorts the triangles of a mesh whose tree is built anew because they have moved, along a curve that fills space: by
// Morton codes of 30 bits (Lauterbach et al., "Fast BVH Construction on GPUs", 2009), and a radix sort by one
// workgroup, which is enough for what is seldom done. build.comp includes this behind what it declares.
#ifndef SCENE_TREES_SORT_GLSL
#define SCENE_TREES_SORT_GLSL

const uint CODE_BITS = 30u;
const uint DIGIT_BITS = 3u;  // each round sorts by one digit; an even number of rounds
const uint DIGITS = 1u << DIGIT_BITS;

// A Morton code and a triangle.
layout(buffer_reference, scalar, buffer_reference_align = 8) coherent buffer Keys { uvec2 at[]; };

// For each digit how many keys each thread has, then where it puts the first of them.
shared uint digit_places[DIGITS * THREADS];

// Puts two bits of 0 behind each of 10 bits.
uint spread_bits(uint bits) {
    bits = (bits | bits << 16u) & 0x030000FFu;
    bits = (bits | bits << 8u) & 0x0300F00Fu;
    bits = (bits | bits << 4u) & 0x030C30C3u;
    return (bits | bits << 2u) & 0x09249249u;
}

uint morton_code(uint triangle, vec3 low, vec3 high) {
    vec3 a, b;
    triangle_box(triangle, a, b);
    uvec3 cell = min(uvec3(1024.0 * clamp((0.5 * a + 0.5 * b - low) / (high - low), 0.0, 1.0)), uvec3(1023u));
    return spread_bits(cell.x) << 2u | spread_bits(cell.y) << 1u | spread_bits(cell.z);
}

uint digit_of(uvec2 key, uint shift) { return key.x >> shift & (DIGITS - 1u); }

// The exclusive sums of `digit_places`.
void sum_digits() {
    uint own = 0u, total;
    for (uint i = 0u; i < DIGITS; i++) { own += digit_places[DIGITS * thread + i]; }
    uint before = sum_before(own, total);
    for (uint i = 0u; i < DIGITS; i++) {
        uint count = digit_places[DIGITS * thread + i];
        digit_places[DIGITS * thread + i] = before;
        before += count;
    }
    wait_for_all();
}

// Leaves the triangles in the third list.
void sort_triangles() {
    Keys keys = Keys(uvec2(build.clusters));  // which nobody needs yet, and which have room for two lists of keys
    TreeNode entrance = TreeNodes(build.nodes).at[0];  // of the tree so far, which was refitted
    for (uint number = thread; number < build.count; number += THREADS) {
        keys.at[number] = uvec2(morton_code(number, entrance.first_low, entrance.first_high), number);
    }
    wait_for_all();
    uint begin, end, from = 0u;
    own_part(build.count, begin, end);
    for (uint shift = 0u; shift < CODE_BITS; shift += DIGIT_BITS) {
        for (uint digit = 0u; digit < DIGITS; digit++) { digit_places[digit * THREADS + thread] = 0u; }
        for (uint place = begin; place < end; place++) {
            digit_places[digit_of(keys.at[from + place], shift) * THREADS + thread]++;
        }
        wait_for_all();
        sum_digits();
        for (uint place = begin; place < end; place++) {
            uvec2 key = keys.at[from + place];
            keys.at[build.count - from + digit_places[digit_of(key, shift) * THREADS + thread]++] = key;
        }
        from = build.count - from;
        wait_for_all();
    }
    for (uint place = thread; place < build.count; place += THREADS) {
        build.lists.at[2u * build.count + place] = keys.at[place].y;
    }
}

#endif
