// Next event estimation: choose a point of a light, resolve it, and what it sends to a place in the world.
#ifndef SCENE_SAMPLING_GLSL
#define SCENE_SAMPLING_GLSL

#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/surface.glsl"

// Differs from Solari: whole words for light and triangle, so that neither has a limit of 65,535.
struct LightSample {
    uint light_index;
    uint triangle_index;  // of the instance's ray mesh, 0 for directional lights
    uint seed;
};

struct ResolvedLightSample {
    vec4 world_position;  // w = 0: a direction
    vec3 world_normal;
    bool double_sided;
    float ray_offset;
    vec3 radiance;
    float inverse_pdf;    // in area for positions, in solid angle for directions
};

// Without the cosine at the receiver, which BRDFs hold.
struct LightContribution {
    vec3 received_radiance;  // to be multiplied by inverse_pdf and the BRDF
    float inverse_pdf;
    vec3 wi;
    float solid_angle_pdf;   // of wi, for MIS against BRDF samples; differs from Solari, which mixes measures
};

LightSample generate_random_light_sample(inout uint rng) {
    LightSample light_sample = LightSample(rand_range_u(scene_info.light_count, rng), 0u, 0u);
    LightSource light = light_sources.at[light_sample.light_index];
    uint triangle = rand_u(rng);
    light_sample.seed = rand_u(rng);
    if (light.kind == LIGHT_EMISSIVE_MESH) {
        uint low;
        umulExtended(triangle, meshes.at[instances.at[light.index].ray_mesh].triangle_count, light_sample.triangle_index, low);
    }
    return light_sample;
}

ResolvedLightSample resolve_light_sample(LightSample light_sample) {
    LightSource light = light_sources.at[light_sample.light_index];
    uint rng = light_sample.seed;
    vec2 u = rand_vec2f(rng);
    float inverse_light_pdf = float(scene_info.light_count);
    if (light.kind == LIGHT_DIRECTIONAL) {
        DirectionalLight directional = directional_lights.at[light.index];
        vec3 direction = sample_cone(directional.direction_to_light, directional.one_minus_cos_half_angle, u);
        return ResolvedLightSample(
            vec4(direction, 0.0), -direction, false, 0.0, directional.radiance, inverse_light_pdf * directional.solid_angle
        );
    }
    Instance instance = instances.at[light.index];
    Mesh mesh = meshes.at[instance.ray_mesh];
    Material material = materials.at[instance.material];
    TrianglePoint point = resolve_triangle(instance, mesh, light_sample.triangle_index, sample_triangle_barycentrics(u));
    return ResolvedLightSample(
        vec4(point.world_position, 1.0),
        point.geometric_world_normal,
        (material.flags & MATERIAL_DOUBLE_SIDED) != 0u,
        point.ray_offset,
        resolve_emissive(material, point.uv),
        inverse_light_pdf * float(mesh.triangle_count) * point.area
    );
}

// Unshadowed. No branch on the kind of light: a direction is a position at distance 1.
LightContribution calculate_resolved_light_contribution(ResolvedLightSample light_sample, vec3 world_position) {
    vec3 to_light = light_sample.world_position.xyz - light_sample.world_position.w * world_position;
    vec3 wi = safe_normalize(to_light, vec3(0.0));
    float facing = -dot(wi, light_sample.world_normal);
    float cosine = max(facing, light_sample.double_sided ? -facing : 0.0);
    // a point within a light's own rounding error of it gets nothing rather than an infinity
    float distance_squared = max(dot(to_light, to_light), square(light_sample.ray_offset));
    float solid_angle_per_area = distance_squared > 0.0 ? cosine / distance_squared : 0.0;
    float inverse_solid_angle_pdf = solid_angle_per_area * light_sample.inverse_pdf;
    return LightContribution(
        light_sample.radiance * solid_angle_per_area,
        light_sample.inverse_pdf,
        wi,
        inverse_solid_angle_pdf > 0.0 ? 1.0 / inverse_solid_angle_pdf : 0.0
    );
}

// ---- the same densities for rays that meet a light by themselves ------------------------------------

// Of a direction towards a hit at `ray_t`, were it chosen by sampling lights; 0 for what is no light.
float emissive_hit_pdf(ResolvedRayHitFull hit, vec3 ray_direction, float ray_t) {
    float cosine = abs(dot(ray_direction, hit.geometric_world_normal));
    float inverse_pdf = float(scene_info.light_count) * float(hit.triangle_count) * hit.triangle_area * cosine;
    return hit.light_index != NO_INDEX && inverse_pdf > 0.0 ? square(ray_t) / inverse_pdf : 0.0;
}

float directional_hit_pdf(DirectionalLight light) {
    return 1.0 / (float(scene_info.light_count) * light.solid_angle);
}

bool directional_light_covers(DirectionalLight light, vec3 direction) {
    // |a - b|^2 / 2 = 1 - cos: keeps the digits that the dot product of nearly equal directions loses
    vec3 apart = direction - light.direction_to_light;
    return 0.5 * dot(apart, apart) <= light.one_minus_cos_half_angle;
}

#endif
