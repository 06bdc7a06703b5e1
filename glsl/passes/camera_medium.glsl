// The solids in which the views' cameras are, such as water; camera_medium.comp finds them.
#ifndef PASSES_CAMERA_MEDIUM_GLSL
#define PASSES_CAMERA_MEDIUM_GLSL

#include "passes/views.glsl"
#include "scene/medium.glsl"

// Each view's Medium
layout(set = 1, scalar) buffer CameraMediaBlock { uvec2 at[]; } camera_media;

Medium camera_medium() {
    if (!SCENE_ABSORPTION) { return NO_MEDIUM; }
    return Medium(camera_media.at[view_index].x, camera_media.at[view_index].y);
}

#endif
