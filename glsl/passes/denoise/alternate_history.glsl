// The history of a second surface in a pixel. Samples are jittered within the pixel, so that at edges they show one of
// two surfaces by turns, as they do by chance where a surface is blended: while frames show one of them, the history of
// the other is put aside here.
#ifndef PASSES_DENOISE_ALTERNATE_HISTORY_GLSL
#define PASSES_DENOISE_ALTERNATE_HISTORY_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/denoise/signal.glsl"

struct AlternateHistory {
    // A packed guide, in which the number of frames replaces the lowest 8 bits of the depth (6 to 13 of y); 0: none.
    uvec2 surface;
    uvec3 light;    // the radiance of both lobes and their second moments
};

layout(set = 1, scalar) buffer DenoiseAlternateBlock { AlternateHistory at[]; } denoise_alternate;
layout(set = 1, scalar) readonly buffer PreviousDenoiseAlternateBlock { AlternateHistory at[]; }
    previous_denoise_alternate;

const AlternateHistory NO_ALTERNATE = AlternateHistory(uvec2(0u), uvec3(0u));

const uint FRAMES_MASK = 0xFFu << 6u;

// The packed guide: depth bits that the number of frames has replaced are set to the middle of their range.
uvec2 surface_of(AlternateHistory alternate) {
    return uvec2(alternate.surface.x, alternate.surface.y & ~FRAMES_MASK | 0x80u << 6u);
}

uvec2 with_frames(uvec2 surface, float frames) {
    return uvec2(surface.x, surface.y & ~FRAMES_MASK | uint(min(frames, 255.0) + 0.5) << 6u);
}

float frames_of(uvec2 surface) { return float((surface.y & FRAMES_MASK) >> 6u); }

AlternateHistory pack_alternate(uvec2 guide, LobeHistory diffuse, LobeHistory specular, inout uint rng) {
    return AlternateHistory(with_frames(guide, min(diffuse.frames, specular.frames)), uvec3(
        pack_color(diffuse.radiance, rand_u(rng)), pack_color(specular.radiance, rand_u(rng)),
        pack_two(diffuse.second_moment, specular.second_moment, rng)
    ));
}

LobeHistory alternate_lobe_history(vec3 radiance, float second_moment, float frames) {
    float mean = luminance(radiance);
    return LobeHistory(radiance, max(second_moment, mean * mean), mean, frames, 0.0);
}

void unpack_alternate(AlternateHistory alternate, out LobeHistory diffuse, out LobeHistory specular) {
    float frames = frames_of(alternate.surface);
    diffuse = alternate_lobe_history(unpack_color(alternate.light.x), unpack_positive(alternate.light.z, 16u), frames);
    specular = alternate_lobe_history(unpack_color(alternate.light.y), unpack_positive(alternate.light.z >> 16u, 16u),
        frames);
}

// Makes the history count as fewer frames after a change of light that left the share `confidence` of it valid.
void shorten_alternate(uint index, float confidence) {
    uvec2 surface = denoise_alternate.at[index].surface;
    denoise_alternate.at[index].surface = with_frames(surface, frames_of(surface) * confidence);
}

#endif
