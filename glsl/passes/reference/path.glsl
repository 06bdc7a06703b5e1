// Paths of the reference path tracer: what happens at the surfaces that they reach.
#ifndef PASSES_REFERENCE_PATH_GLSL
#define PASSES_REFERENCE_PATH_GLSL

#define LIGHT_STRATA SCENE_LIGHT_STRATA
#ifndef INDEPENDENT_SAMPLES
#define LOW_DISCREPANCY  // samples of a pixel are points of sequences: common/random.glsl
#endif
#include "passes/reference/bindings.glsl"
#include "passes/views.glsl"
#include "scene/walk.glsl"

// A ray to a light sample.
struct ShadowRay {
    vec3 origin;
    vec3 direction;
    float t_max;
    vec3 radiance;  // that the path gains if nothing is in between; 0: there is no ray
};

const ShadowRay NO_SHADOW_RAY = ShadowRay(vec3(0.0), vec3(0.0), 0.0, vec3(0.0));

struct Path {
    Walk walk;
    Receiver receiver;     // of the light samples that compete in MIS with the walk's direction
    ShadowRay shadow_ray;  // from the latest vertex
    uint bounce;           // the number of surfaces that the walk has left
    vec3 radiance;
    uint rays;             // the number of rays traced
};

// A surface from which a walk goes on.
struct Vertex {
    SurfaceInteraction surface;
    Brdf brdf;
    mat3 frame;    // with the shading normal as its z axis
    vec3 wo;       // in the frame
    Medium below;  // on the other side
};

// Walk.mis_pdf for the setting light_strategy: INFINITY gives light samples no weight, 0 gives them all the weight.
float mis_pdf(float pdf) {
    if (path_sampling.light_strategy == LIGHT_STRATEGY_BRDF || pdf == INFINITY) { return INFINITY; }
    return path_sampling.light_strategy == LIGHT_STRATEGY_NEE ? 0.0 : pdf;
}

// Traces the walk's ray.
Segment trace_walk(inout Path path, inout uint rng) {
    Segment segment = trace_segment(path.walk, path.receiver, rng);
    path.rays += segment.rays;
    return segment;
}

// Traces the ray to the light sample, and adds what arrives.
void trace_shadow_ray(inout Path path) {
    ShadowRay ray = path.shadow_ray;
    if (ray.radiance == vec3(0.0)) { return; }
    path.rays += 1u;
    path.radiance += ray.radiance * trace_transmittance(ray.origin, ray.direction, ray.t_max);
}

// Adds what the walk's ray has found. Returns whether the walk goes on, from `vertex`.
bool reach_vertex(inout Path path, Segment segment, inout Vertex vertex, inout uint rng) {
    path.shadow_ray = NO_SHADOW_RAY;  // of the vertex before
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

ShadowRay make_shadow_ray(NextEvent event) {
    if (!(max_component(event.radiance) > 0.0)) { return NO_SHADOW_RAY; }
    ResolvedLightSample end = shadow_sample_for_receiver(event.light_sample, event.origin);
    bool far = is_at_infinity(end.kind);
    vec3 direction = segment_to_light(event.origin, end);
    float t = far ? INFINITY : distance(event.origin, end.world_position);
    vec3 radiance = event.radiance * transmittance(event.medium, t);
    return ShadowRay(event.origin, direction, far ? INFINITY : 1.0, radiance);
}

// Chooses a light sample at a surface, and the direction in which the walk leaves it. Returns whether it goes on.
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
    path.shadow_ray = make_shadow_ray(event);  // last, when the surface isn't needed any more
    return goes_on;
}

// A path without a walk.
Path begin_path() {
    Path path;
    path.receiver = NO_RECEIVER;
    path.shadow_ray = NO_SHADOW_RAY;
    path.bounce = 0u;
    path.radiance = vec3(0.0);
    path.rays = 0u;
    return path;
}

// Says which sample of its pixel a path is.
void choose_sample(uint sample_index) {
#ifdef LOW_DISCREPANCY
    sequence_index = path_sampling.first_sample + sample_index;
#endif
}

// The random numbers of a path whose walk has left so many surfaces. `rng`: those before the latest of them.
uint next_rng(uvec2 pixel, uint sample_index, uint bounce, uint rng) {
#ifdef MANY_VIEWS
    uint seed = views.at[view_index].frame.seed;
#else
    uint seed = path_sampling.seed;
#endif
#ifdef LOW_DISCREPANCY
    return seed_rng(pixel, bounce, seed);  // the same for all samples, whatever they drew before
#else
    return bounce == 0u ? seed_rng(pixel, path_sampling.first_sample + sample_index, seed) : rng;
#endif
}

#endif
