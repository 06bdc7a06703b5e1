// Sorts the triangles of a mesh whose tree is built anew because they have moved, along a curve that fills space: by
// Morton codes of 30 bits (Lauterbach et al., "Fast BVH Construction on GPUs", 2009), and a radix sort (Satish, Harris
// and Garland, "Designing Efficient Sorting Algorithms for Manycore GPUs", 2009). build.comp includes this behind what
// it declares.
#ifndef SCENE_TREES_SORT_GLSL
#define SCENE_TREES_SORT_GLSL

const uint DIGIT_BITS = 3u;
const uint DIGITS = 1u << DIGIT_BITS;
// Each of ten rounds sorts by one digit, in three steps: chunks count digits, one workgroup adds these up, and chunks
// move keys.
const uint STEPS = 30u;

// A Morton code and a triangle.
layout(buffer_reference, scalar, buffer_reference_align = 8) coherent buffer Keys { uvec2 at[]; };

// For each digit how many keys of the chunk each thread has, then how many are in front of these.
shared uint digit_places[DIGITS * THREADS];
shared uint digit_moves[DIGITS];  // from the places in the chunk to those among all

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

// The scratch of clusters, which nobody needs yet: two lists of keys, and for each digit the numbers of all chunks.
Keys all_keys() { return Keys(uvec2(build.clusters)); }
List all_digits() { return List(uvec2(build.clusters)); }
uint digits_at(uint digit, uint chunk) { return 4u * build.count + (digit << build.halvings) + chunk; }

void write_codes() {
    TreeNode entrance = TreeNodes(build.nodes).at[0];  // of the tree so far, which was refitted
    for (uint number = chunk_begin + thread; number < chunk_end; number += THREADS) {
        all_keys().at[number] = uvec2(morton_code(number, entrance.first_low, entrance.first_high), number);
    }
    wait_for_all();
}

void place_digits(uint begin, uint end, uint from, uint shift) {
    for (uint digit = 0u; digit < DIGITS; digit++) { digit_places[digit * THREADS + thread] = 0u; }
    for (uint place = begin; place < end; place++) {
        digit_places[digit_of(all_keys().at[from + place], shift) * THREADS + thread]++;
    }
    wait_for_all();
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

void add_chunks() {
    uint begin, end, own = 0u, total;
    own_part(DIGITS << build.halvings, begin, end);
    for (uint i = begin; i < end; i++) { own += all_digits().at[digits_at(0u, i)]; }
    uint before = sum_before(own, total);
    for (uint i = begin; i < end; i++) {
        uint count = all_digits().at[digits_at(0u, i)];
        all_digits().at[digits_at(0u, i)] = before;
        before += count;
    }
}

void move_keys(uint begin, uint end, uint from, uint shift, uint chunk) {
    if (thread < DIGITS) {
        digit_moves[thread] = all_digits().at[digits_at(thread, chunk)] - digit_places[thread * THREADS];
    }
    wait_for_all();
    for (uint place = begin; place < end; place++) {
        uvec2 key = all_keys().at[from + place];
        uint digit = digit_of(key, shift);
        uint target = digit_moves[digit] + digit_places[digit * THREADS + thread]++;
        all_keys().at[build.count - from + target] = key;
        build.lists.at[3u * build.count + target] = key.y;  // the last round leaves the order there
    }
}

void sort_step(uint step, uint chunk) {
    uint begin, end;
    own_part(chunk_end - chunk_begin, begin, end);
    begin += chunk_begin;
    end += chunk_begin;
    uint shift = step / 3u * DIGIT_BITS, from = (step / 3u & 1u) * build.count;
    if (step % 3u == 1u) {
        add_chunks();
        return;
    }
    if (step == 0u) { write_codes(); }
    place_digits(begin, end, from, shift);
    if (step % 3u == 2u) {
        move_keys(begin, end, from, shift, chunk);
    } else if (thread < DIGITS) {
        uint next = thread + 1u < DIGITS ? digit_places[(thread + 1u) * THREADS] : chunk_end - chunk_begin;
        all_digits().at[digits_at(thread, chunk)] = next - digit_places[thread * THREADS];
    }
}

// Leaves the triangles in the fourth list. Step STEPS stands for all, of a tree of one chunk.
void sort_triangles(uint step, uint chunk) {
    find_chunk(build.halvings, chunk, chunk_begin, chunk_end);
    uint last = step;
    if (step == STEPS) {
        step = 0u;
        last = STEPS - 1u;
    }
    for (; step <= last; step++) {
        sort_step(step, chunk);
        wait_for_all();
    }
}

#endif
