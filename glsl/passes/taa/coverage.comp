// Pixels at edges in a first frame, or where the picture jumps, and such as show blended surfaces in motion: the mean
// light of what several camera rays through the pixel show, each of which takes its light from the nearest sample of
// the surface that it hits. Chajdas, McGuire and Luebke, "Subpixel Reconstruction Antialiasing for Deferred Shading"
// (2011), with rays in place of finer depths.
#version 460
#include "common/random.glsl"
#include "passes/taa/history.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint RAYS = 8u, PASS_SALT = 0x1F83D9ABu;
const int FAR = 3;  // in pixels
const float PLANE_DISTANCE_WEIGHT = 16.0;  // of a hit's distance from a sample's plane; that in the picture counts 1

vec3 sample_position(ivec2 pixel) {
    CameraRay ray = make_camera_ray(vec2(pixel) + 0.5);
    float view_depth = camera.near / imageLoad(depth, texel_of(pixel)).x;
    return ray.origin + ray.direction * (view_depth / ray.depth_per_t);
}

bool is_at_edge(ivec2 center) {
    uint instance = imageLoad(gbuffer_surface, texel_of(center)).y;
    for (int i = 0; i < 9; i++) {
        ivec2 other = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(other, camera.size)) { continue; }
        if (imageLoad(gbuffer_surface, texel_of(other)).y != instance || !show_the_same(center, other)) { return true; }
    }
    return false;
}

// Finds the light of the sample whose surface is the one that a camera ray has hit. where: the ray's position among the
// samples. Returns false if none of the samples up to `radius` pixels away shows that surface.
bool find_sample(ivec2 center, int radius, vec2 where, CameraRay ray, Hit hit, out vec3 light) {
    float nearest = INFINITY;
    int side = 2 * radius + 1;
    vec3 position = ray.origin + ray.direction * hit.t;
    for (int i = 0; i < side * side; i++) {
        ivec2 pixel = center + ivec2(i % side, i / side) - radius;
        if (!is_inside(pixel, camera.size)) { continue; }
        uvec2 surface = imageLoad(gbuffer_surface, texel_of(pixel)).xy;
        vec3 found = load_sample(pixel);
        if (surface.y != hit.instance || !is_finite_color(found)) { continue; }
        vec2 apart = vec2(pixel) - where;
        float distance = dot(apart, apart);
        if (hit.instance != NO_INDEX) {
            float from_plane = abs(dot(position - sample_position(pixel), unpack_octahedral_2x16(surface.x)));
            distance += PLANE_DISTANCE_WEIGHT * from_plane / (ray.cone_width + ray.cone_spread * hit.t);
        }
        if (distance < nearest) {
            nearest = distance;
            light = found;
        }
    }
    return nearest < INFINITY;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    uint index;
    if (taa_settings.antialiasing == 0u || !find_element(pixel, camera.picture_size, index)) { return; }
    ivec2 at = ivec2(pixel), center = find_center(at);
    if (!needs_coverage(center)) { return; }
    vec3 sum = vec3(0.0);
    float count = 0.0;
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    vec2 shift = rand_vec2f(rng);
    uint place = rand_u(rng);
    // Rays can't tell what raster shows of instances that are other meshes to rays.
    uint rays = !SCENE_PROXIES && (blends_in_motion(center) || is_at_edge(center)) ? RAYS : 0u;
    for (uint i = 0u; i < rays; i++) {
        // Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018).
        vec2 within = fract(shift + float(i) * vec2(0.7548776662, 0.5698402910));
        vec2 where = among_samples(vec2(at) + within);
        CameraRay ray = make_camera_ray(where + 0.5);
        uvec2 alpha_seed = uvec2(place, i);  // the samples of a place meet layers in proportion to their alpha
        Hit hit = trace_closest_hit(ray.origin, ray.t_min, ray.direction, INFINITY, TRACE_FRONT_FACES, alpha_seed);
        vec3 light;
        // Few samples show a surface behind one of high opacity, or one of low opacity.
        bool found = find_sample(center, 1, where, ray, hit, light);
        if (SCENE_BLEND && !found) { found = find_sample(center, FAR, where, ray, hit, light); }
        if (found) {
            sum += light;
            count += 1.0;
        }
    }
    radiance.at[index] = count > 0.0 ? sum / count : NO_COVERAGE;
}
