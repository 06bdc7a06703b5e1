// A random walk through the scene. Paths are variants of this loop, which is the path tracer's:
//
//     Walk walk = start_walk(origin, direction);
//     while (true) {
//         Segment segment = trace_segment(walk, receiver, rng);
//         if (!accumulate_segment(walk, segment, receiver, radiance)) { break; }
//         SurfaceInteraction surface = arrive_at_surface(walk, segment.hit);
//         radiance += emitted_light(walk, surface, light_pdf);
//         NextEvent event = sample_light(walk, ...);
//         radiance += event.radiance * trace_shadow_ray(event.origin, ...);
//         if (!scatter(walk, sample_brdf(...), ...) || !survives(walk, ...)) { break; }
//     }
//
// What differs between walks is where they start and end, and how they sample lights. Light samples and BRDF samples
// are weighted by the power heuristic in solid angle: Veach, "Robust Monte Carlo Methods for Light Transport
// Simulation" (1997), chapter 9.
#ifndef SCENE_WALK_GLSL
#define SCENE_WALK_GLSL

#include "scene/brdf.glsl"
#include "scene/camera.glsl"
#include "scene/light_visibility.glsl"
#include "scene/lights/tree.glsl"  // Receiver, choose_leaf, leaf_choice_probability
#include "scene/medium.glsl"
#include "scene/sampling.glsl"  // light samples; it says what intersect_light and other generated functions do
#include "scene/surface.glsl"
#include "scene/trace.glsl"  // and scene/alpha.glsl: blended surfaces, RayTransmittance

const uint FIRST_ROULETTE_BOUNCE = 3u;
const uint MAX_DELTA_BOUNCES = 64u;  // these don't count towards the limit of other bounces

// ---- media ------------------------------------------------------------------------------------------

// The medium on the side of a surface that wo is not on, for a ray in `medium`.
Medium medium_below(uint instance, ResolvedMaterial material, Medium medium) {
    if (!SCENE_ABSORPTION) { return NO_MEDIUM; }
    if (!material.base.solid) { return medium; }
    // From within (base.inside), that is what lies around the solid.
    return material.base.inside ? Medium(medium.around, NO_INDEX)
        : Medium(instances.at[instance].material, medium.material);
}

const uint MAX_SURFACES_AROUND = 64u;
const vec3 WAY_OUT = vec3(0.2672612, 0.8017837, 0.5345225);  // upwards: to the surface of water without walls

// Counts the boundary of a solid on a ray that leaves the solids around its origin, and those that it has entered.
void pass_boundary(inout Medium found, inout uint entered, bool enters, uint material) {
    if (enters) {
        entered += 1u;
    } else if (entered > 0u) {
        entered -= 1u;
    } else if (found.material == NO_INDEX) {
        found.material = material;
    } else {
        found.around = material;
    }
}

// The solids around a position: the first ones whose backs a ray from there meets, without those that it enters first.
Medium find_medium(vec3 position) {
    Medium found = NO_MEDIUM;
    if (SCENE_ABSORPTION) {
        uint entered = 0u;
        for (uint i = 0u; i < MAX_SURFACES_AROUND && found.around == NO_INDEX; i++) {
            Hit hit = trace_closest_hit(position, 0.0, WAY_OUT, INFINITY, TRACE_BOTH_FACES, EVERY_SURFACE);
            if (hit.instance == NO_INDEX) { break; }
            Instance instance = instances.at[hit.instance];
            Mesh mesh = meshes.at[instance.ray_mesh];
            TrianglePoint point = resolve_triangle(instance, mesh, hit.triangle, hit.barycentrics);
            bool enters = dot(WAY_OUT, point.geometric_world_normal) <= 0.0;
            float offset = enters ? -point.ray_offset : point.ray_offset;
            position = point.world_position + offset * point.geometric_world_normal;
            if ((materials.at[instance.material].flags & MATERIAL_SOLID) != 0u) {
                pass_boundary(found, entered, enters, instance.material);
            }
        }
    }
    return found;
}

// ---- segments ---------------------------------------------------------------------------------------

// Where a walk is, and what it carries.
struct Walk {
    vec3 origin;
    vec3 direction;
    float t_min, t_max;
    bool is_camera_ray;  // the camera's own ray: back faces are culled; for transmittance see Segment
    // Whether the walk comes from the camera and left all surfaces by delta lobes: only then unlit surfaces emit.
    bool delta_path_from_camera;
    // p_b / n_l of Veach: the pdf of the direction in solid angle, over the number of light samples that compete with
    // it in MIS. INFINITY for delta lobes and where no light samples do, 0 where light samples alone find lights.
    float mis_pdf;
    vec3 throughput;
    Medium medium;
    float wavelength;        // in nanometers, or ALL_WAVELENGTHS
    float wavelength_below;  // `wavelength` after transmission at the current surface: see disperse
    float cone_width;        // of the ray cone for texture filtering, which grows by cone_spread for each meter
    float cone_spread;
};

Walk start_walk(vec3 origin, vec3 direction) {
    return Walk(origin, direction, 0.0, INFINITY, false, false, INFINITY, vec3(1.0), NO_MEDIUM, ALL_WAVELENGTHS,
        ALL_WAVELENGTHS, 0.0, 0.0);
}

Walk start_walk(CameraRay ray) {
    Walk walk = start_walk(ray.origin, ray.direction);
    walk.t_min = ray.t_min;
    walk.is_camera_ray = walk.delta_path_from_camera = true;
    walk.cone_width = ray.cone_width;
    walk.cone_spread = ray.cone_spread;
    return walk;
}

// The radiance of pass-through lights on a ray: sphere lights, which add to a ray's radiance and don't end it.
struct LightAlongRay {
    vec3 radiance;  // times RayTransmittance.weight of the blended surfaces before the light
    // Over RayTransmittance.probability instead: since rays pass those surfaces by chance, this estimates the radiance
    // without transmittance, as the target functions of reservoirs need it.
    vec3 radiance_over_probability;
};

const LightAlongRay NO_LIGHT_ALONG_RAY = LightAlongRay(vec3(0.0), vec3(0.0));

// A ray of a walk, to the next surface if there is one.
struct Segment {
    Hit hit;
    // Of blended surfaces and thin-walled glass before the hit. FULL_TRANSMITTANCE for camera rays: all such
    // glass stops them, and blended surfaces that they pass by chance don't tint them.
    RayTransmittance transmittance;
    LightAlongRay along_ray;
    uint rays;  // the number of rays traced for the segment
};

Hit find_surface(Walk walk, inout uint rng) {
    uint faces = walk.is_camera_ray ? TRACE_FRONT_FACES : TRACE_BOTH_FACES;
    return trace_closest_hit(walk.origin, walk.t_min, walk.direction, walk.t_max, faces, random_alpha_seed(rng));
}

// `receiver`: where the light samples were chosen that compete with the walk's direction.
Segment trace_segment(Walk walk, Receiver receiver, inout uint rng) {
    Segment segment = Segment(NO_HIT, FULL_TRANSMITTANCE, NO_LIGHT_ALONG_RAY, 1u);
    segment.hit = find_surface(walk, rng);
    bool tinted = SCENE_BLEND && !walk.is_camera_ray;
    float t_end = min(segment.hit.t, walk.t_max);
    uint lights = HAS_PASS_THROUGH_LIGHTS
        ? scene_info.first_light_at_infinity - scene_info.first_pass_through_light : 0u;
    // One loop traces to each pass-through light and last to the surface, since drivers inline each call.
    for (uint i = 0u; i <= lights; i++) {
        vec3 radiance = vec3(1.0);
        float t = walk.t_max;
        if (HAS_PASS_THROUGH_LIGHTS && i < lights) {
            LightSource light = light_sources.at[scene_info.first_pass_through_light + i];
            LightHit light_hit = intersect_light(light.kind, light.record_index, walk.origin, walk.direction, t_end);
            if (!(light_hit.inverse_solid_angle_pdf > 0.0)) { continue; }
            radiance = mis_weighted_radiance(light_hit, leaf_choice_probability(light.first_leaf, receiver),
                walk.mis_pdf) * transmittance(walk.medium, light_hit.t);
            t = light_hit.t;
        }
        RayTransmittance passes = FULL_TRANSMITTANCE;
        if (tinted && radiance != vec3(0.0)) {
            Hit end = segment.hit;
            if (i < lights) { end = NO_HIT; }
            passes = trace_transmittance_and_probability(walk.origin, walk.direction, t, end);
            segment.rays += 1u;
        }
        if (i == lights) {
            segment.transmittance = passes;
        } else {
            segment.along_ray.radiance += radiance * passes.weight;
            segment.along_ray.radiance_over_probability += radiance / passes.probability;
        }
    }
    return segment;
}

// Adds what lights emit along a segment, and lights at infinity if it hits no surface, and multiplies the throughput by
// its transmittance. Returns whether there is a surface.
bool accumulate_segment(inout Walk walk, Segment segment, Receiver receiver, inout vec3 radiance) {
    radiance += walk.throughput * segment.along_ray.radiance;
    walk.throughput *= segment.transmittance.weight;
    if (segment.hit.instance != NO_INDEX) { return true; }
    radiance += walk.throughput * transmittance(walk.medium, INFINITY)
        * mis_weighted_radiance_at_infinity(walk.direction, walk.mis_pdf, receiver);
    return false;
}

// ---- surfaces ---------------------------------------------------------------------------------------

// The surface where a segment ends.
SurfaceInteraction arrive_at_surface(inout Walk walk, Hit hit) {
    walk.cone_width += walk.cone_spread * hit.t;
    walk.throughput *= transmittance(walk.medium, hit.t);
    SurfaceInteraction surface = resolve_surface_interaction(hit, walk.direction, walk.cone_width);
    // A path that was stored has forgotten where its ray began.
    if (SCENE_LARGE && hit.t > 0.0) { move_to_ray(surface, walk.origin, hit.t * walk.direction); }
    return surface;
}

// Smooth thin-walled glass (MATERIAL_WALL) has a delta lobe of straight transmission, which trace_segment has sampled:
// rays pass it by chance. So after a hit throughput is divided by its probability (w), and the lobe is removed.
void remove_straight_transmission(Hit hit, vec3 direction, inout ResolvedMaterial material, inout vec3 throughput) {
    if (!SCENE_GLASS || (materials.at[instances.at[hit.instance].material].flags & MATERIAL_WALL) == 0u) { return; }
    vec4 filter_opacity = resolve_filter_opacity(hit.instance, hit.triangle, hit.barycentrics, direction, false);
    if (filter_opacity.w < 1.0) {
        throughput /= filter_opacity.w;
        material.glass.reflects_only = true;
    }
}

// Gives dispersive glass the index of refraction for the walk's wavelength. A walk with all wavelengths samples
// one by u, and takes it if transmitted or inside. Reflected outside it keeps all, with an index for each color.
void disperse(inout Walk walk, uint instance, inout ResolvedMaterial material, float u) {
    walk.wavelength_below = walk.wavelength;
    if (!material.base.solid) { return; }
    float dispersion = materials.at[instances.at[instance].material].dispersion;
    if (dispersion == 0.0) { return; }
    bool has_one = walk.wavelength != ALL_WAVELENGTHS;
    if (!has_one) { walk.wavelength_below = sample_wavelength(u); }
    float ior = material.glass.ior;
    vec3 wavelength_ior = dispersed_ior(ior, dispersion, vec3(1.0 / square(walk.wavelength_below)));
    material.glass.dispersed = Dispersed(wavelength_ior.x, wavelength_ior, vec3(1.0));
    if (has_one) { return; }
    vec3 color = wavelength_color(walk.wavelength_below);
    if (material.base.inside) {
        walk.wavelength = walk.wavelength_below;
        walk.throughput *= color;
    } else {
        material.glass.dispersed.reflected_iors = dispersed_ior(ior, dispersion, bands_inverse_square());
        material.glass.dispersed.transmitted_color = color;
    }
}

void disperse(inout Walk walk, uint instance, inout ResolvedMaterial material, inout uint rng) {
    if (SCENE_DISPERSION && uses_random_numbers_for(WITHOUT_DISPERSION)) {  // not where only other worlds disperse
        disperse(walk, instance, material, rand_f(rng));
    }
}

// What a surface emits, with throughput and MIS weight. light_pdf: in solid angle; 0 if light samples can't choose it.
vec3 emitted_light(Walk walk, SurfaceInteraction surface, float light_pdf) {
    float weight = light_pdf == 0.0 ? 1.0 : power_heuristic(walk.mis_pdf, light_pdf);
    bool emits = surface.emits_towards_ray || surface.unlit && walk.delta_path_from_camera;
    return emits ? walk.throughput * surface.material.emissive * weight : vec3(0.0);
}

// The solid angle pdf with which light samples take the point that a ray has hit. NO_RECEIVER: lights chosen by power.
float hit_light_pdf(Receiver receiver, Hit hit, SurfaceInteraction surface, vec3 direction) {
    float pdf = emissive_hit_pdf(surface, direction, hit.t);
    if (!(pdf > 0.0) || receiver.normal == vec3(0.0)) { return pdf; }
    LightSource light = light_sources.at[instances.at[hit.instance].light_index];
    uint leaf = part_of_leaf(light, hit.triangle).leaf;
    return pdf * leaf_choice_probability(leaf, receiver) / light_leaves.at[leaf].by_power.probability;
}

// How much of a surface's lift a ray needs: none above a cosine of 0.2 with the geometric normal, where it would cost
// contact shadows.
float lift_along(float lift, float cosine) { return SCENE_SMOOTH_NORMALS ? lift * saturate(2.0 - 10.0 * cosine) : 0.0; }

// The origin of rays in a direction, offset to that side of the surface.
vec3 ray_origin(vec3 position, vec3 geometric_normal, float ray_offset, float lift, vec3 direction) {
    float cosine = dot(direction, geometric_normal);
    bool transmits = SCENE_TRANSMISSION && cosine < 0.0 && lift == 0.0;
    return position + (transmits ? -ray_offset : ray_offset + lift_along(lift, cosine)) * geometric_normal;
}

vec3 ray_origin(SurfaceInteraction surface, vec3 direction) {
    return ray_origin(
        surface.world_position, surface.geometric_world_normal, surface.ray_offset, surface.lift, direction
    );
}

// Whether the shading and the geometric normal put a direction on the same side of the surface: above, or below if the
// scene has transmission. `cos_theta` is its cosine with the shading normal. Above the surface and below the shading
// normal a coat reflects, whose normal is another; the BRDF is 0 there without one. With a lift, the shading normal
// decides.
bool is_on_valid_side(float cos_theta, vec3 direction, vec3 geometric_normal, float lift) {
    float geometric = dot(direction, geometric_normal);
    if (lift > 0.0 && cos_theta > 0.0) { return true; }
    return ((cos_theta > 0.0 || SCENE_LAYERS) && geometric > 0.0)
        || (SCENE_TRANSMISSION && cos_theta < 0.0 && geometric < 0.0);
}

// Leaves a surface in a sampled direction; the caller sets walk.origin. `frame` has the shading normal as its z axis,
// `below` is the medium on the other side. Returns is_on_valid_side of the direction.
bool scatter(inout Walk walk, BrdfSample next, mat3 frame, vec3 geometric_normal, float lift, Medium below) {
    walk.direction = normalize(frame * next.wi);
    walk.t_min = 0.0;
    walk.is_camera_ray = false;
    walk.delta_path_from_camera = walk.delta_path_from_camera && next.pdf == INFINITY;
    walk.mis_pdf = next.pdf;
    walk.throughput *= next.weight;
    if (SCENE_TRANSMISSION && lift == 0.0 && dot(walk.direction, geometric_normal) < 0.0) {
        walk.medium = below;
        if (SCENE_DISPERSION) { walk.wavelength = walk.wavelength_below; }
    }
    return is_on_valid_side(next.wi.z, walk.direction, geometric_normal, lift);
}

// Russian roulette from FIRST_ROULETTE_BOUNCE on. survival_probability, in proportion to the throughput, may exceed 1.
// Differs from Solari: it is clamped, so that no energy is lost.
bool survives(inout Walk walk, float survival_probability, uint bounce, inout uint rng) {
    float clamped = bounce >= FIRST_ROULETTE_BOUNCE ? min(survival_probability, 1.0) : 1.0;
    walk.throughput /= clamped;
    return survival_probability > 0.0 && rand_f(rng) < clamped;
}

// ---- light samples ----------------------------------------------------------------------------------

// Next event estimation before the shadow ray.
struct NextEvent {
    vec3 radiance;  // reflected at the surface, with throughput, if nothing is in between; 0: no shadow ray is needed
    vec3 origin;    // of the shadow ray
    Medium medium;  // in which it goes
    ResolvedLightSample light_sample;
};

// The transmittance between the origin of a shadow ray and a light sample, of surfaces and of the medium.
vec3 trace_shadow_ray(vec3 origin, Medium medium, ResolvedLightSample light_sample) {
    light_sample = shadow_sample_for_receiver(light_sample, origin);
    vec3 visible = trace_light_transmittance(origin, light_sample);
    if (!SCENE_ABSORPTION || medium.material == NO_INDEX) { return visible; }
    bool far = is_at_infinity(light_sample.kind);
    return visible * transmittance(medium, far ? INFINITY : distance(origin, light_sample.world_position));
}

// A sample of a leaf. `mis`: with its MIS weight against BRDF samples.
NextEvent sample_leaf(
    Walk walk, SurfaceInteraction surface, Brdf brdf, mat3 frame, vec3 wo, Medium below, ChosenLeaf chosen, bool mis,
    inout uint rng
) {
    NextEvent event;
    event.radiance = vec3(0.0);
    LightSample light_sample = sample_leaf(chosen.leaf, rng);
    ResolvedLightSample resolved = resolve_light_sample(light_sample, chosen.probability);
    LightContribution light = calculate_resolved_light_contribution(resolved, surface.world_position);
    event.light_sample = for_shadow_ray(resolved, light.wi);
    vec3 wi = light.wi * frame;
    if (!is_on_valid_side(wi.z, light.wi, surface.geometric_world_normal, surface.lift)) { return event; }
    event.origin = ray_origin(surface, light.wi);
    bool passes = surface.lift == 0.0 && dot(light.wi, surface.geometric_world_normal) < 0.0;
    event.medium = passes ? below : walk.medium;
    vec3 value = light.radiance_in_area_measure * light.inverse_area_pdf * brdf_times_cosine(brdf, wo, wi);
    if (mis) { value *= power_heuristic(light.solid_angle_pdf, brdf_pdf(brdf, wo, wi)); }
    event.radiance = walk.throughput * value;
    return event;
}

// One of several samples, by weighted reservoir sampling. The weight is the square root of what a sample sends without
// occlusion, since the strongest may be occluded.
struct LightPick {
    NextEvent event;
    float weight;      // of the event
    float weight_sum;
    float sent;        // luminance of all samples together
};

LightPick no_pick() {
    LightPick pick;
    pick.event.radiance = vec3(0.0);
    pick.weight = pick.weight_sum = pick.sent = 0.0;
    return pick;
}

void add_to_pick(inout LightPick pick, NextEvent next, inout uint rng) {
    float sent = luminance(next.radiance), weight = sqrt(sent);
    if (!(sent > 0.0)) { return; }
    pick.sent += sent;
    if (choose_weighted(pick.weight_sum, weight, rng)) {
        pick.event = next;
        pick.weight = weight;
    }
}

// The share of choices between lights at infinity and others that ignores what they send, since walls may hide one.
const float EQUAL_SHARE = 0.5;

// A light sample for the receiver: where there are strata, that of one of them, chosen by what they send.
NextEvent sample_light(
    Walk walk, SurfaceInteraction surface, Brdf brdf, mat3 frame, vec3 wo, Medium below, Receiver receiver, bool mis,
    inout uint rng
) {
    LightPick near = no_pick(), far = near;
    uint count = min(scene_info.light_count, 1u);
    if (LIGHT_STRATA && count > 0u) { count = stratum_count(); }
    for (uint i = 0u; i < count; i++) {
        // One call for both cases, since compilers inline each.
        ChosenLeaf chosen;
        if (LIGHT_STRATA) {
            chosen = choose_leaf_of(i, receiver, rng);
        } else {
            chosen = choose_leaf(receiver, rng);
        }
        NextEvent next = sample_leaf(walk, surface, brdf, frame, wo, below, chosen, mis, rng);
        if (!LIGHT_STRATA) {
            near.event = next;
        } else if (is_at_infinity(light_leaves.at[chosen.leaf])) {
            add_to_pick(far, next, rng);
        } else {
            add_to_pick(near, next, rng);
        }
    }
    if (!LIGHT_STRATA) { return near.event; }
    float far_probability = mix(far.sent / max(near.sent + far.sent, 1e-30), 0.5, EQUAL_SHARE);
    if (near.sent == 0.0 || far.sent == 0.0) { far_probability = near.sent == 0.0 ? 1.0 : 0.0; }
    LightPick pick = near;
    float probability = 1.0 - far_probability;
    if (rand_f(rng) < far_probability) {
        pick = far;
        probability = far_probability;
    }
    if (pick.weight > 0.0) { pick.event.radiance *= pick.weight_sum / (pick.weight * probability); }
    return pick.event;
}

#endif
