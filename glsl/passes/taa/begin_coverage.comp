// Sets the indirect dispatch of coverage.comp: a thread for each pixel that find_edges.comp has listed.
#version 460
#include "passes/taa/bindings.glsl"

layout(local_size_x = 1) in;

void main() {
    taa_edges.listed = taa_edges.found;
    taa_edges.found = 0u;
    taa_edges.dispatch = make_indirect_squares(taa_edges.listed, 1u);
}
