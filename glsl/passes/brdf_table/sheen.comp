// Computes the directional albedo of white sheen by quadrature over the hemisphere.
#version 460
#include "scene/brdf_table.glsl"
#include "scene/lobes/sheen.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint COSINES = 48u, TURNS = 16u;

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy;
    if (any(greaterThanEqual(cell, uvec2(BRDF_TABLE_SIZE)))) { return; }
    vec2 position = vec2(cell) / float(BRDF_TABLE_SIZE - 1u);
    float cosine = max(square(position.x), 1e-4);
    float alpha = sheen_alpha(position.y);
    vec3 wo = vec3(safe_sqrt(1.0 - cosine * cosine), 0.0, cosine);
    float albedo = 0.0;
    for (uint i = 0u; i < COSINES * TURNS; i++) {
        // Half the turns, as the others mirror them. Points are denser near the horizon and where wi is opposite wo,
        // where smooth sheen shines.
        vec2 u = (vec2(i / TURNS, i % TURNS) + 0.5) / vec2(COSINES, TURNS);
        float turn = PI * (1.0 - square(u.y)), height = square(u.x);
        vec3 wi = vec3(safe_sqrt(1.0 - height * height) * vec2(cos(turn), sin(turn)), height);
        albedo += evaluate_sheen(alpha, wo, wi) * (2.0 * u.x) * (2.0 * PI * u.y) * 2.0;
    }
    imageStore(sheen_table, ivec2(cell), vec4(albedo / float(COSINES * TURNS)));
}
