// The light of the separate passes as the denoiser takes it: of the diffuse and of the specular lobe, each over the
// lobe's albedo. Differs from Solari, which gives the sum of all passes to DLSS Ray Reconstruction.
#version 460
#include "common/pixel.glsl"
#include "passes/demodulation.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    if (!is_inside(pixel, camera.size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    paths_diffuse.at[index] = paths_specular.at[index] = vec4(0.0);
    GBufferSurface surface = load_gbuffer(pixel);
    if (!surface.exists) { return; }
    Demodulation albedo = demodulation(surface);
    vec3 diffuse = di_diffuse.at[index] + gi_diffuse.at[index];
    vec3 specular = di_specular.at[index] + specular_gi.at[index];
    paths_diffuse.at[index].rgb = diffuse / albedo.diffuse;
    paths_specular.at[index] = vec4(specular / albedo.specular, specular_gi_distances.at[index]);
}
