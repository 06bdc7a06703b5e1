// Averages the directional albedo over the hemisphere, weighted by the cosine, for the diffuse lobe below the specular
// one: Kulla and Conty, "Revisiting Physically Based Shading at Imageworks" (2017). Integrates the interpolated table,
// so that table and averages agree exactly.
#version 460
#include "scene/brdf_table.glsl"

layout(local_size_x = 8) in;

const uint POINTS_PER_CELL = 8u;

void main() {
    uint row = gl_GlobalInvocationID.x;
    if (row >= BRDF_TABLE_SIZE) { return; }
    uint point_count = POINTS_PER_CELL * (BRDF_TABLE_SIZE - 1u);
    vec3 average = vec3(0.0);
    for (uint i = 0u; i < point_count; i++) {
        float root = (float(i) + 0.5) / float(point_count);
        vec2 ab = lookup_brdf_table(root * root, float(row) / float(BRDF_TABLE_SIZE - 1u));
        float k = 1.0 / (ab.x + ab.y) - 1.0;
        // mu = root^2, so 2 mu dmu = 4 root^3 droot
        average += 4.0 * root * root * root * vec3(ab.y, ab.x + ab.y * k, ab.x * k);
    }
    brdf_averages.at[row] = average / float(point_count);
}
