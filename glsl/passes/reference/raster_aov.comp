// Writes AOVs of the triangles that raster found, for scenes with instances whose ray mesh is another than their mesh.
#version 460
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/bindings.glsl"
#include "passes/gbuffer/raster.glsl"
#include "passes/reference/aov.glsl"
#include "scene/camera.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy + uvec2(0u, path_sampling.first_row);
    if (!is_inside(pixel, camera.size) || gl_GlobalInvocationID.y >= path_sampling.row_count) { return; }
    uint index = pixel_index(pixel, camera.size);
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    if (imageLoad(depth, ivec2(pixel)).x == 0.0) {
        if (has_motion) { aov_motion_vectors.at[index] = background_motion_vector(ray); }
        else { store_empty_aovs(index); }
        return;
    }
    uvec2 found = imageLoad(raster_triangles, ivec2(pixel)).xy;
    Mesh mesh = meshes.at[instances.at[found.x].mesh];
    Hit hit = intersect_triangle(ray, found.x, found.y, mesh);
    if (has_motion) {
        aov_motion_vectors.at[index] = hit_motion_vector(hit, mesh);
    } else {
        store_aovs(index, ray, hit, mesh);
    }
}
