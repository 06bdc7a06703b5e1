// What the G-buffer's raster keeps on the device: draws, which instances are visible, and the depth pyramid.
#ifndef PASSES_GBUFFER_BINDINGS_GLSL
#define PASSES_GBUFFER_BINDINGS_GLSL

#extension GL_EXT_scalar_block_layout : require

// How instances fared in this frame; together these are all that the scene shows.
layout(set = 1, binding = 28, scalar) buffer GBufferCountersBlock {
    uint drawn_first;       // visible in the last frame
    uint drawn_second;      // the others that the first ones don't hide
    uint frustum_culled;
    uint occlusion_culled;
} gbuffer_counters;

// Nearest triangle of each pixel: row of instances, triangle of the instance's mesh. Nothing where depth is 0.
layout(set = 1, binding = 29, rg32ui) uniform uimage2D raster_triangles;

// Vulkan's VkDrawIndirectCommand.
struct DrawCommand {
    uint vertex_count;
    uint instance_count;
    uint first_vertex;
    uint first_instance;
};

// Commands that count, of first pass and second, single-sided and double-sided.
layout(set = 1, binding = 130, scalar) buffer DrawCountsBlock { uvec2 at[2]; } draw_counts;
// One for every row of instances, so that the order never changes; instance_count 0: not drawn.
layout(set = 1, binding = 131, scalar) buffer SingleSidedDrawsBlock { DrawCommand at[]; } single_sided_draws;
layout(set = 1, binding = 132, scalar) buffer DoubleSidedDrawsBlock { DrawCommand at[]; } double_sided_draws;
// For every row the Instance.id that was visible there in the last frame.
layout(set = 1, binding = 133, scalar) buffer VisibleInstancesBlock { uint at[]; } visible_instances;
layout(set = 1, binding = 134, scalar) buffer DepthPyramidBlock { float at[]; } depth_pyramid;

#endif
