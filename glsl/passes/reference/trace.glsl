// The loop of the path tracer: updates each pixel's mean with more samples. A shader that includes this file says where
// paths start.
#ifndef PASSES_REFERENCE_TRACE_GLSL
#define PASSES_REFERENCE_TRACE_GLSL

#define LIGHT_STRATA SCENE_LIGHT_STRATA
#include "passes/reference/bindings.glsl"
#include "passes/views.glsl"
#include "scene/walk.glsl"

struct Path {
    Walk walk;
    Receiver receiver;  // of the light samples that compete in MIS with the walk's direction
    uint bounce;        // the number of surfaces that the walk has left
    vec3 radiance;
    uint rays;          // of all samples of the pixel so far
};

// A surface from which a walk goes on.
struct Vertex {
    SurfaceInteraction surface;
    Brdf brdf;
    mat3 frame;    // with the shading normal as its z axis
    vec3 wo;       // in the frame
    Medium below;  // on the other side
};

// Starts a path of a pixel: either sets its walk, to trace the first ray, and returns false, or also sets a vertex from
// which the walk goes on, and returns true.
bool start_path(uvec2 pixel, inout Path path, inout Vertex vertex, inout uint rng);

// Where the paths of a pixel start, without jitter.
vec3 start_position(uvec2 pixel);

// The samples that a pixel takes in this dispatch: from index x to y - 1.
uvec2 sample_range(uvec2 pixel);

// Walk.mis_pdf for the setting light_strategy: INFINITY gives light samples no weight, 0 gives them all the weight.
float mis_pdf(float pdf) {
    if (path_sampling.light_strategy == LIGHT_STRATEGY_BRDF || pdf == INFINITY) { return INFINITY; }
    return path_sampling.light_strategy == LIGHT_STRATEGY_NEE ? 0.0 : pdf;
}

// Traces the walk to its next surface. Returns whether it goes on from there.
bool reach_vertex(inout Path path, inout Vertex vertex, inout uint rng) {
    Segment segment = trace_segment(path.walk, path.receiver, rng);
    path.rays += segment.rays;
    if (!accumulate_segment(path.walk, segment, path.receiver, path.radiance)) { return false; }
    SurfaceInteraction surface = arrive_at_surface(path.walk, segment.hit);
    if (path.bounce == 0u) {
        path.radiance += path.walk.throughput * shown_emission(surface);
    } else {
        remove_straight_transmission(segment.hit, path.walk.direction, surface.material, path.walk.throughput);
        float light_pdf = hit_light_pdf(path.receiver, segment.hit, surface, path.walk.direction);
        path.radiance += emitted_light(path.walk, surface, light_pdf);
    }
    if (path.bounce == path_sampling.max_bounces) { return false; }
    vertex.surface = surface;
    vertex.frame = orthonormalize(surface.world_normal);
    vertex.wo = -path.walk.direction * vertex.frame;
    disperse(path.walk, segment.hit.instance, surface.material, rng);
    vertex.brdf = prepare_brdf(surface.material, vertex.wo);
    vertex.below = medium_below(segment.hit.instance, surface.material, path.walk.medium);
    return true;
}

// Russian roulette's survival probability is this times the throughput. Inverse efficiency, error times render time, is
// higher with 1, by 36 % in mirror_hall, 22 % in cornell_box and 2 % in shiny_floor, and with 4, by 8, 4 and 5 %.
const float SURVIVAL_PER_THROUGHPUT = 3.0;

// Adds a light sample at a surface, and samples the direction in which the walk leaves it. Returns whether it goes on.
bool leave_vertex(inout Path path, Vertex vertex, inout uint rng) {
    SurfaceInteraction surface = vertex.surface;
    path.receiver = Receiver(surface.world_position, surface.world_normal);
    uint light_rng = split_rng(rng);  // light samples take any count of random numbers; later dimensions stay the same
    NextEvent event;
    event.radiance = vec3(0.0);
    if (path_sampling.light_strategy != LIGHT_STRATEGY_BRDF && !is_delta(vertex.brdf)) {
        bool mis = path_sampling.light_strategy == LIGHT_STRATEGY_MIS;
        event = sample_light(
            path.walk, surface, vertex.brdf, vertex.frame, vertex.wo, vertex.below, path.receiver, mis, light_rng
        );
    }
    BrdfSample next = sample_brdf(vertex.brdf, vertex.wo, rng);
    bool valid = scatter(path.walk, next, vertex.frame, surface.geometric_world_normal, surface.lift, vertex.below);
    path.walk.mis_pdf = mis_pdf(path.walk.mis_pdf);
    path.walk.origin = ray_origin(surface, path.walk.direction);
    path.bounce += 1u;
    float survival_probability = SURVIVAL_PER_THROUGHPUT * max_component(path.walk.throughput);
    bool goes_on = valid && survives(path.walk, survival_probability, path.bounce, rng);

    // last, when the surface isn't needed any more
    if (max_component(event.radiance) > 0.0) {
        path.rays += 1u;
        path.radiance += event.radiance * trace_shadow_ray(event.origin, event.medium, event.light_sample);
    }
    return goes_on;
}

// The samples of this dispatch if sampling isn't adaptive.
uvec2 uniform_sample_range() {
    return path_sampling.sample_index + uvec2(0u, path_sampling.samples_per_dispatch);
}

uint path_seed() {
#ifdef MANY_VIEWS
    return views.at[view_index].frame.seed;
#else
    return path_sampling.seed;
#endif
}

void trace_paths() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    uint index;
    if (!find_pixel(pixel, index) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }
    uint seed = path_seed();

    // The mean is updated sample by sample, so that its bits don't depend on how samples are split into dispatches. A
    // mean keeps the precision of the millionth sample, which a sum would lose.
    uvec2 range = sample_range(pixel);
    if (range.x >= range.y) { return; }
    uint sample_index = range.x;
    vec3 mean = vec3(0.0);
    float squared_deviations = 0.0;  // their sum
    Path path;
    path.rays = 0u;
    if (sample_index > 0u) {
        mean = radiance_mean.at[index];
        squared_deviations = luminance_deviations.at[index];
        path.rays = ray_count.at[index];
    }

    Medium medium = find_medium(start_position(pixel));

    // One loop over the rays of all samples: when a path ends, the next one starts, so invocations don't wait for the
    // longest path of their neighbors.
    bool path_ended = true;
    uint rng;
    Vertex vertex;
    while (true) {
        if (path_ended) {
            if (sample_index == range.y) { break; }
#ifdef LOW_DISCREPANCY
            sequence_index = path_sampling.first_sample + sample_index;
#else
            rng = seed_rng(pixel, path_sampling.first_sample + sample_index, seed);
#endif
            path.receiver = NO_RECEIVER;
            path.bounce = 0u;
            path.radiance = vec3(0.0);
        }
#ifdef LOW_DISCREPANCY
        rng = seed_rng(pixel, path.bounce, seed);  // the same for all samples, whatever they drew before
#endif
        bool at_vertex = path_ended && start_path(pixel, path, vertex, rng);
        if (path_ended) { path.walk.medium = medium; }
        at_vertex = at_vertex || reach_vertex(path, vertex, rng);
        path_ended = !at_vertex || !leave_vertex(path, vertex, rng);
        if (path_ended) {
            sample_index += 1u;
            // Welford, "Note on a Method for Calculating Corrected Sums of Squares and Products" (1962)
            vec3 difference = path.radiance - mean;
            mean += difference / float(sample_index);
            squared_deviations += luminance(difference) * luminance(path.radiance - mean);
        }
    }

    radiance_mean.at[index] = mean;
    luminance_deviations.at[index] = squared_deviations;
    ray_count.at[index] = path.rays;
}

#endif
