// Vertices of the viewer's panels, as Dear ImGui lays them out, from window coordinates to the screen.
#version 460
#extension GL_EXT_buffer_reference : require
#extension GL_EXT_scalar_block_layout : require

struct Vertex {
    vec2 position;
    vec2 uv;
    uint color;  // 8 bits each of red, green, blue, alpha, from the lowest on
};
layout(buffer_reference, scalar) readonly buffer Vertices { Vertex at[]; };

layout(push_constant, scalar) uniform Placement {
    Vertices vertices;
    vec2 scale;
} placement;

layout(location = 0) out vec2 uv;
layout(location = 1) out vec4 color;

void main() {
    Vertex vertex = placement.vertices.at[gl_VertexIndex];
    uv = vertex.uv;
    color = unpackUnorm4x8(vertex.color);
    gl_Position = vec4(vertex.position * placement.scale - 1.0, 0.0, 1.0);
}
