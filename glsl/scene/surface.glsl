// The surface at a hit: geometric and shading normals, material, and a safe origin for further rays.
#ifndef SCENE_SURFACE_GLSL
#define SCENE_SURFACE_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/hit.glsl"
#include "scene/lights/choice.glsl"
#include "scene/material.glsl"
#include "scene/textures.glsl"

// A point of a triangle of an instance's ray mesh.
struct TrianglePoint {
    vec3 world_position;
    vec3 geometric_world_normal;  // on the front, where the vertices run counter-clockwise in object space
    float area;        // of the whole triangle, in world space
    float ray_offset;  // see world_ray_offset
    float extent;      // of the whole triangle, in world space: the largest coordinate of its edges
    TexturePoint texture_point;
    uvec3 vertices;
    mat3x3 object_edges;  // the first vertex, and the edges from it to the second and third
    mat3x3 normal_matrix;  // world from object for normals; does not keep their length
    float determinant;  // of world from object, without its sign
};

// Differs from Solari: tangents are made where a material asks for them, as few do.
struct SurfaceInteraction {
    vec3 world_position;
    vec3 world_normal;            // shading normal, faces the ray too
    vec3 geometric_world_normal;  // faces the ray
    float ray_offset;             // rays leave from world_position + ray_offset * geometric_world_normal
    float lift;                   // see find_lift
    float extent;                 // TrianglePoint.extent: see position_on_ray
    float area_pdf_by_power;  // of this point where lights are chosen by power; 0 when it is on no light
    bool emits_towards_ray;  // on its front, or on both sides of a double-sided material
    bool unlit;       // cameras alone see what it emits, in mirrors and through clear glass too
    ResolvedMaterial material;
};

// ---- geometry ---------------------------------------------------------------------------------------

// How far along the geometric normal a ray's origin must move so that the ray can't hit the same triangle: Woechter and
// Binder, "A Fast and Robust Method for Avoiding Self-Intersection" (Ray Tracing Gems, 2019), in the form of NVIDIA's
// error-bounded successor (2022). The distance bounds two errors, axis by axis: that of interpolating and intersecting
// the triangle in object space, whose coordinates `reach` bounds, and that of the transforms of the point to world
// space and of the ray back. A triangle at right angles to an axis has no error along it in object space, however far
// it reaches; any slope gives rays in other directions an error, for which drivers needed up to half a rounding unit
// of the reach, and have two. Without large triangles, the second error, of all that the triangle reaches, bounds both.
// Differs from Solari, which moves origins by 1 mm.
float world_ray_offset(
    vec3 reach, vec3 object_position, mat4x3 world_from_object, mat3 cofactors, vec3 object_normal
) {
    vec3 n = abs(object_normal), at = reach;
    if (SCENE_LARGE) { at = abs(object_position); }
    vec3 turned = cofactors * object_normal;
    vec3 world_reach = abs(world_from_object[0]) * at.x + abs(world_from_object[1]) * at.y
        + abs(world_from_object[2]) * at.z + abs(world_from_object[3]);
    vec3 spread = abs(cofactors[0]) * n.x + abs(cofactors[1]) * n.y + abs(cofactors[2]) * n.z;
    float bound = dot(world_reach, spread);
    if (SCENE_LARGE) {
        float sloping = n.x + n.y + n.z > max_component(n) ? 0.125 * max_component(reach) : 0.0;
        // The determinant over the length of `turned` is how far a unit along the normal reaches in world space.
        bound += (dot(reach, n) + sloping) * abs(dot(world_from_object[0], cofactors[0]));
    }
    float offset = 16.0 * ROUNDING_UNIT * bound * inversesqrt(dot(turned, turned));
    // Not 0, or the origin of a ray would be on the triangle.
    return SCENE_LARGE ? offset + ROUNDING_UNIT * max_component(world_reach) + 1e-30 : offset;
}

TrianglePoint resolve_triangle(Instance instance, Mesh mesh, uint triangle, vec2 barycentrics) {
    TrianglePoint point;
    point.vertices = mesh.triangles.at[triangle];
    vec3 corner = mesh.positions.at[point.vertices.x];
    vec3 edge_1 = mesh.positions.at[point.vertices.y] - corner;
    vec3 edge_2 = mesh.positions.at[point.vertices.z] - corner;
    point.object_edges = mat3(corner, edge_1, edge_2);

    mat4x3 m = instance.world_from_object;
    vec3 object_position = corner + barycentrics.x * edge_1 + barycentrics.y * edge_2;
    point.world_position = m * vec4(object_position, 1.0);
    // The cofactor matrix transforms normals without a division. Its sign keeps the front of mirrored instances.
    mat3 cofactors = mat3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    float determinant = dot(m[0], cofactors[0]);
    cofactors *= determinant < 0.0 ? -1.0 : 1.0;
    point.normal_matrix = cofactors;
    point.determinant = abs(determinant);

    float extent = max(max_component(abs(edge_1)), max_component(abs(edge_2)));
    point.area = point.extent = 0.0;
    vec3 object_normal = vec3(0.0, 0.0, 1.0);  // of a degenerate triangle, which no ray hits
    if (extent > 0.0) {
        vec3 unit_1 = edge_1 / extent, unit_2 = edge_2 / extent;  // so that no product underflows or overflows
        object_normal = safe_normalize(cross(unit_1, unit_2), object_normal);
        vec3 world_1 = mat3(m) * unit_1, world_2 = mat3(m) * unit_2;
        point.area = 0.5 * length(cross(world_1, world_2)) * extent * extent;
        point.extent = extent * max(max_component(abs(world_1)), max_component(abs(world_2)));
    }
    point.geometric_world_normal = safe_normalize(cofactors * object_normal, vec3(0.0, 0.0, 1.0));
    vec3 reach = abs(corner) + extent;
    if (SCENE_LARGE) { reach = abs(corner) + max(abs(edge_1), abs(edge_2)); }
    point.ray_offset = world_ray_offset(reach, object_position, m, cofactors, object_normal);
    point.texture_point = texture_point(mesh, point.vertices, barycentrics);
    return point;
}

// The point of a triangle at the end of a ray. The few bits of barycentrics are spread over the whole triangle, so that
// on large ones the ray says better where along the plane the point is. How long the ray is has a rounding error of the
// triangle's extent too, within which the plane says it better.
vec3 position_on_ray(vec3 position, vec3 geometric_normal, float extent, vec3 ray_origin, vec3 along) {
    vec3 end = ray_origin + along;
    if (!(max_component(abs(ray_origin) + abs(along)) < extent)) { return position; }
    vec3 direction = normalize(along);
    float cosine = dot(direction, geometric_normal);
    float behind = dot(position - end, geometric_normal) * cosine / max(square(cosine), 1e-12);
    float error = 8.0 * ROUNDING_UNIT * extent;
    end += clamp(behind, -error, error) * direction;
    return end - geometric_normal * dot(end - position, geometric_normal);
}

// ---- materials --------------------------------------------------------------------------------------

// Shows the base color, and reflects nothing.
void make_unlit(inout ResolvedMaterial material) {
    BaseMaterial black = make_base(vec3(0.0), vec3(0.0), material.base.perceptual_roughness, 0.0);
    black.unlit = true;
    material = without_lobes(black, material.emissive * material.base.color);
}

// ---- normals ----------------------------------------------------------------------------------------

// The tangent of a triangle along the u of a texture, for meshes without tangents that fit it, with the sign of the
// bitangent in w: in glTF the bitangent points towards smaller v. Returns w = 0 where the uvs have no area.
vec4 tangent_from_uvs(Mesh mesh, TrianglePoint point, uint texture_index, vec3 object_normal) {
    uint uv_set = texture_index == NO_INDEX ? 0u : textures.at[texture_index].uv_set;
    mat2 edges = uv_edges(mesh, point.vertices, uv_set);
    if (texture_index != NO_INDEX) { edges = mat2(textures.at[texture_index].uv_transform) * edges; }
    vec2 uv_1 = edges[0], uv_2 = edges[1];
    float side = sign(uv_1.x * uv_2.y - uv_1.y * uv_2.x);
    vec3 along_u = side * (uv_2.y * point.object_edges[1] - uv_1.y * point.object_edges[2]);
    vec3 along_v = side * (uv_1.x * point.object_edges[2] - uv_2.x * point.object_edges[1]);
    return vec4(along_u, -sign(dot(cross(object_normal, along_u), along_v)));
}

// The normal on the front side, without a normal map. A smooth normal that points to the back, as in files with
// inverted normals, is negated. vertex_normals: as the mesh has them, if it does.
vec3 resolve_smooth_normal(Mesh mesh, TrianglePoint point, vec3 weights, out mat3 vertex_normals) {
    vec3 normal = point.geometric_world_normal;
    if ((mesh.flags & MESH_HAS_NORMALS) != 0u) {
        vertex_normals = mat3(
            mesh.attributes.at[point.vertices.x].normal, mesh.attributes.at[point.vertices.y].normal,
            mesh.attributes.at[point.vertices.z].normal
        );
        normal = safe_normalize(point.normal_matrix * (vertex_normals * weights), normal);
        normal *= dot(normal, point.geometric_world_normal) < 0.0 ? -1.0 : 1.0;
    }
    return normal;
}

// How far rays start above a triangle whose smooth normals stand for a curved surface, so that neither the triangle nor
// its neighbors hide light from points of that surface: the point is moved onto the planes through the vertices that
// their normals define, where it is below them. Hanika, "Hacking the Shadow Terminator" (Ray Tracing Gems II, 2021).
// Differs from it: the distance is along the geometric normal, and bounded; it ends between 25 and 37 degrees from the
// normals of the vertices, since those of a cube and of spikes stand for no curve, and a ray that starts far off may
// start behind a wall; and light that passes has no lift. `side`: 1 on the front, -1 on the back.
const float MAX_LIFT = 0.25;  // over the square root of the triangle's area
float find_lift(TrianglePoint point, vec3 weights, mat3 vertex_normals, float side) {
    vec3 edge_1 = point.object_edges[1], edge_2 = point.object_edges[2];
    vec3 to_point = weights.y * edge_1 + weights.z * edge_2;  // from the first vertex
    mat3 normals = point.normal_matrix * vertex_normals;
    vec3 squared = vec3(dot(normals[0], normals[0]), dot(normals[1], normals[1]), dot(normals[2], normals[2]));
    vec3 inverse_lengths = inversesqrt(max(squared, 1e-30));
    vec3 cosines = point.geometric_world_normal * normals * inverse_lengths;
    // in object space, whose dot products of an edge and a normal are those in world space over the determinant
    vec3 of_vertices = vec3(0.0, dot(edge_1, vertex_normals[1]), dot(edge_2, vertex_normals[2]));
    vec3 below_planes = (of_vertices - to_point * vertex_normals) * (side * point.determinant) * inverse_lengths;
    float lift = dot(weights * max(below_planes, 0.0), cosines);
    lift *= saturate(10.0 * min(cosines.x, min(cosines.y, cosines.z)) - 8.0);
    float most = MAX_LIFT * sqrt(point.area);
    return lift > 1e-3 * most ? min(lift, most) : 0.0;  // flat ones have none, whatever rounding says
}

// Tangent, bitangent and normal of a surface with this normal, for a texture, if there is one. The tangent is 0 where
// the uvs don't define it.
mat3 resolve_tangents(
    Instance instance, Mesh mesh, TrianglePoint point, vec2 barycentrics, vec3 normal, uint texture_index
) {
    vec3 weights = vec3(1.0 - barycentrics.x - barycentrics.y, barycentrics);
    vec4 tangent;
    bool fits = mesh.tangent_frame == 0u || texture_index == NO_INDEX
        || mesh.tangent_frame == textures.at[texture_index].tangent_frame;
    if (fits && (mesh.flags & MESH_HAS_TANGENTS) != 0u) {
        tangent.xyz = weights.x * mesh.attributes.at[point.vertices.x].tangent.xyz
            + weights.y * mesh.attributes.at[point.vertices.y].tangent.xyz
            + weights.z * mesh.attributes.at[point.vertices.z].tangent.xyz;
        tangent.w = mesh.attributes.at[point.vertices.x].tangent.w;
    } else {
        tangent = tangent_from_uvs(mesh, point, texture_index, cross(point.object_edges[1], point.object_edges[2]));
    }
    mat3 m = mat3(instance.world_from_object);
    tangent.w *= sign(dot(m[0], cross(m[1], m[2])));
    tangent.xyz = m * tangent.xyz;
    tangent.xyz -= normal * dot(normal, tangent.xyz);
    vec3 along = safe_normalize(tangent.xyz, vec3(0.0));
    if (tangent.w == 0.0) { along = vec3(0.0); }
    return mat3(along, cross(normal, along) * sign(tangent.w), normal);
}

vec3 map_normal(uint texture_index, float scale, TexturePoint point, mat3 tangent_frame) {
    if (tangent_frame[0] == vec3(0.0)) { return tangent_frame[2]; }
    // z is computed from x and y, so that two-channel maps work
    vec2 xy = sample_texture(texture_index, point).xy * 2.0 - 1.0;
    vec3 mapped = vec3(scale * xy, safe_sqrt(1.0 - dot(xy, xy)));
    return safe_normalize(tangent_frame * mapped, tangent_frame[2]);
}

// Bends a shading normal towards the geometric normal until the mirror direction of wo lies above the surface; the
// result faces wo too. All BRDFs use the bent normal, so no reflection points below the geometric surface.
// Differs from Solari, which shades with normals as they are.
vec3 bend_shading_normal(vec3 normal, vec3 geometric_normal, vec3 wo) {
    float cosine = dot(geometric_normal, wo);
    float min_cosine = min(0.9 * cosine, 0.01);  // of the mirror direction to the geometric normal
    vec3 mirrored = 2.0 * dot(normal, wo) * normal - wo;
    if (dot(normal, wo) > 0.0 && dot(mirrored, geometric_normal) >= min_cosine) { return normal; }
    vec3 sideways = safe_normalize(normal - geometric_normal * dot(normal, geometric_normal), vec3(0.0));
    float along = dot(wo, sideways);
    float in_plane = length(vec2(along, cosine));
    if (!(in_plane > 0.0) || sideways == vec3(0.0)) { return geometric_normal; }
    float angle = 0.5 * (atan(along, cosine) + acos(min_cosine / in_plane));
    return cos(angle) * geometric_normal + sin(angle) * sideways;
}

// ---- hits -------------------------------------------------------------------------------------------

// Resolves the surface at a hit. `cone_width` is the width of the ray cone there: Akenine-Moeller et al., "Texture
// Level of Detail Strategies for Real-Time Ray Tracing" (Ray Tracing Gems, 2019) and "Improved Shader and Texture Level
// of Detail Using Ray Cones" (JCGT 2021).
SurfaceInteraction resolve_surface_interaction(Hit hit, Mesh mesh, vec3 ray_direction, float cone_width) {
    Instance instance = instances.at[hit.instance];
    Material material = materials.at[instance.material];
    TrianglePoint point = resolve_triangle(instance, mesh, hit.triangle, hit.barycentrics);
    // decided by the normal, not by the ray query, so that the shaded side is the visible one at grazing angles too
    bool front_face = dot(ray_direction, point.geometric_world_normal) <= 0.0;

    SurfaceInteraction surface;
    surface.world_position = point.world_position;
    surface.geometric_world_normal = front_face ? point.geometric_world_normal : -point.geometric_world_normal;
    surface.ray_offset = point.ray_offset;
    surface.extent = point.extent;
    float side = front_face ? 1.0 : -1.0;
    vec3 weights = vec3(1.0 - hit.barycentrics.x - hit.barycentrics.y, hit.barycentrics);
    mat3 vertex_normals;
    vec3 smooth_normal = resolve_smooth_normal(mesh, point, weights, vertex_normals);
    surface.lift = 0.0;
    if (SCENE_SMOOTH_NORMALS && (mesh.flags & MESH_SMOOTH_NORMALS) != 0u) {
        surface.lift = find_lift(point, weights, vertex_normals, side);
    }
    surface.area_pdf_by_power = 0.0;
    if (instance.light_index != NO_INDEX && point.area > 0.0) {
        surface.area_pdf_by_power =
            choice_probability_by_power(light_sources.at[instance.light_index], hit.triangle) / point.area;
    }
    surface.unlit = SCENE_UNLIT && (material.flags & MATERIAL_UNLIT) != 0u;
    surface.emits_towards_ray = !surface.unlit && (front_face || (material.flags & MATERIAL_DOUBLE_SIDED) != 0u);

    float surface_lod = log2(max(cone_width, 1e-30)) - 0.5 * log2(max(point.area, 1e-30));
    point.texture_point.surface_lod = surface_lod;
    point.texture_point.footprint_lod =
        has_uvs(mesh, 0u) ? footprint_lod(uv_edges(mesh, point.vertices, 0u), surface_lod) : 0.0;
    vec3 color = vertex_color(mesh, point.vertices, hit.barycentrics).rgb;
    surface.material = resolve_material(material, color, point.texture_point, front_face);
    if (transmits(surface.material)) { surface.lift = 0.0; }
    vec3 normal = smooth_normal;
    if (material.normal_texture != NO_INDEX) {
        mat3 tangents = resolve_tangents(instance, mesh, point, hit.barycentrics, normal, material.normal_texture);
        normal = map_normal(material.normal_texture, material.normal_scale, point.texture_point, tangents);
    }
    surface.world_normal = bend_shading_normal(side * normal, surface.geometric_world_normal, -ray_direction);
    if (SCENE_LAYERS) {
        vec3 coat_normal = smooth_normal;
        uint coat_map = material.clearcoat_normal_texture;
        if (coat_map != NO_INDEX) {
            mat3 tangents = resolve_tangents(instance, mesh, point, hit.barycentrics, coat_normal, coat_map);
            coat_normal = map_normal(coat_map, material.clearcoat_normal_scale, point.texture_point, tangents);
        }
        coat_normal = bend_shading_normal(side * coat_normal, surface.geometric_world_normal, -ray_direction);
        mat3 tangents = mat3(0.0);
        if (material.anisotropy > 0.0) {
            tangents = resolve_tangents(
                instance, mesh, point, hit.barycentrics, smooth_normal, material.anisotropy_texture
            );
        }
        mat3 frame = orthonormalize(surface.world_normal);
        surface.material.coat.normal = coat_normal * frame;
        surface.material.coat.surface_normal = surface.geometric_world_normal * frame;
        orient_anisotropy(surface.material.base, frame, tangents);
    }
    if (surface.unlit) {
        make_unlit(surface.material);
        if (!front_face && (material.flags & MATERIAL_DOUBLE_SIDED) == 0u) { surface.material.emissive = vec3(0.0); }
    }
    return surface;
}

SurfaceInteraction resolve_surface_interaction(Hit hit, vec3 ray_direction, float cone_width) {
    return resolve_surface_interaction(hit, meshes.at[instances.at[hit.instance].ray_mesh], ray_direction, cone_width);
}

void move_to_ray(inout SurfaceInteraction surface, vec3 ray_origin, vec3 along) {
    surface.world_position = position_on_ray(
        surface.world_position, surface.geometric_world_normal, surface.extent, ray_origin, along
    );
}

// What the surface emits towards a camera: unlit surfaces too.
vec3 shown_emission(SurfaceInteraction surface) {
    return surface.emits_towards_ray || surface.unlit ? surface.material.emissive : vec3(0.0);
}

#endif
