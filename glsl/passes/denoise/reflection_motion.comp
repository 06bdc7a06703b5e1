// A smooth surface shows two images, which move apart. Finds how what it reflects moves, where that varies more than
// all else around a pixel: taa/resolve.comp follows it there.
#version 460
#include "passes/denoise/virtual_motion.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Whether what a smooth surface reflects varies by more than all else around a pixel of it.
bool reflects_most(ivec2 center) {
    uint instance = imageLoad(gbuffer_surface, texel_of(center)).y;
    float reflected = 0.0, others = 0.0, reflected_squares = 0.0, other_squares = 0.0, count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size) || imageLoad(gbuffer_surface, texel_of(pixel)).y != instance) { continue; }
        uint index = element_index(pixel, camera.size);
        float specular = luminance(specular_radiance.at[index]);
        float other = luminance(sample_radiance.at[index]) - specular;
        reflected += specular;
        others += other;
        reflected_squares += specular * specular;
        other_squares += other * other;
        count += 1.0;
    }
    return reflected_squares - square(reflected) / count > other_squares - square(others) / count;
}

// Returns false where no reflection is followed.
bool find_reflection_motion(ivec2 pixel, uint index, out vec2 motion) {
    // Each point of the lens sees a reflection elsewhere.
    if (this_frame.has_history == 0u || camera.lens_radius > 0.0) { return false; }
    if (kind_of(denoise_guides.at[index]) != PRIMARY_SURFACE) { return false; }
    Guide guide = make_guide(pixel);
    if (!(guide.roughness_or_albedo < SHARP_REFLECTION)) { return false; }
    float inverse_hit_distance = unpack_lobe_history(denoise_specular.at[index]).inverse_hit_distance;
    PreviousSurface previous = find_previous_surface(pixel, guide);
    bool moved = view_change(guide, previous) >= MIN_VIEW_CHANGE;
    if (!moved || inverse_hit_distance == 0.0 || !reflects_most(pixel)) { return false; }
    float twice_curvature = 2.0 * curvature(pixel, guide);
    vec2 before;
    bool found = find_virtual_pixel(pixel, guide, previous, inverse_hit_distance, twice_curvature, before);
    motion = before - (vec2(pixel) + 0.5);
    return found;
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (taa_settings.antialiasing == 0u || !find_pixel(pixel, index)) { return; }
    vec2 motion;
    bool found = find_reflection_motion(ivec2(pixel), index, motion);
    reflection_motion.at[index] = packHalf2x16(found ? motion : vec2(2.0 * NO_REFLECTION_MOTION));
}
