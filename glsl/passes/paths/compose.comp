// Multiplies the light of paths by the surfaces' colors again, and adds the emission that is directly visible.
#version 460
#include "passes/display/emission.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/paths/demodulation.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    uint index = pixel.y * camera.size.x + pixel.x;
    GBufferSurface surface = load_gbuffer(pixel);
    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    if (surface.exists) {
        Demodulation by = demodulation(surface);
        diffuse = paths_diffuse.at[index].rgb * by.diffuse;
        specular = paths_specular.at[index].rgb * by.specular;
    }
    vec3 emitted = visible_emission(pixel);
    emission.at[index] = emitted;
    diffuse_radiance.at[index] = diffuse;
    specular_radiance.at[index] = specular;
    radiance.at[index] = emitted + diffuse + specular;
}
