// What a probe is and what it finds, for ray queries (probe.glsl) and for ray pipelines (probe_rays.glsl).
#ifndef CONFORMANCE_PROBE_FOUND_GLSL
#define CONFORMANCE_PROBE_FOUND_GLSL

#extension GL_EXT_scalar_block_layout : require

#include "generated/lab/conformance/probe_actions.glsl"
#include "generated/gpu/frame/ray_query_constants.glsl"

struct Probe {
    vec3 origin;
    float t_min;
    vec3 direction;
    float t_max;
    uint flags;
    uint cull_mask;
    uint action;
    float parameter;
};

struct Found {  // RayIntersection, and Vulkan's object-space ray
    uint kind;
    float t;
    uint custom_data;
    uint instance;
    uint sbt_offset;
    uint geometry;
    uint primitive;
    vec2 barycentrics;
    uint front_face;
    mat4x3 object_to_world;
    mat4x3 world_to_object;
    vec3 object_origin;
    vec3 object_direction;
};

layout(set = 0, scalar) readonly buffer Probes { Probe at[]; } probes;

// The smallest t > t_min at which an object-space ray meets the ball of radius 0.5 around a point; negative for a miss.
float sphere_t(vec3 origin, vec3 direction, vec3 center, float t_min) {
    vec3 from_center = origin - center;
    float a = dot(direction, direction), b = dot(from_center, direction);
    float discriminant = b * b - a * (dot(from_center, from_center) - 0.25);
    if (discriminant < 0.0) return -1.0;
    float root = sqrt(discriminant), near = (-b - root) / a;
    return near > t_min ? near : (-b + root) / a;
}

// The center of an AABB's ball in object space: box i spans [2 i, 2 i + 1] in x, [0, 1] in y and z.
vec3 ball_center(uint primitive) { return vec3(2.0 * float(primitive) + 0.5, 0.5, 0.5); }

// Where GENERATE_AT generates a hit in a box after this many others.
float generated_t(Probe probe, uint boxes_before) {
    float t = probe.parameter;
    if ((probe.action & NEARER) != 0u) { t -= float(boxes_before); }
    if ((probe.action & FARTHER) != 0u) { t += float(boxes_before); }
    return t;
}

#endif
