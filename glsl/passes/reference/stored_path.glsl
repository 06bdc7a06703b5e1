// What `stored_paths` keeps of a path from one pass to the next.
#ifndef PASSES_REFERENCE_STORED_PATH_GLSL
#define PASSES_REFERENCE_STORED_PATH_GLSL

#include "passes/reference/path.glsl"
#include "passes/reference/quads.glsl"

// A path that waits for its rays to be traced.
struct WaitingPath {
    Path path;
    bool walks;  // whether it has a ray besides its shadow ray
    uint rng;
};

const uint WALKS = 1u << 31, IS_CAMERA_RAY = 1u << 30, DELTA_PATH = 1u << 29;  // of flags; the rest is path.bounce
const uint HIT_QUAD = 9u, PASSED_QUAD = 11u, ALONG_RAY_QUAD = 12u;  // which trace_wave.comp writes

void store_radiance(uint index, Path path) { store_quad(index, RADIANCE_QUAD, path.radiance, path.rays); }

void store_path(uint index, WaitingPath waiting) {
    Path path = waiting.path;
    Walk walk = path.walk;
    uint flags = path.bounce | (waiting.walks ? WALKS : 0u) | (walk.is_camera_ray ? IS_CAMERA_RAY : 0u)
        | (walk.delta_path_from_camera ? DELTA_PATH : 0u);
    store_quad(index, 0u, walk.origin, walk.t_min);
    store_quad(index, 1u, walk.direction, flags);
    store_quad(index, 2u, walk.throughput, walk.mis_pdf);
    store_quad(index, 3u, path.receiver.position, walk.medium.material);
    store_quad(index, 4u, path.receiver.normal, walk.medium.around);
    store_quad(index, 5u, path.shadow_ray.origin, path.shadow_ray.t_max);
    store_quad(index, 6u, path.shadow_ray.direction, walk.wavelength);
    store_quad(index, 7u, path.shadow_ray.radiance, waiting.rng);
    store_radiance(index, path);
}

WaitingPath load_path(uint index) {
    WaitingPath waiting;
    Path path;
    uint flags;
    path.walk = start_walk(vec3(0.0), vec3(0.0));
    path.walk.origin = load_quad(index, 0u, path.walk.t_min);
    path.walk.direction = load_quad(index, 1u, flags);
    path.walk.throughput = load_quad(index, 2u, path.walk.mis_pdf);
    path.receiver.position = load_quad(index, 3u, path.walk.medium.material);
    path.receiver.normal = load_quad(index, 4u, path.walk.medium.around);
    path.shadow_ray.origin = load_quad(index, 5u, path.shadow_ray.t_max);
    path.shadow_ray.direction = load_quad(index, 6u, path.walk.wavelength);
    path.shadow_ray.radiance = load_quad(index, 7u, waiting.rng);
    path.radiance = load_radiance(index, path.rays);
    path.walk.is_camera_ray = (flags & IS_CAMERA_RAY) != 0u;
    path.walk.delta_path_from_camera = (flags & DELTA_PATH) != 0u;
    path.bounce = flags & (DELTA_PATH - 1u);
    waiting.walks = (flags & WALKS) != 0u;
    waiting.path = path;
    return waiting;
}

// What a path's ray has found, and the state of its random numbers after it.
void store_segment(uint index, Segment segment, uint rng) {
    Hit hit = segment.hit;
    uint t = floatBitsToUint(hit.t);
    stored_paths.at[quad_index(index, HIT_QUAD)] = uvec4(t, hit.instance, hit.triangle, uint(hit.front_face));
    store_quad(index, HIT_QUAD + 1u, vec3(hit.barycentrics, 0.0), rng);
    if (SCENE_BLEND) {
        store_quad(index, PASSED_QUAD, segment.transmittance.weight, segment.transmittance.probability);
    }
    if (HAS_PASS_THROUGH_LIGHTS) { store_quad(index, ALONG_RAY_QUAD, segment.along_ray.radiance, 0u); }
}

Segment load_segment(uint index, out uint rng) {
    Segment segment = Segment(NO_HIT, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
    uvec4 hit = stored_paths.at[quad_index(index, HIT_QUAD)];
    vec2 barycentrics = load_quad(index, HIT_QUAD + 1u, rng).xy;
    segment.hit = Hit(uintBitsToFloat(hit.x), hit.y, hit.z, barycentrics, hit.w != 0u);
    if (SCENE_BLEND) {
        segment.transmittance.weight = load_quad(index, PASSED_QUAD, segment.transmittance.probability);
    }
    uint unused;
    if (HAS_PASS_THROUGH_LIGHTS) { segment.along_ray.radiance = load_quad(index, ALONG_RAY_QUAD, unused); }
    return segment;
}

#endif
