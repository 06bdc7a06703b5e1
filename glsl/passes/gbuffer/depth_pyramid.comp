// Computes a level of the depth pyramid for occlusion culling: Greene et al., "Hierarchical Z-Buffer Visibility"
// (1993).
#version 460
#include "common/math.glsl"
#include "passes/gbuffer/depth_pyramid.glsl"

layout(local_size_x = 8, local_size_y = 8) in;
layout(constant_id = level_id) const uint level = 1u;

void main() {
    uvec2 texel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(texel, pyramid_size(level)))) { return; }
    float farthest = INFINITY;
    for (uint i = 0u; i < 16u; i++) {
        uvec2 below = min(4u * texel + uvec2(i % 4u, i / 4u), pyramid_size(level - 1u) - 1u);
        float below_depth =
            level == 1u ? imageLoad(depth, ivec2(below)).x : depth_pyramid.at[pyramid_index(level - 1u, below)];
        farthest = min(farthest, below_depth);
    }
    depth_pyramid.at[pyramid_index(level, texel)] = farthest;
}
