// Finds the solid in which each view's camera is, such as water.
#version 460
#include "passes/bindings.glsl"
#include "passes/camera_medium.glsl"
#include "scene/walk.glsl"

layout(local_size_x = 64) in;

void main() {
    uint view = INVOCATION_INDEX.x;
    if (view >= view_count()) { return; }
    choose_view(view);
    Medium found = find_medium(camera.world_from_view[3]);
    camera_media.at[view] = uvec2(found.material, found.around);
}
