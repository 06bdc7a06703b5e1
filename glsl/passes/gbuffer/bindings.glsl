// Buffers and images of the raster G-buffer: draw commands, visible instances and the depth pyramid.
#ifndef PASSES_GBUFFER_BINDINGS_GLSL
#define PASSES_GBUFFER_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// Numbers of instances in this frame. Their sum is the number of all visible instances of the scene.
layout(set = 1, scalar) buffer GBufferCountersBlock {
    uint drawn_first;       // drawn because they were visible in the previous frame
    uint drawn_second;      // drawn because the first ones don't hide them
    uint frustum_culled;
    uint occlusion_culled;
} gbuffer_counters;

// The nearest triangle of each pixel: row of instances and triangle of its mesh. Undefined where depth is 0.
layout(set = 1, rg32ui) uniform uimage2D raster_triangles;

// Vulkan's VkDrawIndirectCommand.
struct DrawCommand {
    uint vertex_count;
    uint instance_count;
    uint first_vertex;
    uint first_instance;
};

// Draw counts of the first and the second pass: single-sided (x) and double-sided (y).
layout(set = 1, scalar) buffer DrawCountsBlock { uvec2 at[2]; } draw_counts;
// One command for each row of instances, so that the order never changes; instance_count 0 draws nothing.
layout(set = 1, scalar) buffer SingleSidedDrawsBlock { DrawCommand at[]; } single_sided_draws;
layout(set = 1, scalar) buffer DoubleSidedDrawsBlock { DrawCommand at[]; } double_sided_draws;
// For each row of instances, the Instance.id that was visible in the previous frame.
layout(set = 1, scalar) buffer VisibleInstancesBlock { uint at[]; } visible_instances;
layout(set = 1, scalar) buffer DepthPyramidBlock { float at[]; } depth_pyramid;

#endif
