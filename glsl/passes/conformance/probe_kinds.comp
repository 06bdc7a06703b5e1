// The row of pixels that probe.frag drew, copied into a buffer.
#version 460
#extension GL_EXT_scalar_block_layout : require

layout(local_size_x = 64) in;
layout(set = 0, r32ui) uniform readonly uimage2D probe_kinds;
layout(set = 0, scalar) writeonly buffer KindsSeen { uint at[]; } kinds_seen;

void main() {
    uint x = gl_GlobalInvocationID.x;
    if (x < kinds_seen.at.length()) { kinds_seen.at[x] = imageLoad(probe_kinds, ivec2(x, 0)).x; }
}
