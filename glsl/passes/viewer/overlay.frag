// The color of the viewer's panels: vertex color times texture color, both in sRGB, as Dear ImGui blends them.
#version 460

layout(set = 0) uniform sampler2D image;

layout(location = 0) in vec2 uv;
layout(location = 1) in vec4 color;
layout(location = 0) out vec4 blended;

void main() { blended = color * texture(image, uv); }
