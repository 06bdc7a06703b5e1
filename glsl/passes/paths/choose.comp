// Chooses the next rays of each path that waits, for trace.comp.
#version 460
#include "passes/paths/path_state.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

void main() {
    uvec2 pixel;
    uint index;
    if (!find_waiting_path(pixel, index)) { return; }
    Path path = unpack_path(load_path_state(index));
    path.walk.cone_spread = make_camera_ray(vec2(pixel) + 0.5).cone_spread;
    arrive(path, true);
    choose_rays(path);
    store_path_rays(path, index);
    store_path_state(path, index);
}
