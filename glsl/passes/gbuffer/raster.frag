// Writes the nearest triangle of each pixel: Burns and Hunt, "The Visibility Buffer: A Cache-Friendly Approach to
// Deferred Shading" (JCGT 2013). A fragment that is hidden later costs no more than this.
// Differs from Solari, whose fragments write the G-buffer.
#version 460

layout(location = 0) flat in uint row;
layout(location = 1) flat in uint triangle;
layout(location = 0) out uvec2 out_triangle;
layout(location = 1) out float out_depth;

void main() {
    out_triangle = uvec2(row, triangle);
    out_depth = gl_FragCoord.z;
}
