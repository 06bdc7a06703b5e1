// The ray of the wgpu ray tracing document, and which rays it calls invalid.
#ifndef SCENE_RAY_DESC_GLSL
#define SCENE_RAY_DESC_GLSL

#include "generated/gpu/frame/ray_query_constants.glsl"

struct RayDesc {
    uint flags;
    uint cull_mask;  // the ray ignores instances whose mask shares no bit with it
    float t_min;
    float t_max;
    vec3 origin;
    vec3 dir;  // of any length, which is the unit of t
};

bool ray_query_at_most_one(uint flags) { return (flags & (flags - 1u)) == 0u; }

bool ray_query_flags_agree(uint flags) {
    return ray_query_at_most_one(flags & (FORCE_OPAQUE | FORCE_NO_OPAQUE | CULL_OPAQUE | CULL_NO_OPAQUE))
        && ray_query_at_most_one(flags & (CULL_BACK_FACING | CULL_FRONT_FACING | SKIP_TRIANGLES))
        && ray_query_at_most_one(flags & (SKIP_TRIANGLES | SKIP_AABBS));
}

// Returns false for rays that Vulkan leaves undefined and that could hang a device. Tests bit patterns, because Vulkan
// allows devices to ignore NaN in comparisons. An infinite t_max is valid.
bool ray_query_is_valid(RayDesc desc) {
    const uint infinity = 0x7F800000u, no_sign = 0x7FFFFFFFu;
    uvec3 origin = floatBitsToUint(desc.origin) & no_sign, dir = floatBitsToUint(desc.dir) & no_sign;
    uint t_min = floatBitsToUint(desc.t_min) & no_sign, t_max = floatBitsToUint(desc.t_max) & no_sign;
    bool finite = all(lessThan(origin, uvec3(infinity))) && all(lessThan(dir, uvec3(infinity)));
    bool numbers = t_min < infinity && t_max <= infinity;
    return finite && numbers && any(notEqual(desc.dir, vec3(0.0))) && desc.t_min >= 0.0 && desc.t_min <= desc.t_max;
}

#endif
