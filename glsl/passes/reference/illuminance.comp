// Illuminance at points, as the radiance that a white Lambert surface would have there: illuminance over pi. Paths
// start at the points. The cylindrical illuminance is the mean over all normals perpendicular to an axis.
#version 460
#include "passes/reference/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

struct MeasuredPoint {
    vec3 position;
    vec3 normal;  // cylindrical: the axis
};

layout(set = 1, scalar) uniform MeasurementBlock { uint cylindrical; } measurement;
layout(set = 1, scalar) readonly buffer MeasuredPointsBlock { MeasuredPoint at[]; } measured_points;

bool start_path(uvec2 pixel, inout Path path, inout Vertex vertex, inout uint rng) {
    MeasuredPoint point = measured_points.at[pixel_index(pixel, camera.size)];
    vertex.frame = orthonormalize(point.normal);
    if (measurement.cylindrical != 0u) {
        float angle = 2.0 * PI * rand_f(rng);
        vertex.frame = orthonormalize(vertex.frame * vec3(cos(angle), sin(angle), 0.0));
    }
    vertex.surface.world_position = point.position;
    vertex.surface.world_normal = vertex.surface.geometric_world_normal = vertex.frame[2];
    vertex.surface.ray_offset = 0.0;
    vertex.brdf = lambert_brdf(vec3(1.0));
    vertex.wo = vec3(0.0, 0.0, 1.0);
    vertex.below = NO_MEDIUM;
    path.walk = start_walk(point.position, -vertex.frame[2]);
    return true;
}

uvec2 sample_range(uvec2 pixel) { return uniform_sample_range(); }

void main() { trace_paths(); }
