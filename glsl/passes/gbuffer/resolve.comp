// The raster G-buffer: computes the surface at each pixel's center from the triangle that covers it, as a ray would.
#version 460
#include "common/pixel.glsl"
#include "passes/gbuffer/bindings.glsl"
#include "passes/gbuffer/pixel.glsl"
#include "passes/gbuffer/raster.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 at = gl_GlobalInvocationID.xy;
    if (!is_inside(at, camera.size)) { return; }
    CameraRay ray = make_camera_ray(vec2(at) + 0.5);
    if (imageLoad(depth, ivec2(at)).x == 0.0) {
        store_pixel(at, resolve_empty_pixel(ray));
    } else {
        uvec2 found = imageLoad(raster_triangles, ivec2(at)).xy;
        Mesh mesh = meshes.at[instances.at[found.x].mesh];
        store_pixel(at, resolve_pixel(ray, intersect_triangle(ray, found.x, found.y, mesh), mesh));
    }
}
