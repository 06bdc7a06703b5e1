// Reuse of light between pixels: Lin et al., "Generalized Resampled Importance Sampling: Foundations of ReSTIR" (2022).
// A reservoir holds one of two kinds of samples. A light sample is a point of a light; shifts keep it, with Jacobian 1.
// A path sample is a path's second vertex (x2) with the radiance that leaves it by its diffuse lobe; pixels shift it by
// reconnection: Ouyang et al., "ReSTIR GI: Path Resampling for Real-Time Path Tracing" (2021). Together they are all
// light that the pixel's diffuse lobe reflects, and its specular lobe if that is rough enough (reuses_specular), but
// for the light that x2 reflects specularly, which goes to the pixel directly.
//
// Pdfs of light samples are in primary sample space: over lights, parts and the random numbers in a part, so that they
// stay valid when lights move or turn. Light samples are found by next event estimation and by BRDF sampling. The MIS
// weight of these two strategies is part of a sample's resampling weight alone; the target function is the reflected
// luminance, whichever strategy found the sample. Differs from Solari, whose samples keep their MIS weight.
#ifndef PASSES_PATHS_RESERVOIR_GLSL
#define PASSES_PATHS_RESERVOIR_GLSL

#include "common/sobol.glsl"
#include "passes/camera_medium.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/paths/bindings.glsl"
#include "passes/paths/vertex.glsl"  // and scene/sampling.glsl, which says what resolve_light and its like do
#include "passes/ray_count.glsl"
#include "scene/trace.glsl"

// Shifts with a Jacobian above this, or below its inverse, are undefined: their weights would be outliers.
const float MAX_JACOBIAN = 8.0;

const uint WAVELENGTH_SALT = 0x2C1B3C6Du;

// The target function of a sample at a surface: the luminance that it reflects, without occlusion and the
// transmittance of surfaces, but with that of the medium.
struct TargetFunction {
    PerLobe integrand;  // reflected radiance, to be multiplied by the sample's unbiased contribution weight
    float value;        // its luminance
};

const PathReservoir EMPTY_RESERVOIR = PathReservoir(uvec4(0u), vec3(0.0), 0.0, 0.0, NO_INDEX);

// The random number that chooses the wavelength of a pixel's light, the same in all passes of a frame.
float wavelength_u(uvec2 pixel) {
    return sobol_point(this_frame.index, seed_rng(pixel, 0u, this_frame.seed ^ WAVELENGTH_SALT)).x;
}

// Whether light of a surface depends on the wavelength that its pixel chose, so that other pixels and frames, which
// chose others, can't use it.
bool is_dispersive(GBufferSurface surface) {
    return SCENE_DISPERSION && surface.material.base.solid
        && materials.at[instances.at[surface.instance].material].dispersion > 0.0;
}

// The surface with the index of refraction for the wavelength that the pixel's path drew in first_ray.comp.
GBufferSurface dispersed(GBufferSurface surface, uvec2 pixel) {
    if (SCENE_DISPERSION) {
        Walk walk = start_walk(vec3(0.0), vec3(0.0));
        disperse(walk, surface.instance, surface.material, wavelength_u(pixel));
    }
    return surface;
}

Vertex make_vertex(GBufferSurface surface) {
    Vertex vertex = make_vertex(
        surface.world_position, surface.geometric_world_normal, surface.ray_offset, surface.lift,
        surface.world_normal, surface.wo
    );
    vertex.brdf = prepare_brdf(surface.material, vertex.wo);
    vertex.above = camera_medium();
    vertex.below = medium_below(surface.instance, surface.material, vertex.above);
    return vertex;
}

// Whether the specular lobe takes light from reservoirs. Samples of a smoother lobe are of no use to other pixels.
bool reuses_specular(float perceptual_roughness) { return perceptual_roughness >= restir_settings.roughness; }

PerLobe reused_lobes(PerLobe lobes, float perceptual_roughness) {
    return PerLobe(lobes.diffuse, reuses_specular(perceptual_roughness) ? lobes.specular : vec3(0.0));
}

bool is_path_sample(PathReservoir reservoir) { return reservoir.instance != NO_INDEX; }
vec3 hit_position(PathReservoir reservoir) { return uintBitsToFloat(reservoir.point.xyz); }
vec3 hit_normal(PathReservoir reservoir) { return unpack_octahedral_2x16(reservoir.point.w); }

ResolvedLightSample resolve_light_point(PathReservoir reservoir) {
    uvec4 point = reservoir.point;
    LightSource light = light_sources.at[point.x];
    const float inverse_probability = 1.0;  // W holds the pdf over lights, parts and random numbers
    return resolve_light(light.kind, light.record_index, point.y, uintBitsToFloat(point.zw), inverse_probability);
}

TargetFunction evaluate_target(Vertex vertex, PathReservoir reservoir) {
    TargetFunction nothing = TargetFunction(ZERO_LOBES, 0.0);
    if (!(reservoir.weight > 0.0)) { return nothing; }
    vec3 direction, incident;
    float t;  // the sample's distance
    if (is_path_sample(reservoir)) {
        direction = safe_normalize(hit_position(reservoir) - vertex.position, vec3(0.0));
        t = distance(hit_position(reservoir), vertex.position);
        incident = reservoir.radiance;
    } else {
        LightContribution light =
            calculate_resolved_light_contribution(resolve_light_point(reservoir), vertex.position);
        direction = light.wi;
        t = light.distance;
        incident = light.radiance_in_area_measure * light.inverse_area_pdf;
    }
    vec3 wi = direction * vertex.frame;
    if (!is_on_valid_side(wi.z, direction, vertex.geometric_normal, vertex.lift)) { return nothing; }
    if (SCENE_ABSORPTION) { incident *= transmittance(medium_towards(vertex, direction), t); }
    PerLobe lobes = lobes_times_cosine(vertex, wi);
    PerLobe light = scale(reused_lobes(lobes, vertex.brdf.specular.perceptual_roughness), incident);
    return TargetFunction(light, luminance(sum(light)));
}

// The Jacobian of the reconnection shift: the solid angle of a piece of x2's surface seen from `to`, over that seen
// from `from`; 1 for light samples. 0 where the shift is undefined, because x2 faces away or by MAX_JACOBIAN. A shift
// is undefined in both directions or in none.
float shift_jacobian(Vertex from, Vertex to, PathReservoir reservoir) {
    if (!is_path_sample(reservoir)) { return 1.0; }
    vec3 to_from = from.position - hit_position(reservoir), to_to = to.position - hit_position(reservoir);
    vec3 normal = hit_normal(reservoir);
    float from_cosine = dot(normalize(to_from), normal), to_cosine = dot(normalize(to_to), normal);
    if (!(from_cosine > 0.0 && to_cosine > 0.0)) { return 0.0; }
    float jacobian = to_cosine / from_cosine * (dot(to_from, to_from) / dot(to_to, to_to));
    return max(jacobian, 1.0 / jacobian) <= MAX_JACOBIAN ? jacobian : 0.0;
}

// The transmittance between a sample and a vertex. Each vertex sees the light sample of a sphere at a point of its own,
// that of a portal in a direction of its own: light_sample_for_receiver.
vec3 trace_sample_transmittance(Vertex vertex, PathReservoir reservoir, bool in_previous_frame) {
    vec3 to_sample, origin = vertex.origin;
    float t_max = 1.0;
    if (is_path_sample(reservoir)) {
        if (SCENE_TRANSMISSION || vertex.lift > 0.0) {
            origin = ray_origin(vertex, safe_normalize(hit_position(reservoir) - vertex.position, vec3(0.0)));
        }
        to_sample = hit_position(reservoir) - origin;
        // ends before the point by the rounding error of a ray of this length
        to_sample += hit_normal(reservoir) * (16.0 * ROUNDING_UNIT * max_component(abs(to_sample)));
    } else {
        ResolvedLightSample light = resolve_light_point(reservoir);
        bool at_infinity = is_at_infinity(light.kind);
        if (SCENE_TRANSMISSION || SCENE_PORTAL || vertex.lift > 0.0) {
            vec3 end = light_sample_for_receiver(light, vertex.position).world_position;
            origin = ray_origin(vertex, safe_normalize(at_infinity ? end : end - vertex.position, vec3(0.0)));
            light = for_shadow_ray(light, end);
        }
        to_sample = shadow_ray_segment(origin, light);
        t_max = at_infinity ? INFINITY : 1.0;
    }
    count_ray();
    if (in_previous_frame) { return trace_previous_transmittance(origin, to_sample, t_max); }
    return trace_transmittance(origin, to_sample, t_max);
}

bool is_visible(Vertex vertex, PathReservoir reservoir, bool in_previous_frame) {
    return trace_sample_transmittance(vertex, reservoir, in_previous_frame) != vec3(0.0);
}

// A pixel's reservoir after a merge, and what its surface reflects of both samples, each with its MIS weight.
struct Merge {
    PathReservoir reservoir;
    PerLobe light;
};

// Merges another pixel's reservoir, of surface `there`, into this pixel's, by the generalized balance heuristic with
// both pixels' targets and visibility. `other_confidence`: the other pixel's confidence, as it counts in the MIS
// weight of this pixel's sample (x) and of its own (y). `choice`: a random number in [0, 1). Differs from Solari, where
// a pixel's own sample keeps half of its weight in each merge with a neighbor: that has more noise here.
Merge merge_reservoirs(
    Vertex here, PathReservoir own, Vertex there, PathReservoir other, bool there_in_previous_frame,
    vec2 other_confidence, float choice
) {
    TargetFunction own_target = evaluate_target(here, own), other_target = evaluate_target(here, other);
    float own_mis_weight = 1.0, other_mis_weight = 0.0;
    if (own_target.value > 0.0) {
        float own_target_there = evaluate_target(there, own).value * shift_jacobian(here, there, own);
        own_mis_weight = balance_heuristic(own.confidence * own_target.value, other_confidence.x * own_target_there);
        if (own_mis_weight < 1.0 && !is_visible(there, own, there_in_previous_frame)) { own_mis_weight = 1.0; }
    }
    // Only after spatial reuse is the light of a merge added to the pixel. A pixel's own sample is known to be visible
    // to it, so that blended surfaces alone can dim it.
    if (SCENE_BLEND && own_target.value > 0.0 && !there_in_previous_frame) {
        own_target.integrand = scale(own_target.integrand, trace_sample_transmittance(here, own, false));
    }
    if (other_target.value > 0.0) {
        float jacobian = shift_jacobian(there, here, other);
        other_mis_weight = balance_heuristic(
            other_confidence.y * evaluate_target(there, other).value, own.confidence * other_target.value * jacobian
        );
        other.weight *= jacobian;
        if (other_mis_weight * jacobian > 0.0) {
            vec3 transmittance = trace_sample_transmittance(here, other, false);
            if (transmittance == vec3(0.0)) { other_mis_weight = 0.0; }
            other_target.integrand = scale(other_target.integrand, transmittance);
        }
    }

    float own_weight = own_mis_weight * own.weight, other_weight = other_mis_weight * other.weight;
    Merge merged;
    merged.light = PerLobe(
        own_target.integrand.diffuse * own_weight + other_target.integrand.diffuse * other_weight,
        own_target.integrand.specular * own_weight + other_target.integrand.specular * other_weight
    );
    float own_resampling_weight = own_target.value * own_weight;
    float other_resampling_weight = other_target.value * other_weight;
    float weight_sum = own_resampling_weight + other_resampling_weight;
    bool chooses_other = choice * weight_sum < other_resampling_weight;
    float target = chooses_other ? other_target.value : own_target.value;
    merged.reservoir = chooses_other ? other : own;
    merged.reservoir.weight = target > 0.0 ? weight_sum / target : 0.0;
    merged.reservoir.confidence = own.confidence + other.confidence;
    return merged;
}

#endif
