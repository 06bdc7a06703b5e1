// What rays pass through: surfaces that are cut out by their alpha (alpha mode "mask"), blended ones ("blend"), and
// smooth thin-walled glass ("walls").
//
// A ray that looks for a surface hits a blended one with the probability alpha. What passes keeps its color, as in
// glTF, which blends the picture of a surface over what lies behind it.
//
// A wall's delta lobe of straight transmission is treated like a blended surface: its alpha is one minus the largest
// channel of the transmittance, and what passes is also multiplied by a color. Camera rays always hit walls.
#ifndef SCENE_ALPHA_GLSL
#define SCENE_ALPHA_GLSL

#include "common/random.glsl"
#include "common/sobol.glsl"
#include "scene/bindings.glsl"
#include "scene/lobes/coat.glsl"
#include "scene/lobes/glass.glsl"
#include "scene/microfacet.glsl"
#include "scene/textures.glsl"

// The base color, and in w the opacity: 0 or 1 for opaque surfaces and masks. Textures are sampled at their
// finest level for every ray, so that all rays meet the same surface.
vec4 resolve_color_opacity(Material material, Mesh mesh, uint triangle, vec2 barycentrics) {
    // The previous TLAS may have a triangle of a mesh that has left this row of the tables.
    uvec3 vertices = mesh.triangles.at[min(triangle, mesh.triangle_count - 1u)];
    vec4 color = vec4(material.base_color, material.alpha) * vertex_color(mesh, vertices, barycentrics);
    if (material.base_color_texture != NO_INDEX) {
        color *= sample_texture(material.base_color_texture, texture_point(mesh, vertices, barycentrics));
    }
    if ((material.flags & MATERIAL_MASK) != 0u) { color.w = color.w >= material.alpha_cutoff ? 1.0 : 0.0; }
    return color;
}

bool has_alpha(Material material) {
    return SCENE_ALPHA && (material.flags & (MATERIAL_MASK | MATERIAL_BLEND)) != 0u;
}

// The same for thin-walled glass, solved for the transmittance `through` of the delta lobe: attenuate_by_surface makes
// (1 - opacity) * mix(1, filter, opacity) of what is returned.
vec4 resolve_thin_wall(
    Instance instance, Material material, Mesh mesh, uint triangle, vec2 barycentrics, vec3 direction, vec3 color
) {
    uvec3 vertices = mesh.triangles.at[min(triangle, mesh.triangle_count - 1u)];
    TexturePoint point = texture_point(mesh, vertices, barycentrics);
    vec2 roughness_metallic = vec2(material.perceptual_roughness, material.metallic);
    if (material.metallic_roughness_texture != NO_INDEX) {
        roughness_metallic *= sample_texture(material.metallic_roughness_texture, point).gb;
    }
    if (square(roughness_metallic.x) > MIRROR_ROUGHNESS) { return vec4(color, 1.0); }
    float transmission = resolve_glass(material, point).transmission * (1.0 - roughness_metallic.y);
    mat3 m = mat3(instance.world_from_object);
    vec3 corner = mesh.positions.at[vertices.x];
    vec3 normal = cross(m * (mesh.positions.at[vertices.y] - corner), m * (mesh.positions.at[vertices.z] - corner));
    float cosine = abs(dot(safe_normalize(normal, vec3(0.0, 0.0, 1.0)), safe_normalize(direction, vec3(0.0))));
    float weight = resolve_specular_weight(material, point);
    vec3 f0 = reflectance_f0(resolve_reflectance(material, point));
    vec3 reflected = glass_tint(material.ior, weight * f0) * dielectric_fresnel(material.ior, cosine);
    if (SCENE_IRIDESCENCE && material.iridescence > 0.0) {
        ThinFilm film = resolve_film(material, point);
        reflected = mix(reflected, weight * film_fresnel(film, f0, cosine), film.weight);
    }
    vec3 through = transmission * color * (1.0 - reflected);
    if (SCENE_LAYERS) { through *= 1.0 - resolve_coat(material, point).weight * fresnel(vec3(COAT_F0), cosine).x; }
    float opacity = max(1.0 - max_component(through), 1e-3);
    return vec4(1.0 + (through / max(1.0 - opacity, 1e-9) - 1.0) / opacity, opacity);
}

// The filter color of a surface and its opacity, in w: light that passes is multiplied by mix(1, filter, opacity).
// Rays through the previous TLAS may meet instances that are hidden now, and such as are gone, which count as opaque.
vec4 resolve_filter_opacity(uint instance_index, uint triangle, vec2 barycentrics, vec3 direction, bool is_camera_ray) {
    Instance instance = instances.at[instance_index];
    Material material = materials.at[instance.material];
    bool wall = SCENE_GLASS && (material.flags & MATERIAL_WALL) != 0u && !is_camera_ray;
    if (instance.ray_mesh == NO_INDEX || !(wall || has_alpha(material))) { return vec4(1.0); }
    Mesh mesh = meshes.at[instance.ray_mesh];
    vec4 color = resolve_color_opacity(material, mesh, triangle, barycentrics);
    return wall ? resolve_thin_wall(instance, material, mesh, triangle, barycentrics, direction, color.rgb)
        : vec4(1.0, 1.0, 1.0, color.w);
}

// ---- edges ------------------------------------------------------------------------------------------

// A device may report all triangles that share the edge or corner where a ray meets a surface, though the ray meets one
// surface there.
const uint NO_EDGE = 0u;
const float EDGE_WIDTH = 1e-6;  // in barycentrics: more than their rounding error

// An instance for random numbers: the same in all worlds of a batch, unlike its row.
uint alpha_number(uint instance_index) { return instances.at[instance_index].id - 1u; }

// The edge or corner where a ray meets a triangle: 16 bits of a hash of its ends' positions, which is the same for all
// triangles that share it; NO_EDGE elsewhere.
uint hit_edge(uint instance_index, Mesh mesh, uint triangle, vec2 barycentrics) {
    vec3 weights = vec3(1.0 - barycentrics.x - barycentrics.y, barycentrics);
    if (min(weights.x, min(weights.y, weights.z)) > EDGE_WIDTH) { return NO_EDGE; }
    uvec3 vertices = mesh.triangles.at[min(triangle, mesh.triangle_count - 1u)];
    uint sum = 0u;
    for (uint i = 0u; i < 3u; i++) {
        uvec3 position = floatBitsToUint(mesh.positions.at[vertices[i]]);
        if (weights[i] > EDGE_WIDTH) { sum += pcg4d(uvec4(position, instance_index)).x; }
    }
    return 1u + sum % 0xFFFEu;
}

// ---- surfaces that rays meet ------------------------------------------------------------------------

// The seed of rays that hit every surface that isn't fully transparent.
const uvec2 EVERY_SURFACE = uvec2(0xFFFFFFFFu);

// A surface with less alpha is passed: uniform in [0, 1), and independent for each triangle, or edge between triangles.
// `alpha_seed` is the Morton code of a position in the picture, and the index of a sample there. Two van
// der Corput sequences, over places and over samples, are added modulo 1, so that aligned blocks of pixels and of
// samples cover it evenly. Each triangle and each edge takes both in an order of its own.
float alpha_threshold(uvec2 alpha_seed, uint instance_index, uint triangle, uint edge) {
    uvec2 seeds = pcg4d(uvec4(instance_index, edge == NO_EDGE ? triangle : 0u, edge, 0x5F3759DFu)).xy;
    uint of_place = bitfieldReverse(owen_scramble(alpha_seed.x, seeds.x));
    uint of_sample = bitfieldReverse(owen_scramble(alpha_seed.y, seeds.y));
    return unit_float(of_place + of_sample);
}

// Whether a ray that looks for a surface hits one of this opacity. The same seed gives the same answer for a
// triangle, and for all that share an edge or corner where the ray meets it.
bool accepts_hit(
    float opacity, uvec2 alpha_seed, uint instance_index, Mesh mesh, uint triangle, vec2 barycentrics
) {
    if (opacity >= 1.0) { return true; }
    if (!SCENE_BLEND) { return false; }
    if (alpha_seed == EVERY_SURFACE) { return opacity > 0.0; }
    uint number = alpha_number(instance_index);
    uint edge = hit_edge(number, mesh, triangle, barycentrics);
    return alpha_threshold(alpha_seed, number, triangle, edge) < opacity;
}

bool accepts_hit(float opacity, uvec2 alpha_seed, uint instance_index, uint triangle, vec2 barycentrics) {
    Mesh mesh = meshes.at[instances.at[instance_index].ray_mesh];
    return accepts_hit(opacity, alpha_seed, instance_index, mesh, triangle, barycentrics);
}

// ---- light that passes ------------------------------------------------------------------------------

// What happens to light along a segment: a ray passes all blended surfaces with a probability, and its throughput is
// then multiplied by the weight. The transmittance is weight * probability.
struct RayTransmittance {
    vec3 weight;  // transmittance over probability
    float probability;
};

const RayTransmittance FULL_TRANSMITTANCE = RayTransmittance(vec3(1.0), 1.0);

void attenuate_by_surface(inout RayTransmittance through, vec4 filter_opacity) {
    through.weight *= mix(vec3(1.0), filter_opacity.rgb, filter_opacity.w);
    through.probability *= 1.0 - filter_opacity.w;
}

// The same at a candidate of a ray, once for each edge. `passed_edges` has the latest two edges, and is 0 at first.
void attenuate_by_surface(
    inout RayTransmittance through, inout uint passed_edges, vec4 filter_opacity, uint instance_index, uint triangle,
    vec2 barycentrics
) {
    Mesh mesh = meshes.at[instances.at[instance_index].ray_mesh];
    uint edge = hit_edge(alpha_number(instance_index), mesh, triangle, barycentrics);
    if (edge != NO_EDGE) {
        if (edge == (passed_edges & 0xFFFFu) || edge == passed_edges >> 16u) { return; }
        passed_edges = passed_edges << 16u | edge;
    }
    attenuate_by_surface(through, filter_opacity);
}

#endif
