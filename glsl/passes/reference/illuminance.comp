// Illuminance at points, as the radiance that a white Lambert surface would have there: illuminance over pi. Paths
// start at the points. The cylindrical illuminance is the mean over all normals perpendicular to an axis.
#version 460
#include "passes/reference/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

struct MeasuredPoint {
    vec3 position;
    vec3 normal;  // cylindrical: the axis
    float reach;  // more than the rounding error of any surface that the point lies on
};

layout(set = 1, scalar) uniform MeasurementBlock { uint cylindrical; } measurement;
layout(set = 1, scalar) readonly buffer MeasuredPointsBlock { MeasuredPoint at[]; } measured_points;

vec3 lifted_position;  // of the pixel's point
const uint MAX_SURFACES_NEAR = 16u;

// Lifts a point that lies on a surface off it, by the offset of rays that leave the surface.
vec3 start_position(uvec2 pixel) {
    MeasuredPoint measured = measured_points.at[pixel_index(pixel, camera.size)];
    lifted_position = measured.position;
    float t = 0.0, t_max = 2.0 * measured.reach;
    vec3 from = measured.position + measured.reach * measured.normal;
    for (uint i = 0u; i < MAX_SURFACES_NEAR; i++) {
        Hit hit = trace_closest_hit(from, t, -measured.normal, t_max, TRACE_BOTH_FACES, EVERY_SURFACE);
        if (hit.instance == NO_INDEX) { break; }
        Instance instance = instances.at[hit.instance];
        TrianglePoint point = resolve_triangle(instance, meshes.at[instance.ray_mesh], hit.triangle, hit.barycentrics);
        vec3 normal = faceforward(point.geometric_world_normal, -measured.normal, point.geometric_world_normal);
        float above = dot(measured.position - point.world_position, normal);
        if (abs(above) <= 2.0 * point.ray_offset) {
            lifted_position += (point.ray_offset - above) * normal;
            break;
        }
        t = uintBitsToFloat(floatBitsToUint(hit.t) + 1u);
    }
    return lifted_position;
}

bool start_path(uvec2 pixel, inout Path path, inout Vertex vertex, inout uint rng) {
    MeasuredPoint point = measured_points.at[pixel_index(pixel, camera.size)];
    vertex.frame = orthonormalize(point.normal);
    if (measurement.cylindrical != 0u) {
        float angle = 2.0 * PI * rand_f(rng);
        vertex.frame = orthonormalize(vertex.frame * vec3(cos(angle), sin(angle), 0.0));
    }
    vertex.surface.world_position = lifted_position;
    vertex.surface.world_normal = vertex.surface.geometric_world_normal = vertex.frame[2];
    vertex.surface.ray_offset = vertex.surface.lift = 0.0;
    vertex.brdf = lambert_brdf(vec3(1.0));
    vertex.wo = vec3(0.0, 0.0, 1.0);
    vertex.below = NO_MEDIUM;
    path.walk = start_walk(lifted_position, -vertex.frame[2]);
    return true;
}

uvec2 sample_range(uvec2 pixel) { return uniform_sample_range(); }

void main() { trace_paths(); }
