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
    if (imageLoad(depth, ivec2(pixel)).x == 0.0) {
        store_empty_aovs(index);
        return;
    }
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    uvec2 found = imageLoad(raster_triangles, ivec2(pixel)).xy;
    Mesh mesh = meshes.at[instances.at[found.x].mesh];
    store_aovs(index, ray, intersect_triangle(ray, found.x, found.y, mesh), mesh);
}
