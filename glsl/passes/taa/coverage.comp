// The pixels that find_edges.comp has listed: the mean light of what several camera rays through the pixel show, each
// of which takes its light from the nearest sample of the surface that it hits. Chajdas, McGuire and Luebke, "Subpixel
// Reconstruction Antialiasing for Deferred Shading" (2011), with rays in place of finer depths.
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
    uint thread = thread_index_in_squares(INVOCATION_INDEX), index;
    if (thread >= taa_edges.listed) { return; }
    index = taa_edges.at[thread];
    uvec2 pixel = find_place_of(index, camera.picture_size);
    ivec2 at = ivec2(pixel), center = find_center(at);
    vec3 sum = vec3(0.0);
    float count = 0.0;
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);
    vec2 shift = rand_vec2f(rng);
    uint place = rand_u(rng);
    for (uint i = 0u; i < RAYS; i++) {
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
