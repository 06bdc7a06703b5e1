// A smooth surface shows two images, which move apart. Keeps the motion of what it reflects, which resolve.comp
// follows, only where that varies more than all else around a pixel.
#version 460
#include "passes/taa/samples.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// Whether what a smooth surface reflects varies by more than all else around a pixel.
bool reflects_most(ivec2 center) {
    float reflected = 0.0, others = 0.0, reflected_squares = 0.0, other_squares = 0.0, count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size)) { continue; }
        uint index = element_index(pixel, camera.size);
        float specular = luminance(specular_radiance.at[index]), other = luminance(load_sample(pixel)) - specular;
        reflected += specular;
        others += other;
        reflected_squares += specular * specular;
        other_squares += other * other;
        count += 1.0;
    }
    return reflected_squares - square(reflected) / count > other_squares - square(others) / count;
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (!find_pixel(pixel, index)) { return; }
    if (!(unpackHalf2x16(reflection_motion.at[index]).x < NO_REFLECTION_MOTION)) { return; }
    // Each point of the lens sees a reflection elsewhere.
    if (camera.lens_radius > 0.0 || !reflects_most(ivec2(pixel))) {
        reflection_motion.at[index] = packHalf2x16(vec2(2.0 * NO_REFLECTION_MOTION));
    }
}
