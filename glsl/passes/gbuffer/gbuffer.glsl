// Packing and unpacking of the G-buffer, its surfaces in this frame and the previous one, and their similarity.
#ifndef PASSES_GBUFFER_GBUFFER_GLSL
#define PASSES_GBUFFER_GBUFFER_GLSL

#include "common/packing.glsl"
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "scene/camera.glsl"
#include "scene/surface.glsl"

const float MAX_DEPTH_DIFFERENCE = 0.1;  // relative, of what may be one surface in two frames

// The glass, layers and diffuse transmission of each pixel's surface, in scenes that have any. The previous frame's are
// not kept: its surfaces count as having none, which only the weights of reused samples depend on.
layout(set = 1, scalar) buffer GBufferLobesBlock { PackedLobes at[]; } gbuffer_lobes;

struct GBufferSurface {
    bool exists;
    uint instance;
    vec3 world_position;
    float view_depth;  // meters along the view axis, of wide lenses along the ray
    vec3 world_normal;            // shading normal, bent to face the camera
    vec3 geometric_world_normal;  // faces the camera
    // Rays leave from world_position + ray_offset * geometric_world_normal. Always 0 in surfaces of the previous frame.
    float ray_offset;
    float lift;  // likewise: scene/surface.glsl
    vec3 wo;  // to the camera
    ResolvedMaterial material;
};

// ---- packing ----------------------------------------------------------------------------------------

const uvec3 COLOR_BITS = uvec3(13u, 14u, 13u);  // the highest 8 of each are stored where Solari stores its only 8

// Differs from Solari: the bytes that it uses for occlusion or leaves unused hold five, six and five more bits of the
// base color, because 8 bits in gamma 2.2 have an error of 0.4 %, which is the largest error that direct light may
// have. Reflectance is one number, the mean of its color, which gbuffer_lobes holds. Emission is scaled by the
// exposure, so that the packed range fits what the picture shows.
uvec4 pack_gbuffer(ResolvedMaterial material, vec3 emissive, vec3 world_normal) {
    vec3 color = pow(clamp(material.base.color, 0.0, 1.0), vec3(1.0 / 2.2));
    uvec3 codes = uvec3(
        pack_unorm(color.x, COLOR_BITS.x), pack_unorm(color.y, COLOR_BITS.y), pack_unorm(color.z, COLOR_BITS.z)
    );
    uvec3 coarse = codes >> (COLOR_BITS - 8u);
    uvec3 fine = codes & ((uvec3(1u) << (COLOR_BITS - 8u)) - 1u);
    float reflectance = dot(material.base.reflectance, vec3(1.0 / 3.0));
    return uvec4(
        coarse.x | coarse.y << 8u | coarse.z << 16u | pack_unorm(material.base.perceptual_roughness, 8u) << 24u,
        pack_rgb9e5(emissive * this_frame.exposure),
        pack_unorm(reflectance, 8u) | pack_unorm(material.base.metallic, 8u) << 8u
            | fine.x << 16u | fine.y << 21u | fine.z << 27u,
        pack_octahedral_24(world_normal)
    );
}

vec3 unpack_base_color(uvec4 texel) {
    uvec3 coarse = uvec3(texel.x, texel.x >> 8u, texel.x >> 16u) & 0xFFu;
    uvec3 fine = uvec3(texel.z >> 16u, texel.z >> 21u, texel.z >> 27u) & ((uvec3(1u) << (COLOR_BITS - 8u)) - 1u);
    uvec3 codes = coarse << (COLOR_BITS - 8u) | fine;
    return pow(vec3(codes) / vec3((uvec3(1u) << COLOR_BITS) - 1u), vec3(2.2));
}

vec3 unpack_emissive(uvec4 texel) { return unpack_rgb9e5(texel.y) / this_frame.exposure; }

// Without `gbuffer_lobes`.
ResolvedMaterial unpack_material(uvec4 texel) {
    BaseMaterial base = make_base(
        unpack_base_color(texel), vec3(unpack_unorm(texel.z, 8u)), unpack_unorm(texel.x >> 24u, 8u),
        unpack_unorm(texel.z >> 8u, 8u)
    );
    return without_lobes(base, unpack_emissive(texel));
}

// ---- loading ----------------------------------------------------------------------------------------

// The offset of rays that leave a pixel's surface: also for the error of reconstructing its position from depth, and,
// where rays meet another mesh than raster draws, for that mesh, by its bounds.
float gbuffer_ray_offset(SurfaceInteraction surface, uint instance_index, float view_depth) {
    float position = max_component(abs(surface.world_position)) + view_depth;
    float offset = surface.ray_offset + 32.0 * ROUNDING_UNIT * position;
    Instance instance = instances.at[instance_index];
    if (!SCENE_PROXIES || instance.mesh == instance.ray_mesh) { return offset; }
    Mesh mesh = meshes.at[instance.ray_mesh];
    mat4x3 m = instance.world_from_object;
    mat3 cofactors = mat3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    vec3 object_normal = normalize(surface.geometric_world_normal * mat3(m));
    vec3 largest = max(abs(mesh.bounds_min), abs(mesh.bounds_max));
    vec3 reach = largest + max_component(mesh.bounds_max - mesh.bounds_min);
    return offset + world_ray_offset(reach, largest, m, cofactors, object_normal);
}

// The upper halves of two positive floats, rounded up.
uint pack_halves_up(float low, float high) {
    return (floatBitsToUint(low) + 0xFFFFu) >> 16u | (floatBitsToUint(high) + 0xFFFFu & 0xFFFF0000u);
}

GBufferSurface unpack_gbuffer(
    uvec4 texel, uvec2 surface_texel, float depth_value, vec2 position, Camera from
) {
    GBufferSurface surface;
    surface.exists = depth_value > 0.0;
    surface.instance = surface_texel.y;
    surface.view_depth = surface.exists ? from.near / depth_value : INFINITY;
    ViewRay ray = view_ray(position, from);
    vec3 start = from.world_from_view[3] + mat3(from.world_from_view) * ray.origin;
    vec3 along = mat3(from.world_from_view) * ray.direction;
    surface.world_position = start + (surface.exists ? along * surface.view_depth : vec3(0.0));
    surface.wo = -normalize(along);
    surface.geometric_world_normal = unpack_octahedral_2x16(surface_texel.x);
    // Packing rounds the normal, which may then no longer face the camera.
    surface.world_normal =
        bend_shading_normal(unpack_octahedral_24(texel.w), surface.geometric_world_normal, surface.wo);
    surface.material = unpack_material(texel);
    if (SCENE_UNLIT && surface.exists) {
        uint flags = materials.at[instances.at[surface.instance].material].flags;
        surface.material.base.unlit = (flags & MATERIAL_UNLIT) != 0u;
    }
    surface.ray_offset = surface.lift = 0.0;
    return surface;
}

GBufferSurface load_gbuffer(uvec2 pixel) {
    ivec2 at = texel_of(pixel);
    GBufferSurface surface = unpack_gbuffer(
        imageLoad(gbuffer, at), imageLoad(gbuffer_surface, at).xy, imageLoad(depth, at).x,
        vec2(pixel) + 0.5 + camera.jitter, camera
    );
    if (surface.exists) {
        uint offsets = imageLoad(gbuffer_offsets, at).x;
        surface.ray_offset = uintBitsToFloat(offsets << 16u);
        if (SCENE_SMOOTH_NORMALS) { surface.lift = uintBitsToFloat(offsets & 0xFFFF0000u); }
    }
    if (SCENE_LOBES && surface.exists) {
        PackedLobes packed = gbuffer_lobes.at[element_index(pixel, camera.size)];
        surface.material =
            unpack_lobes(surface.material, packed, surface.world_normal, surface.geometric_world_normal);
    }
    return surface;
}

// The surface that a pixel of the previous frame showed, at its position in that frame.
GBufferSurface load_previous_gbuffer(uvec2 pixel) {
    ivec2 at = texel_of(pixel);
    return unpack_gbuffer(
        imageLoad(previous_gbuffer, at), imageLoad(previous_gbuffer_surface, at).xy, imageLoad(previous_depth, at).x,
        vec2(pixel) + 0.5 + previous_camera.jitter, previous_camera
    );
}

// ---- between frames ---------------------------------------------------------------------------------

// Whether joints or morph targets moved the vertices of a mesh since the previous frame.
bool changes_pose(Mesh mesh) { return SCENE_POSES && uvec2(mesh.previous_positions) != uvec2(mesh.positions); }

// The same for the mesh that an instance shows.
bool has_new_pose(uint instance_index) {
    if (!SCENE_POSES || instance_index == NO_INDEX) { return false; }
    uint mesh = instances.at[instance_index].mesh;
    return mesh != NO_INDEX && changes_pose(meshes.at[mesh]);
}

// Whether an instance was there in the previous frame and is where it was, with a mesh of its in the same pose.
bool is_mesh_static(uint instance_index, Mesh mesh) {
    PreviousInstance before = previous_instances.at[instance_index];
    Instance now = instances.at[instance_index];
    return now.id == before.id && now.world_from_object == before.world_from_object && !changes_pose(mesh);
}

bool is_static(uint instance_index) {
    uint mesh = instances.at[instance_index].mesh;
    return mesh != NO_INDEX && is_mesh_static(instance_index, meshes.at[mesh]);
}

// Whether nothing moved since the previous frame but, for depth of field, the point of the lens through which this
// frame sees all.
bool only_lens_sample_moved(uint instance_index) {
    return camera.lens_radius > 0.0 && previous_camera.lens_radius == camera.lens_radius
        && previous_camera.focus_distance == camera.focus_distance
        && previous_camera.world_from_view == camera.world_from_view
        && previous_camera.tan_half_fov == camera.tan_half_fov
        && previous_camera.principal_shift == camera.principal_shift
        && (instance_index == NO_INDEX || is_static(instance_index));
}

// The point of a hit in object space. positions: those of the mesh, or its previous ones, from which the result is the
// same bit by bit if they are equal.
vec3 interpolate_position(const Positions positions, Mesh mesh, Hit hit) {
    uvec3 corners = mesh.triangles.at[hit.triangle];
    precise vec3 position = (1.0 - hit.barycentrics.x - hit.barycentrics.y) * positions.at[corners.x]
        + hit.barycentrics.x * positions.at[corners.y] + hit.barycentrics.y * positions.at[corners.z];
    return position;
}

// The position of a hit point of an instance's mesh in the previous frame; `world_position` when the instance is static
// or is new.
vec3 previous_world_position(Hit hit, Mesh mesh, vec3 object_position, vec3 world_position) {
    PreviousInstance previous = previous_instances.at[hit.instance];
    if (previous.id != instances.at[hit.instance].id || is_mesh_static(hit.instance, mesh)) {
        return world_position;
    }
    if (changes_pose(mesh)) { object_position = interpolate_position(mesh.previous_positions, mesh, hit); }
    precise vec3 position = previous.world_from_object * vec4(object_position, 1.0);
    return position;
}

// Exactly 0 for what is static, also where a compiler rounds the two projections differently.
vec2 motion_vector(vec3 world_position, vec3 previous_world_position) {
    if (previous_world_position == world_position && is_camera_static()) { return vec2(0.0); }
    return shorter_way(project_to_uv(previous_world_position, previous_camera) - project_to_uv(world_position, camera));
}

vec2 hit_motion_vector(Hit hit, Mesh mesh) {
    vec3 object_position = interpolate_position(mesh.positions, mesh, hit);
    // Both positions are computed from the object-space position in the same way, also by compilers that fuse
    // operations (`precise`), so that rounding gives no motion to parts of a posed mesh that stay.
    precise vec3 now = instances.at[hit.instance].world_from_object * vec4(object_position, 1.0);
    return motion_vector(now, previous_world_position(hit, mesh, object_position, now));
}

// The background is infinitely far, so only the camera's rotation moves it. In orthographic projections it has one
// color.
vec2 background_motion_vector(CameraRay ray) {
    vec3 far = camera.world_from_view[3] + ray.direction * 1e6;
    vec3 previous_far = previous_camera.world_from_view[3] + ray.direction * 1e6;
    return is_orthographic(camera) || is_camera_static() ? vec2(0.0) : motion_vector(far, previous_far);
}

// The position in the previous picture, in pixels with centers at + 0.5, of the point that a pixel shows now.
vec2 reproject(uvec2 pixel) {
    vec2 motion = imageLoad(motion_vectors, texel_of(pixel)).xy;
    vec2 jitter = camera.jitter - camera.principal_shift;
    vec2 previous_jitter = previous_camera.jitter - previous_camera.principal_shift;
    return vec2(pixel) + 0.5 + jitter + motion * vec2(camera.size) - previous_jitter;
}

// Returns whether two surfaces are close enough to share samples.
bool are_similar(GBufferSurface a, GBufferSurface b) {
    float plane_distance = abs(dot(b.world_position - a.world_position, a.world_normal));
    return a.exists && b.exists && plane_distance <= reuse_settings.similarity_plane_distance * a.view_depth
        && dot(a.world_normal, b.world_normal) >= reuse_settings.similarity_normal_cosine;
}

#endif
