// Starts paths that measure the illuminance at points, as the radiance that a white Lambert surface would have there:
// illuminance over pi. The cylindrical illuminance is the mean over all normals perpendicular to an axis.
#version 460
#include "passes/reference/waves.glsl"

layout(local_size_x = GROUP_SIZE) in;

struct MeasuredPoint {
    vec3 position;
    vec3 normal;  // cylindrical: the axis
    float reach;  // more than the rounding error of any surface that the point lies on
};

layout(set = 1, scalar) uniform MeasurementBlock { uint cylindrical; } measurement;
layout(set = 1, scalar) readonly buffer MeasuredPointsBlock { MeasuredPoint at[]; } measured_points;

const uint MAX_SURFACES_NEAR = 16u;

// A measured point, lifted off the surface that it lies on by the offset of rays that leave the surface.
vec3 lifted_position(MeasuredPoint measured) {
    float t = 0.0, t_max = 2.0 * measured.reach;
    vec3 from = measured.position + measured.reach * measured.normal;
    for (uint i = 0u; i < MAX_SURFACES_NEAR; i++) {
        Hit hit = trace_closest_hit(from, t, -measured.normal, t_max, TRACE_BOTH_FACES, EVERY_SURFACE);
        if (hit.instance == NO_INDEX) { break; }
        Instance instance = instances.at[hit.instance];
        TrianglePoint point = resolve_triangle(instance, meshes.at[instance.ray_mesh], hit.triangle, hit.barycentrics);
        vec3 normal = faceforward(point.geometric_world_normal, -measured.normal, point.geometric_world_normal);
        float above = dot(measured.position - point.world_position, normal);
        if (abs(above) <= 2.0 * point.ray_offset) { return measured.position + (point.ray_offset - above) * normal; }
        t = uintBitsToFloat(floatBitsToUint(hit.t) + 1u);
    }
    return measured.position;
}

Vertex make_vertex(MeasuredPoint point, inout uint rng) {
    Vertex vertex;
    vertex.frame = orthonormalize(point.normal);
    if (measurement.cylindrical != 0u) {
        float angle = 2.0 * PI * rand_f(rng);
        vertex.frame = orthonormalize(vertex.frame * vec3(cos(angle), sin(angle), 0.0));
    }
    vertex.surface.world_position = lifted_position(point);
    vertex.surface.world_normal = vertex.surface.geometric_world_normal = vertex.frame[2];
    vertex.surface.ray_offset = vertex.surface.lift = 0.0;
    vertex.brdf = lambert_brdf(vec3(1.0));
    vertex.wo = vec3(0.0, 0.0, 1.0);
    vertex.below = NO_MEDIUM;
    return vertex;
}

void main() {
    uint index = thread_index(INVOCATION_INDEX), sample_index;
    uvec2 pixel;
    if (!find_path(index, pixel, sample_index)) { return; }
    choose_sample(sample_index);
    WaitingPath waiting;
    waiting.rng = next_rng(pixel, sample_index, 0u, 0u);
    Vertex vertex = make_vertex(measured_points.at[pixel_index(pixel, camera.size)], waiting.rng);
    Path path = begin_path();
    path.walk = start_walk(vertex.surface.world_position, -vertex.frame[2]);
    path.walk.medium = find_medium(vertex.surface.world_position);
    waiting.walks = leave_vertex(path, vertex, waiting.rng);
    waiting.path = path;
    store_path(index, waiting);
    if (has_rays(waiting)) { queue_path(index); }
}
