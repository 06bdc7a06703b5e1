// Multiplies the light of both lobes, denoised or not, by the surfaces' colors again, and adds visible emission.
#version 460
#include "passes/camera_medium.glsl"
#include "passes/denoise/api.glsl"
#include "passes/display/emission.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/paths/short_history.glsl"  // turn_count
#include "passes/demodulation.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The factor of a pixel's light in raw_radiance. With the setting upscale a path that a pixel takes in its turn stands
// for all pixels of the block, so that the mean of raw frames is right. A path out of turn doesn't count: what has just
// come into view would be too bright with it.
float stands_for(uint index) {
    if (!uses_denoiser(index)) { return 1.0; }
    uint number;
    return pixels_per_path * float(turn_count(index, number));
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (!find_pixel(pixel, index)) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    vec3 diffuse = vec3(0.0), specular = vec3(0.0);
    Demodulation albedo;
    if (surface.exists) {
        albedo = demodulation(surface);
        diffuse = paths_diffuse.at[index].rgb * albedo.diffuse;
        specular = paths_specular.at[index].rgb * albedo.specular;
    }
    Medium medium = camera_medium();
    vec3 emitted = visible_emission(pixel, medium);
    vec3 arrives = transmittance(medium, distance(surface.world_position, make_camera_ray(vec2(pixel) + 0.5).origin));
    raw_radiance.at[index] = emitted + stands_for(index) * (diffuse + specular) * arrives;
    error.at[index] = 0.0;
    if (uses_denoiser(index)) {
        Denoised light = denoised(pixel);
        albedo.specular *= light.psr_albedo;
        diffuse = light.diffuse * albedo.diffuse;
        specular = light.specular * albedo.specular;
        error.at[index] = standard_error(light, index, albedo.diffuse * arrives, albedo.specular * arrives);
    }
    diffuse *= arrives;
    specular *= arrives;
    emission.at[index] = emitted;
    diffuse_radiance.at[index] = diffuse;
    specular_radiance.at[index] = specular;
    sample_radiance.at[index] = emitted + diffuse + specular;
}
