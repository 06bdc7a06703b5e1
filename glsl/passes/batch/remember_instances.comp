// Saves the transform of every instance for the motion vectors of the next batch, in the last dispatch over a batch.
#version 460
#define MANY_VIEWS
#include "passes/bindings.glsl"
#include "passes/reference/bindings.glsl"
#include "scene/bindings.glsl"

layout(local_size_x = 64) in;

void main() {
    uint row = gl_GlobalInvocationID.x;
    bool is_last = path_sampling.first_row + path_sampling.row_count >= views.at[0].current.size.y * views.at.length();
    if (!is_last || row >= previous_instances.at.length()) { return; }
    Instance instance = instances.at[row];
    previous_instances.at[row] = PreviousInstance(
        instance.world_from_object, instance.id, instance.material, opacity_of(instance.material)
    );
}
