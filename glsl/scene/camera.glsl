// The cameras of this frame and of the previous one, their rays, and how they project points.
// solari_vk/scene/projection.py fills the two uniform blocks.
#ifndef SCENE_CAMERA_GLSL
#define SCENE_CAMERA_GLSL

#extension GL_EXT_scalar_block_layout : require

struct Camera {
    mat4x3 world_from_view;  // the camera looks along -z, y up
    mat4x3 view_from_world;
    vec2 tan_half_fov;       // horizontal, vertical
    float near;              // distance of the near plane
    uvec2 size;              // in pixels, of what is rendered
    uvec2 picture_size;      // in pixels, of the picture that is made of it
    vec2 jitter;             // offset of this frame's samples from the pixels' positions, in pixels
};

layout(set = 0, binding = 8, scalar) uniform CameraBlock { Camera camera; };
layout(set = 0, binding = 9, scalar) uniform PreviousCameraBlock { Camera previous_camera; };

struct CameraRay {
    vec3 origin;
    vec3 direction;
    float t_min;        // at the near plane
    float depth_per_t;  // depth along the view axis of a step along the ray
    float cone_spread;  // how fast a pixel's footprint widens
};

// The ray through a position of the picture in pixels; the center of the first pixel is (0.5, 0.5).
CameraRay make_camera_ray(vec2 pixel_position) {
    vec2 ndc = 2.0 * (pixel_position + camera.jitter) / vec2(camera.size) - 1.0;
    vec3 view_direction = vec3(ndc * camera.tan_half_fov * vec2(1.0, -1.0), -1.0);
    float slant = length(view_direction);
    CameraRay ray;
    ray.origin = camera.world_from_view[3];
    ray.direction = normalize(mat3(camera.world_from_view) * view_direction);
    ray.t_min = camera.near * slant;
    ray.depth_per_t = 1.0 / slant;
    // A pixel's height at distance 1 shrinks with the square of the slant towards the picture's edge. The
    // picture's pixels count, so that upscaled pictures show textures as sharply as others.
    ray.cone_spread = 2.0 * camera.tan_half_fov.y / (float(camera.picture_size.y) * slant * slant);
    return ray;
}

// The position of a world point in a camera's picture in uv, without jitter; far outside for points behind the camera.
vec2 project_to_uv(vec3 world_position, mat4x3 view_from_world, vec2 tan_half_fov) {
    vec3 view = view_from_world * vec4(world_position, 1.0);
    if (!(view.z < 0.0)) { return vec2(-1000.0); }
    return 0.5 + vec2(0.5, -0.5) * view.xy / (tan_half_fov * -view.z);
}

#endif
