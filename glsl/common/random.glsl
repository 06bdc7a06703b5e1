// Random numbers and distributions.
#ifndef COMMON_RANDOM_GLSL
#define COMMON_RANDOM_GLSL

#include "common/hash.glsl"
#include "common/math.glsl"
#ifdef LOW_DISCREPANCY
#include "common/sobol.glsl"
#endif

// A generator's state is a number. By default each state gives one number. With LOW_DISCREPANCY each state gives a
// sequence that covers [0, 1) evenly, of which `sequence_index` takes one, so that a sample index that counts up makes
// the mean of samples less noisy than independent numbers do: "padded" sequences of one and two dimensions.
#ifdef LOW_DISCREPANCY
uint sequence_index;
#endif

void advance_rng(inout uint rng) { rng = rng * 747796405u + 2891336453u; }

uint rand_u(inout uint rng) {
#ifdef LOW_DISCREPANCY
    uint number = van_der_corput(sequence_index, rng);
#else
    uint number = pcg(rng);
#endif
    advance_rng(rng);
    return number;
}

float rand_f(inout uint rng) { return unit_float(rand_u(rng)); }

vec2 rand_vec2f(inout uint rng) {
#ifdef LOW_DISCREPANCY
    vec2 point = sobol_point(sequence_index, rng);
    advance_rng(rng);
    return point;
#else
    float x = rand_f(rng);
    return vec2(x, rand_f(rng));
#endif
}

// The state of a new generator, which later gives the same numbers again.
uint split_rng(inout uint rng) {
    uint state = pcg(rng);
    advance_rng(rng);
    return state;
}

// Uniform in [0, n); 0 for n = 0. The relative error of probabilities is at most n / 2^32.
uint rand_range_u(uint n, inout uint rng) {
    uint high, low;
    umulExtended(rand_u(rng), n, high, low);
    return high;
}

// Adds a sample to a stream by weighted reservoir sampling: updates the sum of weights, and returns whether this sample
// replaces the one chosen before. Each sample is the last one chosen with a probability in proportion to its weight.
bool choose_weighted(inout float weight_sum, float weight, inout uint rng) {
    weight_sum += weight;
    return rand_f(rng) * weight_sum < weight;
}

// ---- distributions ----------------------------------------------------------------------------------

vec2 sample_disk(vec2 u) {
    float angle = 2.0 * PI * u.y;
    return sqrt(u.x) * vec2(cos(angle), sin(angle));
}

// In the frame whose z axis is the normal; pdf = z / pi, and z is never 0.
vec3 sample_cosine_hemisphere(vec2 u) {
    return vec3(sample_disk(u), sqrt(1.0 - u.x));
}

// In the frame whose z axis is the normal; pdf = 1 / (2 pi).
vec3 sample_uniform_hemisphere(vec2 u) {
    float angle = 2.0 * PI * u.y;
    return vec3(safe_sqrt(1.0 - u.x * u.x) * vec2(cos(angle), sin(angle)), u.x);
}

// Uniform in the cone around an axis. 1 - cos is precise for disks as small as a star, where the cosine isn't.
vec3 sample_cone(vec3 axis, float one_minus_cos_half_angle, vec2 u) {
    float one_minus_cos = one_minus_cos_half_angle * u.x;
    float angle = 2.0 * PI * u.y;
    float sine = safe_sqrt(one_minus_cos * (2.0 - one_minus_cos));
    mat3 frame = orthonormalize(axis);
    return normalize(axis - axis * one_minus_cos + sine * (frame[0] * cos(angle) + frame[1] * sin(angle)));
}

// The inverse of sample_cone: the random numbers for which it returns a direction.
vec2 invert_cone_sample(vec3 axis, float one_minus_cos_half_angle, vec3 direction, float one_minus_cos) {
    vec3 local = direction * orthonormalize(axis);
    float angle = atan(local.y, local.x) / (2.0 * PI);
    return vec2(one_minus_cos / one_minus_cos_half_angle, angle < 0.0 ? angle + 1.0 : angle);
}

// Weights of the second and third vertex, for points uniform over the triangle's area.
vec2 sample_triangle_barycentrics(vec2 u) {
    float root = sqrt(u.x);
    return vec2(root * (1.0 - u.y), root * u.y);
}

// The random numbers for which sample_triangle_barycentrics returns these weights.
vec2 invert_triangle_sample(vec2 barycentrics) {
    float root = barycentrics.x + barycentrics.y;
    return vec2(root * root, root > 0.0 ? barycentrics.y / root : 0.0);
}

#endif
