// The light of a second surface in a pixel. Positions of samples move within the pixel, so that at edges they show one
// of two surfaces by turns: the history of one is put aside in the frames that show the other.
#ifndef PASSES_DENOISE_ASIDE_GLSL
#define PASSES_DENOISE_ASIDE_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe.glsl"
#include "passes/denoise/signal.glsl"

struct Aside {
    uvec2 surface;  // a packed guide, with the number of frames in place of the depth's last bits; 0 for none
    uvec3 light;    // the radiance of both lobes and their second moments
};

layout(set = 1, scalar) buffer DenoiseAsideBlock { Aside at[]; } denoise_aside;

const uint FRAMES_MASK = 0xFFu << 6u;

uvec2 surface_of(Aside aside) { return uvec2(aside.surface.x, aside.surface.y & ~FRAMES_MASK | 0x80u << 6u); }

uvec2 with_frames(uvec2 surface, float frames) {
    return uvec2(surface.x, surface.y & ~FRAMES_MASK | uint(min(frames, 255.0) + 0.5) << 6u);
}

float frames_of(uvec2 surface) { return float((surface.y & FRAMES_MASK) >> 6u); }

Aside pack_aside(uvec2 guide, Lobe diffuse, Lobe specular, inout uint rng) {
    return Aside(with_frames(guide, min(diffuse.frames, specular.frames)), uvec3(
        pack_color(diffuse.radiance, rand_u(rng)), pack_color(specular.radiance, rand_u(rng)),
        pack_two(diffuse.second_moment, specular.second_moment, rng)
    ));
}

Lobe lobe_aside(vec3 radiance, float second_moment, float frames) {
    float mean = luminance(radiance);
    return Lobe(radiance, max(second_moment, mean * mean), mean, frames, 0.0);
}

void unpack_aside(Aside aside, out Lobe diffuse, out Lobe specular) {
    float frames = frames_of(aside.surface);
    diffuse = lobe_aside(unpack_color(aside.light.x), unpack_positive(aside.light.z, 16u), frames);
    specular = lobe_aside(unpack_color(aside.light.y), unpack_positive(aside.light.z >> 16u, 16u), frames);
}

// After a change of light, of which histories remain valid by the share `confidence`.
void shorten_aside(uint index, float confidence) {
    uvec2 surface = denoise_aside.at[index].surface;
    denoise_aside.at[index].surface = with_frames(surface, frames_of(surface) * confidence);
}

#endif
