// Each thread inserts a cell and offers its surface point to the cell.
#version 460
#include "passes/world_cache/map.glsl"

struct Query {
    vec3 position;
    vec3 normal;
    float cell_size;
    uint rng;  // 0: no query
    uint life;
};
struct Answer {
    uint cell;
    uint first;
    uint checksum;
    vec3 position;  // of the point that represented the cell in the previous frame
    vec3 normal;
    float offset;
};
layout(set = 1, scalar) readonly buffer QueriesBlock { Query at[]; } queries;
layout(set = 1, scalar) buffer AnswersBlock { Answer at[]; } answers;

layout(local_size_x = 64) in;

void main() {
    uint index = gl_GlobalInvocationID.x;
    if (index >= queries.at.length()) { return; }
    Query query = queries.at[index];
    if (query.rng == 0u) { return; }
    WorldCacheKey key = make_world_cache_key(query.position, query.normal, query.cell_size);
    bool is_new;
    uint cell = insert_world_cache_cell(key, is_new);
    Answer answer = Answer(cell, key.first, key.checksum, vec3(0.0), vec3(0.0), 0.0);
    if (cell != NO_INDEX) {
        WorldCacheSurface surface = load_world_cache_surface(cell);
        answer.position = surface.world_position;
        answer.normal = surface.geometric_world_normal;
        answer.offset = surface.ray_offset;
        atomicMax(world_cache_life.at[cell], query.life);
        vote_for_point(cell, key.bounds, query.position, query.normal, query.rng);
    }
    answers.at[index] = answer;
}
