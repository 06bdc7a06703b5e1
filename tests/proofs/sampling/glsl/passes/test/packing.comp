// Encodings there and back.
#version 460
#extension GL_EXT_scalar_block_layout : require
#include "common/packing.glsl"

layout(local_size_x = 64) in;

layout(set = 1, scalar) readonly buffer ColorsBlock { vec3 at[]; } colors;
layout(set = 1, scalar) readonly buffer DirectionsBlock { vec3 at[]; } directions;
layout(set = 1, scalar) readonly buffer ValuesBlock { float at[]; } values;
layout(set = 1, scalar) buffer PackedBlock { uint at[]; } packed;  // rgb9e5, log2, oct 32, oct 24, unorm
layout(set = 1, scalar) buffer UnpackedBlock { vec4 at[]; } unpacked;

const float EXPOSURE = 0.25;

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= colors.at.length()) { return; }
    packed.at[5u * i] = pack_rgb9e5(colors.at[i]);
    packed.at[5u * i + 1u] = pack_radiance_log2_rgb9e5(colors.at[i], EXPOSURE);
    packed.at[5u * i + 2u] = pack_octahedral_2x16(directions.at[i]);
    packed.at[5u * i + 3u] = pack_octahedral_24(directions.at[i]);
    packed.at[5u * i + 4u] = pack_unorm(values.at[i], 8u);
    unpacked.at[5u * i] = vec4(unpack_rgb9e5(packed.at[5u * i]), 0.0);
    unpacked.at[5u * i + 1u] = vec4(unpack_radiance_log2_rgb9e5(packed.at[5u * i + 1u], EXPOSURE), 0.0);
    unpacked.at[5u * i + 2u] = vec4(unpack_octahedral_2x16(packed.at[5u * i + 2u]), 0.0);
    unpacked.at[5u * i + 3u] = vec4(unpack_octahedral_24(packed.at[5u * i + 3u]), 0.0);
    unpacked.at[5u * i + 4u] = vec4(unpack_unorm(packed.at[5u * i + 4u], 8u), vec3(0.0));
}
