// Adds up the radiance of all passes for each pixel, and the emission that is directly visible.
#version 460
#include "common/pixel.glsl"
#include "passes/display/emission.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);

    vec3 emitted = visible_emission(pixel);
    vec3 diffuse = di_diffuse.at[index] + gi_diffuse.at[index];
    vec3 specular = di_specular.at[index] + specular_gi.at[index];
    emission.at[index] = emitted;
    diffuse_radiance.at[index] = diffuse;
    specular_radiance.at[index] = specular;
    sample_radiance.at[index] = emitted + diffuse + specular;
}
