// The reference path tracer: updates each pixel's mean with more samples, by walks that start at the camera.
#version 460
#include "common/pixel.glsl"
#include "passes/pathtracer/bindings.glsl"
#include "passes/pathtracer/pixel_filter.glsl"
#include "scene/walk.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// The density of a bounce as MIS uses it: INFINITY gives light samples no weight, 0 gives them all the weight.
float mis_pdf(float pdf) {
    if (path_sampling.light_strategy == LIGHT_STRATEGY_BRDF || pdf == INFINITY) { return INFINITY; }
    return path_sampling.light_strategy == LIGHT_STRATEGY_NEE ? 0.0 : pdf;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX + uvec2(0u, path_sampling.first_row);
    if (!is_inside(pixel, camera.size) || INVOCATION_INDEX.y >= path_sampling.row_count) { return; }

    // The mean is updated sample by sample, so that its bits don't depend on how samples are split into dispatches. A
    // mean keeps the precision of the millionth sample, which a sum would lose.
    uint index = pixel_index(pixel, camera.size);
    uint sample_index = path_sampling.sample_index;
    vec3 mean = vec3(0.0);
    float deviations = 0.0;
    uint rays = 0u;
    if (sample_index > 0u) {
        mean = radiance_mean.at[index];
        deviations = luminance_deviations.at[index];
        rays = ray_count.at[index];
    }
    uint last_sample_index = sample_index + path_sampling.samples_per_dispatch;

    // One loop over the rays of all samples: when a path ends, the next one starts, so invocations don't wait for the
    // longest path of their neighbors.
    uint bounce = 0u;
    bool path_ended = true, seen = true;
    uint rng;
    vec3 radiance;
    Walk walk;
    Receiver receiver;  // where the light samples were chosen that compete with the walk's direction
    while (true) {
        if (path_ended) {
            if (sample_index == last_sample_index) { break; }
            rng = seed_rng(pixel, sample_index, path_sampling.seed);
            vec2 position = vec2(pixel) + 0.5 + sample_pixel_filter(rand_vec2f(rng));
            CameraRay ray = make_camera_ray(position);
            if (camera.lens_radius > 0.0) { ray = through_lens(ray, sample_disk(rand_vec2f(rng))); }
            walk = start_walk(ray);
            walk.cone_width = walk.cone_spread = 0.0;  // the finest level of textures: samples average it
            seen = is_seen(position);
            receiver = CHOSEN_BY_POWER;
            bounce = 0u;
            radiance = vec3(0.0);
        }

        Segment segment = trace_segment(walk, receiver, rng);
        rays += segment.rays;
        path_ended = !accumulate_segment(walk, segment, radiance);
        if (!path_ended) {
            SurfaceInteraction surface = resolve_surface(walk, segment.hit);
            if (bounce == 0u) {
                radiance += shown_emission(surface);
            } else {
                remove_straight_transmission(segment.hit, walk.direction, surface.material, walk.throughput);
                float light_pdf = hit_light_pdf(receiver, segment.hit, surface, walk.direction);
                radiance += emitted_light(walk, surface, light_pdf);
            }
            path_ended = bounce == path_sampling.max_bounces;
            if (!path_ended) {
                mat3 frame = orthonormalize(surface.world_normal);
                vec3 wo = -walk.direction * frame;
                Brdf brdf = prepare_brdf(surface.material, wo);
                Medium below = medium_below(segment.hit.instance, surface.material);
                receiver = Receiver(surface.world_position, surface.world_normal);

                NextEvent event;
                event.radiance = vec3(0.0);
                if (path_sampling.light_strategy != LIGHT_STRATEGY_BRDF) {
                    bool mis = path_sampling.light_strategy == LIGHT_STRATEGY_MIS;
                    event = sample_light(walk, surface, brdf, frame, wo, below, receiver, mis, rng);
                }
                bool possible = scatter(walk, sample_brdf(brdf, wo, rng), frame, surface.geometric_world_normal, below);
                walk.bounce_pdf = mis_pdf(walk.bounce_pdf);
                walk.origin = ray_origin(surface, walk.direction);
                bounce += 1u;
                path_ended = !possible || !survives(walk, max_component(walk.throughput), bounce, rng);

                // last, when the surface isn't needed any more
                if (max_component(event.radiance) > 0.0) {
                    rays += 1u;
                    radiance += event.radiance * trace_light(event.origin, event.medium, event.light_sample);
                }
            }
        }

        if (path_ended) {
            sample_index += 1u;
            if (!seen) { radiance = vec3(0.0); }
            // Welford, "Note on a Method for Calculating Corrected Sums of Squares and Products" (1962)
            vec3 apart = radiance - mean;
            mean += apart / float(sample_index);
            deviations += luminance(apart) * luminance(radiance - mean);
        }
    }

    radiance_mean.at[index] = mean;
    luminance_deviations.at[index] = deviations;
    ray_count.at[index] = rays;
}
