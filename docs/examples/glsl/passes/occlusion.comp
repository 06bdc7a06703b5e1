// How open points of surfaces are: the part of the cosine-weighted hemisphere that nothing hides within a distance.
#version 460
#include "common/math.glsl"
#include "common/random.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 64) in;

struct Point {
    vec3 position;
    vec3 normal;
};
layout(set = 1, binding = 0, scalar) uniform UniformsBlock {
    uint count;
    uint samples;
    float reach;
} baking;
layout(set = 1, binding = 1, scalar) readonly buffer PointsBlock { Point at[]; } points;
layout(set = 1, binding = 2, scalar) writeonly buffer OpennessBlock { float at[]; } openness;

void main() {
    uint i = INVOCATION_INDEX.x;
    if (i >= baking.count) { return; }
    Point point = points.at[i];
    mat3 frame = orthonormalize(point.normal);
    uint rng = seed_rng(uvec2(i, 0u), 0u, 0u);
    uint seen = 0u;
    for (uint n = 0u; n < baking.samples; n += 1u) {
        vec3 direction = frame * sample_cosine_hemisphere(rand_vec2f(rng));
        seen += uint(trace_visibility(point.position + 1e-4 * point.normal, direction, baking.reach));
    }
    openness.at[i] = float(seen) / float(max(baking.samples, 1u));
}
