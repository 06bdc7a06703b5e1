// Writes the guide images for denoisers. A pixel with a mirror of metal describes the surface seen in the mirror, at
// its virtual position, and one with a thin wall of clear glass the surface seen through it: Panteleev, "Rendering
// Perfect Reflections and Refractions in Path-Traced Games" (NVIDIA, 2020).
#version 460
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/guides/bindings.glsl"
#include "passes/guides/mirrors.glsl"
#include "passes/specular_chain.glsl"
#include "passes/ray_count.glsl"
#include "scene/walk.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x4CF5AD43u;
const float FAR_AWAY = 1e6;  // the distance that stands for infinity where a position is needed
const float MOSTLY_CLEAR = 0.9;  // transmission of walls

struct Guides {
    vec3 diffuse_albedo;
    vec3 specular_albedo;
    vec3 world_normal;
    float perceptual_roughness;
    float depth;
    vec2 specular_motion;
    bool is_noisy;    // false where a mirror shows a light that reflects nothing, or no surface
    bool shows_light;
    bool is_primary;  // false where a mirror is replaced by what it shows
};

// wo: in the frame orthonormalize(shading normal)
void describe(inout Guides guides, ResolvedMaterial material, vec3 wo) {
    guides.diffuse_albedo = diffuse_color(material);
    guides.specular_albedo = lobe_albedos(material, wo).specular;  // the environment BRDF
    guides.perceptual_roughness = material.base.perceptual_roughness;
}

// Whether a surface is a wall of smooth glass that lets through at least three times what it reflects.
bool is_clear_wall(ResolvedMaterial material, float cosine) {
    BaseMaterial base = material.base;
    float reflected = dielectric_fresnel(material.glass.ior, cosine);
    if (SCENE_IRIDESCENCE && base.film.weight > 0.0) {
        float weight = SCENE_LAYERS ? base.specular_weight : 1.0;
        vec3 filmed = weight * film_fresnel(base.film, reflectance_f0(base.reflectance), cosine);
        reflected = mix(reflected, max_component(filmed), base.film.weight);
    }
    float let_through = (1.0 - reflected) * max_component(base.color);
    return is_glass(material) && !base.solid && base.roughness <= MIRROR_ROUGHNESS
        && material.glass.transmission * (1.0 - base.metallic) > MOSTLY_CLEAR && 3.0 * reflected < let_through;
}

// Follows the chain of mirrors and clear walls that starts at the pixel's surface, and describes the surface at its
// end.
Guides replace_primary_surface(GBufferSurface seen, uvec2 pixel) {
    CameraRay camera_ray = make_camera_ray(vec2(pixel) + 0.5);
    SurfaceInteraction surface;
    surface.world_position = seen.world_position;
    surface.world_normal = seen.world_normal;
    surface.geometric_world_normal = seen.geometric_world_normal;
    surface.ray_offset = seen.ray_offset;
    surface.lift = seen.lift;
    surface.material = seen.material;
    uint instance = seen.instance;
    Walk walk = start_walk(vec3(0.0), -seen.wo);
    float path_length = length(seen.world_position - camera_ray.origin);
    mat4x3 chain = mat4x3(1.0), previous_chain = mat4x3(1.0);
    vec3 previous_position;
    bool passes_light = false;
    uint rng = seed_rng(pixel, this_frame.index, this_frame.seed ^ PASS_SALT);

    for (uint i = 0u; i < MAX_DELTA_BOUNCES && instance != NO_INDEX; i++) {
        if (is_metal_mirror(surface.material)) {
            SurfacePlane mirror = SurfacePlane(surface.world_position, surface.world_normal);
            SurfacePlane before = previous_plane(instance, mirror);
            bool rested = previous_chain == chain && before == mirror;
            chain = append_mirror(chain, mirror);
            previous_chain = rested ? chain : append_mirror(previous_chain, before);
            walk.direction = normalize(reflect(walk.direction, surface.world_normal));
        } else if (!is_clear_wall(surface.material, -dot(walk.direction, surface.world_normal))) {
            break;
        }
        walk.origin = ray_origin(surface, walk.direction);
        count_ray();
        Hit hit = find_surface(walk, rng);
        passes_light = passes_light
            || max_component(
                mis_weighted_radiance_along_ray(walk.origin, walk.direction, hit.t, INFINITY, NO_MEDIUM)
            ) > 0.0;
        instance = hit.instance;
        if (instance == NO_INDEX) {
            path_length = INFINITY;
            previous_position = walk.direction * FAR_AWAY;
        } else {
            path_length += hit.t;
            float cone_width = camera_ray.cone_width + camera_ray.cone_spread * path_length;
            surface = resolve_surface_interaction(hit, walk.direction, cone_width);
            previous_position = previous_hit_position(hit, surface.world_position);
        }
    }

    Guides guides = Guides(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, 0.0, vec2(0.0), false, false, false);
    vec3 virtual_position, previous_virtual_position;
    if (instance == NO_INDEX) {
        virtual_position = camera.world_from_view[3] + mat3(chain) * (walk.direction * FAR_AWAY);
        previous_virtual_position = previous_camera.world_from_view[3] + mat3(previous_chain) * previous_position;
    } else {
        describe(guides, surface.material, -walk.direction * orthonormalize(surface.world_normal));
        bool reflects = !surface.unlit && max_component(guides.diffuse_albedo + guides.specular_albedo) > 0.0;
        guides.is_noisy = !passes_light && reflects;
        guides.shows_light = passes_light || max_component(shown_emission(surface)) > 0.0;
        guides.world_normal = mat3(chain) * surface.world_normal;
        guides.depth = camera.near / (path_length * camera_ray.depth_per_t);
        virtual_position = chain * vec4(surface.world_position, 1.0);
        previous_virtual_position = previous_chain * vec4(previous_position, 1.0);
    }
    bool rested = is_camera_static() && previous_chain == chain
        && (instance == NO_INDEX || previous_position == surface.world_position);
    bool unmoved = rested || is_orthographic(camera) && instance == NO_INDEX;  // one color, as the background by itself
    guides.specular_motion = unmoved ? vec2(0.0) : motion_vector(virtual_position, previous_virtual_position);
    return guides;
}

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    uint index;
    if (!find_pixel(pixel, index)) { return; }
    ivec2 at = texel_of(pixel);

    vec2 motion = imageLoad(motion_vectors, at).xy;
    GBufferSurface surface = load_gbuffer(pixel);
    Guides guides = Guides(vec3(0.0), vec3(0.0), vec3(0.0), 0.0, imageLoad(depth, at).x, motion, true, false, true);
    if (surface.exists) {
        vec3 wo = surface.wo * orthonormalize(surface.world_normal);
        describe(guides, surface.material, wo);
        guides.world_normal = surface.world_normal;
        bool is_wall = is_clear_wall(surface.material, wo.z);
        if ((is_wall || is_metal_mirror(surface.material)) && frame_settings.primary_surface_replacement != 0u) {
            Guides shown = replace_primary_surface(surface, pixel);
            // Lights behind glass have noise, since paths see them or what the glass reflects.
            if (!is_wall || shown.is_noisy && !shown.shows_light) { guides = shown; }
        }
    }
    imageStore(guides_diffuse_albedo, at, vec4(guides.diffuse_albedo, float(guides.is_noisy)));
    imageStore(guides_specular_albedo, at, vec4(guides.specular_albedo, float(guides.is_primary)));
    imageStore(guides_normal_roughness, at, vec4(guides.world_normal, guides.perceptual_roughness));
    imageStore(guides_depth, at, vec4(guides.depth));
    imageStore(guides_motion, at, vec4(motion, 0.0, 0.0));
    imageStore(guides_specular_motion, at, vec4(guides.specular_motion, 0.0, 0.0));
}
