// Writes the nearest triangle of each pixel: Burns and Hunt, "The Visibility Buffer: A Cache-Friendly Approach to
// Deferred Shading" (JCGT 2013). A fragment that is hidden later costs no more than this. Where a surface has alpha,
// fragments are discarded with the random numbers of the traced G-buffer.
// Differs from Solari, whose fragments write the G-buffer.
#version 460
#include "passes/gbuffer/pixel.glsl"
#include "passes/gbuffer/raster.glsl"
#include "scene/alpha.glsl"

layout(location = 0) flat in uint row;
layout(location = 1) flat in uint triangle;
layout(location = 0) out uvec2 out_triangle;
layout(location = 1) out float out_depth;

bool is_shown() {
    Instance instance = instances.at[row];
    Material material = materials.at[instance.material];
    if (!has_alpha(material)) { return true; }
    Mesh mesh = meshes.at[instance.mesh];
    uvec2 pixel = uvec2(gl_FragCoord.xy);
    Hit hit = intersect_triangle(make_camera_ray(vec2(pixel) + 0.5), row, triangle, mesh);
    float opacity = resolve_color_opacity(material, mesh, triangle, hit.barycentrics).w;
    return accepts_hit(opacity, pixel_alpha_seed(pixel), row, mesh, triangle, hit.barycentrics);
}

void main() {
    if (SCENE_ALPHA && !is_shown()) { discard; }
    out_triangle = uvec2(row, triangle);
    out_depth = gl_FragCoord.z;
}
