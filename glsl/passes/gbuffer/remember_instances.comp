// Saves the transform of every instance for the motion vectors of the next frame, and keeps the previous one for those
// at pixels' centers, which are computed on demand.
#version 460
#include "passes/bindings.glsl"
#include "scene/bindings.glsl"

layout(local_size_x = 64) in;

void main() {
    uint row = gl_GlobalInvocationID.x;
    if (row >= previous_instances.at.length()) { return; }
    Instance instance = instances.at[row];
    older_instances.at[row] = previous_instances.at[row];
    previous_instances.at[row] = PreviousInstance(
        instance.world_from_object, instance.id, instance.material, opacity_of(instance.material)
    );
}
