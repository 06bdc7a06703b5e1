// Decides which instances are drawn: first those that were visible in the previous frame, then those that the first
// ones don't hide. Two-pass occlusion culling: Haar and Aaltonen, "GPU-Driven Rendering Pipelines" (SIGGRAPH 2015).
#version 460
#include "common/math.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/bindings.glsl"
#include "passes/gbuffer/depth_pyramid.glsl"
#include "scene/bindings.glsl"
#include "scene/camera.glsl"

layout(local_size_x = 64) in;
layout(constant_id = draw_pass_id) const uint draw_pass = 0u;  // 0 for the first, 1 for the second
layout(constant_id = frustum_culling_id) const bool frustum_culling = true;
layout(constant_id = occlusion_culling_id) const bool occlusion_culling = true;

// The bounds of an instance in view space: center + half_axes * (a corner of the cube from -1 to 1).
struct ViewBox {
    vec3 center;
    mat3 half_axes;
    float rounding;  // distance in meters by which rounding may move vertices out of the box
};

ViewBox find_view_box(mat4x3 world_from_object, Mesh mesh) {
    vec3 eye = camera.world_from_view[3];
    vec3 half_extent = 0.5 * (mesh.bounds_max - mesh.bounds_min);
    vec3 center = world_from_object * vec4(mesh.bounds_min + half_extent, 1.0);
    mat3 half_axes = mat3(world_from_object);
    for (uint i = 0u; i < 3u; i++) { half_axes[i] *= half_extent[i]; }
    vec3 reach = abs(center) + abs(half_axes[0]) + abs(half_axes[1]) + abs(half_axes[2]) + abs(eye);
    mat3 turn = mat3(camera.view_from_world);
    return ViewBox(turn * (center - eye), turn * half_axes, 32.0 * ROUNDING_UNIT * max_component(reach));
}

// Returns whether a box lies wholly on the positive side of a plane, at the given distance from the eye.
bool is_beyond(ViewBox box, vec3 normal, float distance) {
    vec3 spread = abs(normal * box.half_axes);
    return dot(normal, box.center) - (spread.x + spread.y + spread.z) > distance + 2.0 * box.rounding * length(normal);
}

bool is_outside_frustum(ViewBox box) {
    // The picture's edges, two pixels further out. Jitter moves them, by much where the principal point isn't in the
    // middle. A pixel's width is 2 / size of tan_half_fov.
    vec2 margin = 1.0 + 4.0 / vec2(camera.size), shift = 2.0 * camera.jitter / vec2(camera.size) * vec2(1.0, -1.0);
    vec4 slope = camera.tan_half_fov.xyxy * vec4(margin + shift, margin - shift);  // right, top, left, bottom
    bool orthographic = is_orthographic(camera);
    vec4 distance = orthographic ? slope : vec4(0.0);
    slope = orthographic ? vec4(0.0) : slope;
    return is_beyond(box, vec3(1.0, 0.0, slope.x), distance.x) || is_beyond(box, vec3(-1.0, 0.0, slope.z), distance.z)
        || is_beyond(box, vec3(0.0, 1.0, slope.y), distance.y) || is_beyond(box, vec3(0.0, -1.0, slope.w), distance.w)
        || is_beyond(box, vec3(0.0, 0.0, 1.0), -camera.near);
}

// Returns whether everything that was drawn in the pixels of a box is nearer than the box.
bool is_occluded(ViewBox box) {
    vec2 low = vec2(INFINITY), high = vec2(-INFINITY);  // in pixels
    float nearest = INFINITY;
    for (uint i = 0u; i < 8u; i++) {
        vec3 corner = box.center + box.half_axes * (2.0 * vec3(i & 1u, i >> 1u & 1u, i >> 2u) - 1.0);
        float view_depth = -corner.z - box.rounding;
        if (view_depth <= camera.near) { return false; }
        vec2 ndc = corner.xy * vec2(1.0, -1.0) / (camera.tan_half_fov * (is_orthographic(camera) ? 1.0 : view_depth));
        vec2 position = (0.5 + 0.5 * ndc) * vec2(camera.size) - camera.jitter;
        low = min(low, position);
        high = max(high, position);
        nearest = min(nearest, view_depth);
    }
    // A pixel more on each side, for rounding, and because depth is known at pixel centers only.
    vec2 last_pixel = vec2(camera.size - 1u);
    uvec2 first = uvec2(clamp(floor(low) - 1.0, vec2(0.0), last_pixel));
    uvec2 last = uvec2(clamp(floor(high) + 1.0, vec2(0.0), last_pixel));
    uint level = 1u;
    while (any(greaterThan((last >> 2u * level) - (first >> 2u * level), uvec2(3u)))) { level++; }
    float farthest = INFINITY;
    for (uint y = first.y >> 2u * level; y <= last.y >> 2u * level; y++) {
        for (uint x = first.x >> 2u * level; x <= last.x >> 2u * level; x++) {
            farthest = min(farthest, depth_pyramid.at[pyramid_index(level, uvec2(x, y))]);
        }
    }
    float depth_value = is_orthographic(camera)
        ? 1.0 - (nearest - camera.near) / camera.orthographic_range + 1e-6
        : camera.near / nearest * 1.0001;
    return depth_value < farthest;
}

void main() {
    uint row = gl_GlobalInvocationID.x;
    // Both, because lavapipe rounds the size of a bound buffer up to 16 bytes.
    if (row >= min(visible_instances.at.length(), instances.at.length())) { return; }
    Instance instance = instances.at[row];
    bool draws = false, double_sided = false;
    uint vertex_count = 0u;
    if (instance.id != 0u && instance.mesh != NO_INDEX) {
        Mesh mesh = meshes.at[instance.mesh];
        vertex_count = 3u * mesh.triangle_count;
        double_sided = (materials.at[instance.material].flags & MATERIAL_HIDES_BACK) == 0u;
        ViewBox box = find_view_box(instance.world_from_object, mesh);
        bool outside = frustum_culling && is_outside_frustum(box);
        bool was_visible = !occlusion_culling || visible_instances.at[row] == instance.id;
        if (draw_pass == 0u) {
            draws = !outside && was_visible;
            if (draws) { atomicAdd(gbuffer_counters.drawn_first, 1u); }
            if (outside) { atomicAdd(gbuffer_counters.frustum_culled, 1u); }
        } else {
            bool visible = !outside && !is_occluded(box);
            draws = visible && !was_visible;
            visible_instances.at[row] = visible ? instance.id : 0u;
            if (draws) { atomicAdd(gbuffer_counters.drawn_second, 1u); }
            if (!visible && !outside && !was_visible) { atomicAdd(gbuffer_counters.occlusion_culled, 1u); }
        }
    }
    uint single = uint(draws && !double_sided), both = uint(draws && double_sided);
    single_sided_draws.at[row] = DrawCommand(vertex_count, single, 0u, row);
    double_sided_draws.at[row] = DrawCommand(vertex_count, both, 0u, row);
    if (single != 0u) { atomicMax(draw_counts.at[draw_pass].x, row + 1u); }
    if (both != 0u) { atomicMax(draw_counts.at[draw_pass].y, row + 1u); }
}
