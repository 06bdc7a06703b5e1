// Memory that the host gives by address: numbers, such as those of a tensor, and where they go. The host puts barriers
// around the shaders: solari_vk/gpu/tensors/port.py and solari_vk/batch/view_buffer.py.
#ifndef SCENE_TENSORS_NUMBERS_GLSL
#define SCENE_TENSORS_NUMBERS_GLSL

#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_buffer_reference_uvec2 : require

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Floats { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 8) readonly buffer Doubles { double at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Made { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Words { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Wrong { uint at[]; };  // `what` and an index

uint wrong_thing(uint what, uint index) { return what << 20 | min(index, 0xFFFFFu); }

#endif
