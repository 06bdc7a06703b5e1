// Rays of cameras, and how they project points.
#ifndef SCENE_CAMERA_GLSL
#define SCENE_CAMERA_GLSL

#include "common/random.glsl"
#include "generated/bound/features.glsl"  // SCENE_LENSES, written by solari_vk/bound/features.py
#include "scene/camera_block.glsl"
#include "scene/lens.glsl"

bool is_orthographic(Camera from) { return from.orthographic_range > 0.0; }

// Whether the projection isn't a pinhole's: distorted, fisheye or panoramic. Depth of field is lens_radius > 0.
bool has_lens(Camera from) { return SCENE_LENSES && from.lens.kind != PINHOLE; }

// Whether depth is measured along the ray, since the camera may see more than half of what is around it.
bool is_wide(Camera from) { return SCENE_LENSES && from.lens.kind >= FISHEYE; }

const vec3 Y_UP = vec3(1.0, -1.0, -1.0);  // from the axes of lens.glsl to those of view space, and back

// Where a point of the aperture is for a direction, from the middle of the lens, in the axes of lens.glsl. offset: with
// y up. A wide lens shows its aperture to every direction, as if it turned from the view axis by the shortest way.
vec3 on_aperture(vec3 along, vec2 offset, Camera from) {
    vec3 beside = vec3(offset.x, -offset.y, 0.0);
    if (!is_wide(from)) { return beside; }
    // 1 / (1 + z), also near z = -1
    float share = along.z < 0.0 ? (1.0 - along.z) / max(dot(along.xy, along.xy), 1e-30) : 1.0 / (1.0 + along.z);
    float across = dot(along.xy, beside.xy);
    return vec3(beside.xy - share * across * along.xy, -across);
}

// The camera ray through a position in the picture, in view space. `direction` isn't normalized: the point at a depth
// is origin + depth * direction.
struct ViewRay {
    vec3 origin;
    vec3 direction;
};

// position: in pixels, with jitter; the center of the first pixel is (0.5, 0.5). Through a point of the lens beside its
// middle the ray leads to the same point in focus: Haeberli and Akeley, "The Accumulation Buffer" (1990).
ViewRay view_ray(vec2 position, Camera from) {
    vec2 ndc = 2.0 * position / vec2(camera.size) - 1.0;
    if (has_lens(from)) {
        vec2 at = ndc * from.tan_half_fov;
        vec3 along = lens_direction(at, from.lens), beside = on_aperture(along, from.lens_offset, from);
        return ViewRay((lens_start(at, from.lens) + beside) * Y_UP, (along - beside / from.focus_distance) * Y_UP);
    }
    vec2 lateral = ndc * from.tan_half_fov * vec2(1.0, -1.0);
    bool orthographic = is_orthographic(from);
    return ViewRay(
        vec3((orthographic ? lateral : vec2(0.0)) + from.lens_offset, 0.0),
        vec3((orthographic ? vec2(0.0) : lateral) - from.lens_offset / from.focus_distance, -1.0)
    );
}

struct CameraRay {
    vec3 origin;
    vec3 direction;
    float t_min;        // at the near plane
    float depth_per_t;  // depth along the view axis of a step along the ray
    float cone_width;   // of a pixel's footprint at the origin
    float cone_spread;  // how fast the footprint widens
};

// Whether a lens sees anything at a position of the picture in pixels, without jitter: the corners of a circular
// fisheye's picture are black.
bool is_seen(vec2 pixel_position) {
    vec2 ndc = 2.0 * (pixel_position + camera.jitter) / vec2(camera.size) - 1.0;
    return !is_wide(camera) || length(ndc * camera.tan_half_fov) <= camera.lens.reach;
}

// The ray through a position of the picture in pixels, without jitter.
CameraRay make_camera_ray(vec2 pixel_position) {
    ViewRay in_view = view_ray(pixel_position + camera.jitter, camera);
    mat3 axes = mat3(camera.world_from_view);
    float slant = length(in_view.direction);
    CameraRay ray;
    ray.origin = camera.world_from_view[3] + axes * in_view.origin;
    ray.direction = normalize(axes * in_view.direction);
    ray.t_min = camera.near * slant;
    ray.depth_per_t = 1.0 / slant;
    // A pixel's height at distance 1 shrinks with the square of the slant towards the picture's edge. The
    // picture's pixels count, so that upscaled pictures show textures as sharply as others.
    float height = 2.0 * camera.tan_half_fov.y / (float(camera.picture_size.y) * slant * slant);
    bool orthographic = is_orthographic(camera);
    ray.cone_width = orthographic ? height : 0.0;
    ray.cone_spread = orthographic ? 0.0 : height;
    if (has_lens(camera)) {
        vec2 below = vec2(0.0, float(camera.size.y) / float(camera.picture_size.y));
        vec3 along = view_ray(pixel_position + camera.jitter + below, camera).direction;
        ray.cone_spread = length(normalize(along) - in_view.direction / slant);
    }
    return ray;
}

// A point of the aperture, which lies in the unit disk: a disk, or a regular polygon. u in [0, 1).
vec2 sample_aperture(vec2 u) {
    uint blades = camera.aperture_blades;
    if (blades == 0u) { return sample_disk(u); }
    float blade = floor(u.x * float(blades));
    vec2 weights = sample_triangle_barycentrics(vec2(u.x * float(blades) - blade, u.y));
    vec2 angles = 2.0 * PI / float(blades) * (blade + vec2(0.0, 1.0)) + camera.aperture_rotation;
    return weights.x * vec2(cos(angles.x), sin(angles.x)) + weights.y * vec2(cos(angles.y), sin(angles.y));
}

// A camera ray through another point of the lens, as a thin lens refracts it. on_lens: in the unit disk. A wide lens is
// sharp at one distance from it. Cook, Porter and Carpenter, "Distributed Ray Tracing" (1984).
CameraRay through_lens(CameraRay ray, vec2 on_lens) {
    vec3 in_focus = ray.origin + ray.direction * (camera.focus_distance / ray.depth_per_t);
    mat3 axes = mat3(camera.world_from_view);
    ray.origin += axes * (on_aperture(ray.direction * axes * Y_UP, camera.lens_radius * on_lens, camera) * Y_UP);
    vec3 along = in_focus - ray.origin;
    float distance = length(along);
    ray.direction = along / distance;
    ray.depth_per_t = camera.focus_distance / distance;
    ray.t_min = camera.near / ray.depth_per_t;
    return ray;
}

// Whether the camera is where it was in the previous frame, and sees as much.
bool is_camera_static() {
    return previous_camera.world_from_view == camera.world_from_view
        && previous_camera.tan_half_fov == camera.tan_half_fov
        && previous_camera.principal_shift == camera.principal_shift
        && previous_camera.lens_offset == camera.lens_offset && previous_camera.focus_distance == camera.focus_distance
        && previous_camera.orthographic_range == camera.orthographic_range && previous_camera.lens == camera.lens;
}

const int LENS_STEPS = 6;

// The position in the picture of a camera with a wide lens of a point in the axes of lens.glsl, which is seen through a
// point beside the lens's middle: the middle sees another point there, which is found step by step.
bool find_wide_position(vec3 point, Camera from, out vec2 at) {
    bool seen = find_lens_position(point, from.lens, at);
    for (int i = 0; i < LENS_STEPS && seen && from.lens_offset != vec2(0.0); i++) {
        vec3 along = lens_direction(at, from.lens), beside = on_aperture(along, from.lens_offset, from);
        float depth = dot(point - lens_start(at, from.lens), along);
        seen = find_lens_position(point - (1.0 - depth / from.focus_distance) * beside, from.lens, at);
    }
    return seen;
}

// The position of a point in view space in a camera's picture in uv, without the jitter of samples; far outside for
// points behind the camera.
vec2 project_view_to_uv(vec3 point, Camera from) {
    precise vec3 view = point;
    if (!is_wide(from)) { view.xy -= from.lens_offset * (1.0 + view.z / from.focus_distance); }
    vec2 shift = from.principal_shift / vec2(from.size);
    if (has_lens(from)) {
        vec2 at;
        bool seen = is_wide(from) ? find_wide_position(view * Y_UP, from, at)
            : find_lens_position(view * Y_UP, from.lens, at);
        return seen ? 0.5 + 0.5 * at / from.tan_half_fov - shift : vec2(-1000.0);
    }
    if (!(view.z < 0.0)) { return vec2(-1000.0); }
    precise vec2 uv = 0.5 + vec2(0.5, -0.5) * view.xy / (from.tan_half_fov * (is_orthographic(from) ? 1.0 : -view.z));
    return uv - shift;
}

// The same of a point in the world.
vec2 project_to_uv(vec3 world_position, Camera from) {
    precise vec3 view = from.view_from_world * vec4(world_position, 1.0);
    return project_view_to_uv(view, from);
}

// Motion in uv, around a panorama the shorter way.
vec2 shorter_way(vec2 motion) {
    if (SCENE_LENSES && camera.lens.kind == EQUIRECTANGULAR) { motion.x -= round(motion.x); }
    return motion;
}

// Where the middle of the lens shows the point at a depth that is seen at a position of the picture, both in uv.
vec2 uv_from_lens_middle(vec2 uv, float depth, Camera from) {
    ViewRay ray = view_ray(uv * vec2(from.size) + from.principal_shift, from);
    Camera middle = from;
    middle.lens_offset = vec2(0.0);
    return project_view_to_uv(ray.origin + depth * ray.direction, middle);
}

#endif
