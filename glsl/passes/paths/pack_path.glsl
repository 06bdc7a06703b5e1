// Paths that wait, packed for the passes that go on.
#ifndef PASSES_PATHS_PACK_PATH_GLSL
#define PASSES_PATHS_PACK_PATH_GLSL

#include "common/packing.glsl"
#include "passes/paths/path.glsl"

// Flags: bounce | delta_bounces << 8 | wavelength << 16 | IS_DIFFUSE | SPECULAR_ONLY.
const uint SPECULAR_ONLY = 0x80000000u;
const uint IS_DIFFUSE = 0x40000000u;  // while bounce is 1 first_ray_is_diffuse, later diffuse_at_x2
const uint NO_PATH_STATE = 0u;        // flags where no path waits
const float MAX_WAVELENGTH = 1024.0;  // in nanometers

PathState pack_path(Path path) {
    bool is_diffuse = path.bounce == 1u ? path.first_ray_is_diffuse : path.diffuse_at_x2;
    uint flags = path.bounce | path.delta_bounces << 8u | (path.specular_only ? SPECULAR_ONLY : 0u)
        | (is_diffuse ? IS_DIFFUSE : 0u);
    if (SCENE_DISPERSION) { flags |= pack_unorm(path.walk.wavelength / MAX_WAVELENGTH, 14u) << 16u; }
    PerLobe weight = apply_first_weight(path, vec3(1.0));
    Medium medium = path.walk.medium;
    PathState state;
    state.quads[0] = quad(path.walk.direction, flags);
    state.quads[1] = quad(path.walk.throughput, path.rng);
    state.quads[2] = quad(weight.diffuse, path.sum_of_inverse_pdfs);
    state.quads[3] = quad(weight.specular, path.footprint);
    state.quads[4] = uvec4(path.hit.instance, path.hit.triangle, floatBitsToUint(path.hit.barycentrics));
    state.quads[5] = uvec4(floatBitsToUint(path.walk.cone_width), medium.material, medium.around, 0u);
    return state;
}

// A path as it was packed, but with no light, since what it had found is already in the pixel, and without its vertex:
// `arrive` with `resumed` makes that again from the hit.
Path unpack_path(PathState state) {
    Path path = start_path(state.quads[1].w);
    uint flags = state.quads[0].w;
    path.bounce = flags & 0xFFu;
    path.delta_bounces = flags >> 8u & 0xFFu;
    path.first_ray_is_diffuse = (flags & IS_DIFFUSE) != 0u;
    path.diffuse_at_x2 = path.bounce > 1u && path.first_ray_is_diffuse;
    path.specular_only = (flags & SPECULAR_ONLY) != 0u;
    if (SCENE_DISPERSION) { path.walk.wavelength = unpack_unorm(flags >> 16u, 14u) * MAX_WAVELENGTH; }
    path.walk.direction = values_of(state.quads[0]);
    path.walk.throughput = values_of(state.quads[1]);
    path.first_weight = PerLobe(values_of(state.quads[2]), values_of(state.quads[3]));
    path.sum_of_inverse_pdfs = last_of(state.quads[2]);
    path.footprint = last_of(state.quads[3]);
    path.walk.delta_path_from_camera = path.bounce == path.delta_bounces;
    // t has been used already, and resolve_surface_interaction finds the side of the surface again.
    uvec4 hit = state.quads[4];
    path.hit = Hit(0.0, hit.x, hit.y, uintBitsToFloat(hit.zw), false);
    path.walk.cone_width = uintBitsToFloat(state.quads[5].x);
    if (SCENE_ABSORPTION) { path.walk.medium = Medium(state.quads[5].y, state.quads[5].z); }
    return path;
}

// ---- rays for a pass that only traces -----------------------------------------------------------------

PathRays pack_rays(Path path) {
    ShadowRay shadow_ray = path.shadow_ray;
    LightSample light = path.light_sample;
    PathRays rays;
    rays.quads[0] = quad(path.walk.origin, uint(path.has_ray));  // 0: only the shadow ray is traced, and the path ends
    rays.quads[1] = quad(path.receiver.position, path.walk.mis_pdf);
    rays.quads[2] = quad(path.receiver.normal, path.walk.wavelength);
    rays.quads[3] = quad(shadow_ray.origin, shadow_ray.t_max);
    rays.quads[4] = quad(shadow_ray.direction, light.light_index);
    rays.quads[5] = quad(shadow_ray.contribution.diffuse, light.part);
    rays.quads[6] = quad(shadow_ray.contribution.specular, light.seed);
    return rays;
}

// A path that waits for its rays to be traced.
Path unpack_path(PathState state, PathRays rays) {
    Path path = unpack_path(state);
    path.has_ray = rays.quads[0].w != 0u;
    path.walk.origin = values_of(rays.quads[0]);
    path.walk.mis_pdf = last_of(rays.quads[1]);
    if (SCENE_DISPERSION) { path.walk.wavelength = last_of(rays.quads[2]); }
    path.receiver = Receiver(values_of(rays.quads[1]), values_of(rays.quads[2]));
    PerLobe contribution = PerLobe(values_of(rays.quads[5]), values_of(rays.quads[6]));
    path.shadow_ray =
        ShadowRay(values_of(rays.quads[3]), values_of(rays.quads[4]), last_of(rays.quads[3]), contribution);
    path.light_sample = LightSample(rays.quads[4].w, rays.quads[5].w, rays.quads[6].w);
    return path;
}

// rng: the random numbers after the rays.
PathHit pack_hit(TracedRays traced, uint rng) {
    Hit hit = traced.segment.hit;
    RayTransmittance passed = traced.segment.transmittance;
    LightAlongRay along_ray = traced.segment.along_ray;
    PathHit found;
    found.quads[0] = quad(traced.visibility, rng);
    found.quads[1] = uvec4(hit.instance, hit.triangle, floatBitsToUint(hit.barycentrics));
    found.quads[2] = quad(passed.weight, passed.probability);
    found.quads[3] = quad(along_ray.radiance, hit.t);
    found.quads[4] = quad(along_ray.radiance_over_probability, 0u);
    return found;
}

TracedRays unpack_hit(PathHit found, out uint rng) {
    rng = found.quads[0].w;
    // resolve_surface_interaction finds the side of the surface again
    uvec4 at = found.quads[1];
    Hit hit = Hit(last_of(found.quads[3]), at.x, at.y, uintBitsToFloat(at.zw), false);
    Segment segment = Segment(hit, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 0u);
    if (SCENE_BLEND) { segment.transmittance = RayTransmittance(values_of(found.quads[2]), last_of(found.quads[2])); }
    if (HAS_PASS_THROUGH_LIGHTS) {
        segment.along_ray = LightAlongRay(values_of(found.quads[3]), values_of(found.quads[4]));
    }
    return TracedRays(values_of(found.quads[0]), segment);
}

#endif
