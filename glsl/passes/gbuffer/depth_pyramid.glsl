// The layout of the depth pyramid: a texel of level n, from 1 on, is the farthest depth of 4^n by 4^n pixels.
#ifndef PASSES_GBUFFER_DEPTH_PYRAMID_GLSL
#define PASSES_GBUFFER_DEPTH_PYRAMID_GLSL

#include "passes/bindings.glsl"
#include "passes/gbuffer/bindings.glsl"

uvec2 pyramid_size(uint level) { return (camera.size + (1u << 2u * level) - 1u) >> 2u * level; }

uint pyramid_index(uint level, uvec2 texel) {
    uint first = 0u;
    for (uint below = 1u; below < level; below++) { first += pyramid_size(below).x * pyramid_size(below).y; }
    return first + texel.y * pyramid_size(level).x + texel.x;
}

#endif
