// The memory of a batch's views, by address: solari_vk/batch/view_buffer.py.
#ifndef SCENE_TENSORS_VIEW_RECORDS_GLSL
#define SCENE_TENSORS_VIEW_RECORDS_GLSL

#include "scene/camera_records.glsl"
#include "scene/tensors/numbers.glsl"

// What changes seldom: cameras without matrices and jitter, and frames without index, has_history and sample_jitter.
struct ViewInput {
    Camera camera;
    FrameValues frame;
    uint world;
    uint first_instance;
};

layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Views { View at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer ViewInputs { ViewInput at[]; };

layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer FrameOfViews {
    uint shared_values[3];  // the first ones of ViewsBlock in glsl/scene/camera_block.glsl
    uint index;
    Floats matrices;  // rows with a number for each view: world_from_view, then view_from_world
    float rows[];  // the host's matrices, jitter, sample_jitter, and 1 for views without history
};

layout(push_constant, scalar) uniform Work {
    Words block;  // ViewsBlock
    Views views;  // its records
    ViewInputs inputs;
    FrameOfViews frame;
    uint count;
} work;

#endif
