// The cameras of this frame and of the previous one. solari_vk/bound/projection.py fills the two uniform blocks.
// Shaders with MANY_VIEWS render many pictures in one frame, each with a record of solari_vk/batch/view_buffer.py;
// passes/views.glsl finds the view of an invocation. A view shows a world: a scene, or a variant of it with transforms,
// materials and lights of its own. The records of all worlds are in the same tables; rays find the instances of one.
#ifndef SCENE_CAMERA_BLOCK_GLSL
#define SCENE_CAMERA_BLOCK_GLSL

#include "scene/camera_records.glsl"

#ifdef MANY_VIEWS

layout(set = 0, scalar) restrict readonly buffer ViewsBlock {
    uint columns;      // of the grid of all views; 1: a strip
    uint cache_partitions;  // of the world cache: a power of two, at least the number of worlds
    uint has_own_lights;  // 1: each world has a record in scene_infos; 0: all have the first one
    vec3 ball_center;  // of a ball around all cameras
    float ball_radius;
    View at[];
} views;
uint view_index = 0u;   // of the invocation's view
uint world_index = 0u;  // of the world that it shows
#define camera views.at[view_index].current
#define previous_camera views.at[view_index].previous

#else

const uint view_index = 0u;
layout(set = 0, scalar) uniform CameraBlock { Camera camera; };
layout(set = 0, scalar) uniform PreviousCameraBlock { Camera previous_camera; };

#endif

#endif
