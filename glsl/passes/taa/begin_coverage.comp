// Sets the indirect dispatch of coverage.comp: a thread for each pixel that find_edges.comp has listed.
#version 460
#include "passes/taa/bindings.glsl"

layout(local_size_x = 1) in;

void main() {
    taa_coverage.listed = taa_coverage.found;
    taa_coverage.found = 0u;
    taa_coverage.dispatch = make_indirect_squares(taa_coverage.listed, 1u);
}
