// The reference path tracer: updates each pixel's mean with more samples. Paths start at the camera; light samples and
// BRDF samples are weighted by the power heuristic in solid angle: Veach, "Robust Monte Carlo Methods for Light
// Transport Simulation" (1997), chapter 9.
#version 460
#include "common/pixel.glsl"
#include "passes/pathtracer/bindings.glsl"
#include "passes/pathtracer/pixel_filter.glsl"
#include "scene/brdf.glsl"
#include "scene/camera.glsl"
#include "scene/departure.glsl"
#include "scene/light_visibility.glsl"
#include "scene/sampling.glsl"
#include "scene/surface.glsl"
#include "scene/trace.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint FIRST_ROULETTE_BOUNCE = 3u;

// The MIS weight of a light that a ray hit by BRDF sampling.
float hit_weight(float bounce_pdf, float light_pdf) {
    return light_pdf == 0.0 ? 1.0 : power_heuristic(bounce_pdf, light_pdf);
}

// The density of a bounce as MIS uses it: INFINITY gives light samples no weight, 0 gives them all the weight.
float mis_pdf(float pdf) {
    if (path_sampling.light_strategy == LIGHT_STRATEGY_BRDF || pdf == INFINITY) { return INFINITY; }
    return path_sampling.light_strategy == LIGHT_STRATEGY_NEE ? 0.0 : pdf;
}

// Samples a light, without visibility, with the MIS weight against hitting the same point by a BRDF sample.
// `absorption` is that of the solid on wo's side; the shadow ray is to start at `origin`.
vec3 sample_light(
    ResolvedRayHitFull surface, Brdf brdf, mat3 frame, vec3 wo, vec3 absorption, inout uint rng,
    out ResolvedLightSample light_sample, out vec3 origin
) {
    light_sample = resolve_light_sample(generate_random_light_sample(rng));
    LightContribution light = calculate_resolved_light_contribution(light_sample, surface.world_position);
    vec3 wi = light.wi * frame;
    if (!is_possible(wi.z, light.wi, surface.geometric_world_normal)) { return vec3(0.0); }
    origin = ray_origin(surface, light.wi);
    vec3 value = light.received_radiance * light.inverse_pdf * evaluate_brdf(brdf, wo, wi);
    if (SCENE_GLASS) {
        if (wi.z < 0.0) { absorption = absorption_below(surface.material); }
        bool far = is_at_infinity(light_sample.kind);
        vec3 position = aim_light(light_sample, origin).world_position;
        value *= attenuation(absorption, far ? INFINITY : distance(origin, position));
    }
    return path_sampling.light_strategy == LIGHT_STRATEGY_MIS
        ? value * power_heuristic(light.solid_angle_pdf, brdf_pdf(brdf, wo, wi))
        : value;
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
    bool path_ended = true;
    uint rng;
    vec3 origin, direction, radiance, throughput;
    vec3 absorption;  // of the solid that the path is in, per meter
    float t_min, cone_spread, cone_width, bounce_pdf;
    while (true) {
        if (path_ended) {
            if (sample_index == last_sample_index) { break; }
            rng = seed_rng(pixel, sample_index, path_sampling.seed);
            CameraRay ray = make_camera_ray(vec2(pixel) + 0.5 + sample_pixel_filter(rand_vec2f(rng)));
            if (camera.lens_radius > 0.0) { ray = through_lens(ray, sample_disk(rand_vec2f(rng))); }
            origin = ray.origin;
            direction = ray.direction;
            t_min = ray.t_min;
            cone_spread = ray.cone_spread;
            cone_width = ray.cone_width;
            bounce = 0u;
            bounce_pdf = INFINITY;
            radiance = vec3(0.0);
            throughput = vec3(1.0);
            absorption = vec3(0.0);
            path_ended = false;
        }

        rays += 1u;
        uint faces = bounce == 0u ? TRACE_FRONT_FACES : TRACE_BOTH_FACES;
        Hit hit = trace_closest_hit(origin, t_min, direction, INFINITY, faces, random_blend_point(rng));
        if (bounce == 0u) {
            radiance += radiance_passed(origin, direction, hit.t, INFINITY);
        } else {
            uint lamp_rays;
            radiance += throughput * trace_radiance_passed(origin, direction, hit.t, bounce_pdf, lamp_rays);
            rays += lamp_rays;
            if (SCENE_BLEND) {
                rays += 1u;
                throughput *= trace_passage(origin, direction, INFINITY, hit).tint;
            }
        }
        if (hit.instance == NO_INDEX) {
            radiance += throughput * radiance_at_infinity(direction, bounce_pdf);
            path_ended = true;
        } else {
            cone_width += cone_spread * hit.t;
            ResolvedRayHitFull surface = resolve_ray_hit_full(hit, direction, cone_width);
            if (bounce > 0u) { take_wall_as_met(hit, direction, surface.material, throughput); }
            if (SCENE_GLASS) { throughput *= attenuation(absorption, hit.t); }
            if (bounce == 0u) {
                radiance += shown_emission(surface);
            } else if (surface.emits) {
                float light_pdf = emissive_hit_pdf(surface, direction, hit.t);
                radiance += throughput * surface.material.emissive * hit_weight(bounce_pdf, light_pdf);
            }
            path_ended = bounce == path_sampling.max_bounces;
            if (!path_ended) {
                mat3 frame = orthonormalize(surface.world_normal);
                vec3 wo = -direction * frame;
                Brdf brdf = prepare_brdf(surface.material, wo);

                vec3 direct = vec3(0.0), shadow_origin;
                ResolvedLightSample light_sample;
                if (path_sampling.light_strategy != LIGHT_STRATEGY_BRDF && scene_info.light_count > 0u) {
                    direct = throughput
                        * sample_light(surface, brdf, frame, wo, absorption, rng, light_sample, shadow_origin);
                }
                BrdfSample next = sample_brdf(brdf, wo, rng);
                direction = normalize(frame * next.wi);
                throughput *= next.weight;
                bounce_pdf = mis_pdf(next.pdf);
                t_min = 0.0;
                bounce += 1u;
                // Differs from Solari: the survival probability is at most 1, so that Russian roulette loses no energy.
                float survival = bounce >= FIRST_ROULETTE_BOUNCE ? min(max_component(throughput), 1.0) : 1.0;
                path_ended = !is_possible(next.wi.z, direction, surface.geometric_world_normal)
                    || !(max_component(throughput) > 0.0) || rand_f(rng) >= survival;
                throughput /= survival;
                origin = ray_origin(surface, direction);
                if (SCENE_GLASS && next.wi.z < 0.0) { absorption = absorption_below(surface.material); }

                // last, when the surface isn't needed any more
                if (max_component(direct) > 0.0) {
                    rays += 1u;
                    radiance += direct * trace_light_transmittance(shadow_origin, light_sample);
                }
            }
        }

        if (path_ended) {
            sample_index += 1u;
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
