// Lights that are spheres: points and spots with a radius. They are no geometry: rays take up their light and go on. A
// light that is to cast shadows has an opaque ball just below its surface (solari_vk/bound/lights/blockers.py). A light
// sample is stored as a point of the unit sphere, independently of receivers; for each receiver it is mapped uniformly
// to the cone of directions in which that sees the sphere: Shirley, Wang and Zimmerman, "Monte Carlo Techniques for
// Direct Lighting Calculations" (1996).
#ifndef SCENE_LIGHTS_SPHERE_GLSL
#define SCENE_LIGHTS_SPHERE_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/punctual.glsl"
#include "scene/lights/types.glsl"

layout(set = 0, scalar) readonly buffer SphereLightsBlock {
    PunctualLight at[];
} sphere_lights;

const vec3 SPHERE_POLE = vec3(0.0, 0.0, 1.0);

// The cone in which a receiver sees a sphere.
struct SphereCone {
    vec3 axis;             // to the sphere's center
    float distance;        // of the center
    float one_minus_cos;   // of the half angle; 0 inside the sphere, which emits only outwards
    float falloff;
};

SphereCone sphere_cone(PunctualLight light, vec3 receiver) {
    vec3 to_center = light.position - receiver;
    SphereCone cone;
    cone.distance = length(to_center);
    cone.axis = safe_normalize(to_center, -light.axis);
    float squared_sine = cone.distance > light.radius ? square(light.radius / cone.distance) : 0.0;
    cone.one_minus_cos = squared_sine / (1.0 + sqrt(1.0 - squared_sine));
    cone.falloff = punctual_falloff(light, -cone.axis, cone.distance);
    return cone;
}

// The distance at which a ray enters the sphere. one_minus_cos is that of its angle with the cone's axis.
float sphere_distance(PunctualLight light, SphereCone cone, float one_minus_cos) {
    float squared_sine = one_minus_cos * (2.0 - one_minus_cos);
    float half_chord = safe_sqrt(square(light.radius) - square(cone.distance) * squared_sine);
    return cone.distance * (1.0 - one_minus_cos) - half_chord;
}

ResolvedLightSample resolve_sphere(uint index, uint part, vec2 u, float inverse_probability) {
    PunctualLight light = sphere_lights.at[index];
    vec3 on_unit_sphere = sample_cone(SPHERE_POLE, 2.0, u);
    return ResolvedLightSample(
        LIGHT_SPHERE, index, light.position, on_unit_sphere, 0.0, light.strength, inverse_probability
    );
}

ResolvedLightSample sample_for_receiver_sphere(ResolvedLightSample light_sample, vec3 receiver) {
    PunctualLight light = sphere_lights.at[light_sample.data];
    SphereCone cone = sphere_cone(light, receiver);
    float along = dot(light_sample.world_normal, cone.axis);
    vec3 sideways = light_sample.world_normal - along * cone.axis;
    float one_minus_cos = cone.one_minus_cos * saturate(0.5 - 0.5 * along);
    float sine = safe_sqrt(one_minus_cos * (2.0 - one_minus_cos));
    vec3 direction = normalize(
        cone.axis - cone.axis * one_minus_cos + sine * safe_normalize(sideways, orthonormalize(cone.axis)[0])
    );
    float distance = sphere_distance(light, cone, one_minus_cos);
    light_sample.world_position = receiver + distance * direction;
    light_sample.world_normal = -direction;
    light_sample.radiance *= cone.falloff;
    light_sample.inverse_area_pdf *= 2.0 * PI * cone.one_minus_cos * square(distance);
    return light_sample;
}

float emission_cosine_sphere(uint index, float cosine) { return 1.0; }

uint debug_color_id_sphere(uint index) { return 0xC0000000u + index; }

LightHit intersect_sphere(uint index, vec3 origin, vec3 direction, float t_max) {
    PunctualLight light = sphere_lights.at[index];
    SphereCone cone = sphere_cone(light, origin);
    vec3 difference = direction - cone.axis;
    float one_minus_cos = 0.5 * dot(difference, difference);  // precise for small spheres too
    if (!(one_minus_cos < cone.one_minus_cos && cone.falloff > 0.0)) { return NO_LIGHT_HIT; }
    float t = sphere_distance(light, cone, one_minus_cos);
    if (!(t < t_max)) { return NO_LIGHT_HIT; }
    float along = 1.0 - 2.0 * one_minus_cos / cone.one_minus_cos;
    vec3 sideways = safe_normalize(direction - cone.axis * (1.0 - one_minus_cos), vec3(0.0));
    vec3 on_unit_sphere = along * cone.axis + safe_sqrt(1.0 - square(along)) * sideways;
    vec2 u = invert_cone_sample(SPHERE_POLE, 2.0, on_unit_sphere, 1.0 - on_unit_sphere.z);
    return LightHit(light.strength * cone.falloff, 2.0 * PI * cone.one_minus_cos, 0u, u, t);
}

#endif
