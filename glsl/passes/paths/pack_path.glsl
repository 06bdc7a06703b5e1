// Paths that wait, packed for the passes that go on.
#ifndef PASSES_PATHS_PACK_PATH_GLSL
#define PASSES_PATHS_PACK_PATH_GLSL

#include "common/packing.glsl"
#include "passes/paths/path.glsl"

const uint SPECULAR_ONLY = 0x80000000u;
const uint IS_DIFFUSE = 0x40000000u;  // while bounce is 1 first_ray_is_diffuse, later diffuse_at_x2
const uint NO_PATH_STATE = 0u;        // flags where no path waits
const float MAX_WAVELENGTH = 1024.0;  // in nanometers

PathState pack_path(Path path) {
    bool is_diffuse = path.bounce == 1u ? path.first_ray_is_diffuse : path.diffuse_at_x2;
    uint flags = path.bounce | path.delta_bounces << 8u | (path.specular_only ? SPECULAR_ONLY : 0u)
        | (is_diffuse ? IS_DIFFUSE : 0u);
    if (SCENE_DISPERSION) { flags |= pack_unorm(path.walk.wavelength / MAX_WAVELENGTH, 14u) << 16u; }
    return PathState(
        path.rng, flags, apply_first_weight(path, vec3(1.0)), path.walk.throughput, path.walk.direction,
        path.hit.instance, path.hit.triangle, path.hit.barycentrics, path.sum_of_inverse_pdfs, path.footprint,
        path.walk.cone_width, path.walk.medium
    );
}

// A path as it was packed, but with no light, since what it had found is already in the pixel, and without its vertex:
// `arrive` with `resumed` makes that again from the hit.
Path unpack_path(PathState state) {
    Path path = start_path(state.rng);
    path.bounce = state.flags & 0xFFu;
    path.delta_bounces = state.flags >> 8u & 0xFFu;
    path.first_ray_is_diffuse = (state.flags & IS_DIFFUSE) != 0u;
    path.diffuse_at_x2 = path.bounce > 1u && path.first_ray_is_diffuse;
    path.specular_only = (state.flags & SPECULAR_ONLY) != 0u;
    if (SCENE_DISPERSION) { path.walk.wavelength = unpack_unorm(state.flags >> 16u, 14u) * MAX_WAVELENGTH; }
    path.first_weight = state.attenuated_first_weight;
    path.walk.throughput = state.throughput;
    path.walk.direction = state.direction;
    path.walk.delta_path_from_camera = path.bounce == path.delta_bounces;
    // t has been used already, and resolve_surface_interaction finds the side of the surface again.
    path.hit = Hit(0.0, state.instance, state.triangle, state.barycentrics, false);
    path.sum_of_inverse_pdfs = state.sum_of_inverse_pdfs;
    path.footprint = state.footprint;
    path.walk.cone_width = state.cone_width;
    if (SCENE_ABSORPTION) { path.walk.medium = state.medium; }
    return path;
}

// ---- rays for a pass that only traces -----------------------------------------------------------------

PathRays pack_rays(Path path) {
    LightSample light = path.light_sample;
    return PathRays(
        uint(path.has_ray), path.walk.origin, path.walk.mis_pdf, path.walk.wavelength, path.receiver.position,
        path.receiver.normal, path.shadow_ray, uvec3(light.light_index, light.part, light.seed)
    );
}

// A path that waits for its rays to be traced.
Path unpack_path(PathState state, PathRays rays) {
    Path path = unpack_path(state);
    path.has_ray = rays.has_ray != 0u;
    path.walk.origin = rays.origin;
    path.walk.mis_pdf = rays.mis_pdf;
    if (SCENE_DISPERSION) { path.walk.wavelength = rays.wavelength; }
    path.receiver = Receiver(rays.receiver_position, rays.receiver_normal);
    path.shadow_ray = rays.shadow_ray;
    path.light_sample = LightSample(rays.light_sample.x, rays.light_sample.y, rays.light_sample.z);
    return path;
}

PathHit pack_hit(TracedRays traced) {
    Hit hit = traced.segment.hit;
    RayTransmittance passed = traced.segment.transmittance;
    LightAlongRay along_ray = traced.segment.along_ray;
    return PathHit(
        traced.visibility, hit.t, hit.instance, hit.triangle, hit.barycentrics,
        vec4(passed.weight, passed.probability), along_ray.radiance, along_ray.radiance_over_probability
    );
}

TracedRays unpack_hit(PathHit found) {
    // resolve_surface_interaction finds the side of the surface again
    Hit hit = Hit(found.t, found.instance, found.triangle, found.barycentrics, false);
    Segment segment = Segment(hit, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
    if (SCENE_BLEND) { segment.transmittance = RayTransmittance(found.transmittance.xyz, found.transmittance.w); }
    if (HAS_PASS_THROUGH_LIGHTS) {
        segment.along_ray = LightAlongRay(found.light_along_ray, found.light_along_ray_over_probability);
    }
    return TracedRays(found.visibility, segment);
}

#endif
