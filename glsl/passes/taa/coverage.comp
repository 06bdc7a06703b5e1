// What several camera rays show through each pixel that find_edges.comp has listed: the share that shows the first
// stratum, and with NEEDS_LIGHT their mean light. Each takes that of the nearest sample of the surface that it hits:
// Chajdas, McGuire and Luebke, "Subpixel Reconstruction Antialiasing for Deferred Shading" (2011), with rays in place
// of finer depths.
#version 460
#include "common/random.glsl"
#include "passes/taa/strata.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint RAYS = 8u, PASS_SALT = 0x1F83D9ABu, PACKING_SALT = 0x5BE0CD19u;
const int FAR = 3;  // in pixels
const float PLANE_DISTANCE_WEIGHT = 16.0;  // of a hit's distance from a sample's plane; that in the picture counts 1

vec3 sample_position(ivec2 pixel) {
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    float view_depth = camera.near / imageLoad(depth, texel_of(pixel)).x;
    return ray.origin + ray.direction * (view_depth / ray.depth_per_t);
}

// What a camera ray has hit, and the light of the nearest sample that shows that surface.
struct CoverageRay {
    vec2 where;     // among the samples
    vec3 position;
    uint instance;
    uint surface;   // its surface_code
    float width;    // of the ray there, in meters
    float nearest;  // distance of the sample; INFINITY without one
    vec3 light;
};

CoverageRay rays[RAYS];

vec3 normal_at(Hit hit, vec3 direction) {
    if (hit.instance == NO_INDEX) { return vec3(0.0); }
    Instance instance = instances.at[hit.instance];
    Mesh mesh = meshes.at[instance.ray_mesh];
    vec3 front = resolve_triangle(instance, mesh, hit.triangle, hit.barycentrics).geometric_world_normal;
    return dot(front, direction) > 0.0 ? -front : front;
}

void trace_rays(uvec2 pixel) {
    // The points of later frames lie between those of earlier ones.
    uint rng = seed_rng(pixel, 0u, this_frame.seed ^ PASS_SALT), first = RAYS * (this_frame.index & 0xFFu);
    vec2 shift = rand_vec2f(rng);
    rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    uint place = rand_u(rng);
    for (uint i = 0u; i < RAYS; i++) {
        // Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018).
        vec2 within = fract(shift + float(first + i) * vec2(0.7548776662, 0.5698402910));
        vec2 where = among_samples(vec2(pixel) + within);
        CameraRay ray = make_camera_ray(where + 0.5);
        uvec2 alpha_seed = uvec2(place, i);  // the samples of a place meet layers in proportion to their alpha
        Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES, alpha_seed);
        uint surface = surface_code(hit.instance, normal_at(hit, ray.direction));
        rays[i] = CoverageRay(
            where, ray.origin + ray.direction * hit.t, hit.instance, surface,
            ray.cone_width + ray.cone_spread * hit.t, INFINITY, vec3(0.0)
        );
    }
}

// For the rays without a light: looks for it among the samples up to `radius` pixels away. Each sample is loaded once.
void find_samples(ivec2 center, int radius) {
    bool is_missing[RAYS], any_missing = false;
    for (uint i = 0u; i < RAYS; i++) {
        is_missing[i] = rays[i].nearest == INFINITY;
        any_missing = any_missing || is_missing[i];
    }
    if (!any_missing) { return; }
    int side = 2 * radius + 1;
    for (int i = 0; i < side * side; i++) {
        ivec2 pixel = center + ivec2(i % side, i / side) - radius;
        if (!is_inside(pixel, camera.size)) { continue; }
        uvec2 surface = imageLoad(gbuffer_surface, texel_of(pixel)).xy;
        vec3 found = load_sample(pixel);
        if (!is_finite_color(found)) { continue; }
        vec3 position = vec3(0.0), normal = vec3(0.0);
        if (surface.y != NO_INDEX) {
            position = sample_position(pixel);
            normal = unpack_octahedral_2x16(surface.x);
        }
        for (uint j = 0u; j < RAYS; j++) {
            if (!is_missing[j] || surface.y != rays[j].instance) { continue; }
            vec2 apart = vec2(pixel) - rays[j].where;
            float distance = dot(apart, apart);
            if (surface.y != NO_INDEX) {
                float from_plane = abs(dot(rays[j].position - position, normal));
                distance += PLANE_DISTANCE_WEIGHT * from_plane / rays[j].width;
            }
            if (distance < rays[j].nearest) {
                rays[j].nearest = distance;
                rays[j].light = found;
            }
        }
    }
}

float share_of(uint surface) {
    float found = 0.0;
    for (uint i = 0u; i < RAYS; i++) { found += float(is_same_surface(rays[i].surface, surface)); }
    return found / float(RAYS);
}

// The mean light of the rays, NO_COVERAGE if no sample tells any, and a guess of the second stratum's.
vec3 mean_light(inout Strata strata) {
    vec3 sum = vec3(0.0);
    float count = 0.0, others = 0.0;
    for (uint i = 0u; i < RAYS; i++) {
        if (rays[i].nearest == INFINITY) { continue; }
        sum += rays[i].light;
        count += 1.0;
        if (is_same_surface(rays[i].surface, strata.surface)) { continue; }
        strata.rest += rays[i].light;
        others += 1.0;
    }
    if (others > 0.0) {
        strata.rest /= others;
        strata.counts.y = GUESSED;
    }
    return count > 0.0 ? sum / count : NO_COVERAGE;
}

void main() {
    uint thread = thread_index_in_squares(INVOCATION_INDEX);
    if (thread >= taa_coverage.listed) { return; }
    uint entry = taa_edges.at[thread], index = entry & ~NEEDS_LIGHT;
    bool needs_light = entry != index;
    uvec2 pixel = find_place_of(index, camera.picture_size);
    ivec2 center = find_center(ivec2(pixel));
    Strata strata = NO_STRATA;
    if (!needs_light) { strata = load_strata(index); }
    if (sample_count(strata) == 0.0) { strata.surface = surface_code(center); }

    trace_rays(pixel);
    add_share(strata, share_of(strata.surface));
    if (needs_light) {
        find_samples(center, 1);
        // Few samples show a surface behind one of high opacity, or one of low opacity.
        if (SCENE_BLEND) { find_samples(center, FAR); }
        radiance.at[index] = mean_light(strata);
    }
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PACKING_SALT);
    if (has_strata()) { store_strata(index, strata, rng); }
}
