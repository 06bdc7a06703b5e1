// The ray queries of the wgpu ray tracing document over GL_EXT_ray_query: its functions, structures, flags and kinds,
// under its names. They work with any acceleration structure, not only the renderer's scene, and the shader decides
// about candidates.
//
//     RAY_QUERY(query);
//     rayQueryInitialize(query, tlas, RayDesc(RAY_FLAG_NONE, SCENE_MASK, t_min, t_max, origin, dir));
//     while (rayQueryProceed(query)) {
//         RayIntersection candidate = rayQueryGetCandidateIntersection(query);
//         if (candidate.kind == RAY_QUERY_INTERSECTION_AABB) { rayQueryGenerateIntersection(query, t); }
//         else { rayQueryConfirmIntersection(query); }
//     }
//     RayIntersection hit = rayQueryGetCommittedIntersection(query);
//
// SCENE_MASK, of scene/bindings.glsl, is for the `tlas` of a SceneFrame, where 0xFFu hits hidden instances too.
//
// Calls that the document discards, such as those of a query that wasn't initialized, do nothing, and what they return
// is zero; an invalid ray hits nothing. With the header `#define RAY_QUERY_DEBUG` a pass counts them in
// `ray_query_faults`, which `solari_vk.renderers.rt.check_ray_queries` reads. A function takes a query by
// `void look(RAY_QUERY_PARAMETER(query))` and is called by `look(RAY_QUERY_ARGUMENT(query))`.
// Differs from wgpu: a macro declares queries, because GLSL can't store a query in a structure beside its state.
#ifndef SCENE_RAY_QUERY_GLSL
#define SCENE_RAY_QUERY_GLSL

#extension GL_EXT_ray_query : require
#extension GL_EXT_ray_flags_primitive_culling : require
#extension GL_EXT_scalar_block_layout : require

#include "scene/ray_desc.glsl"

layout(primitive_culling);  // SKIP_TRIANGLES and SKIP_AABBS need it; every device with ray queries supports it

struct RayIntersection {
    uint kind;  // RAY_QUERY_INTERSECTION_NONE: the other fields are zero
    float t;    // 0 for a candidate box
    uint instance_custom_data;
    uint instance_index;
    uint sbt_record_offset;
    uint geometry_index;
    uint primitive_index;
    vec2 barycentrics;  // of triangles: weights of the second and third vertex
    bool front_face;    // of triangles
    mat4x3 object_to_world;
    mat4x3 world_to_object;
};

// ---- over GL_EXT_ray_query ---------------------------------------------------------------------------

uint ray_query_committed_kind(rayQueryEXT query) {
    return rayQueryGetIntersectionTypeEXT(query, true);  // Vulkan numbers these three kinds as the document does
}

uint ray_query_candidate_kind(rayQueryEXT query) {
    bool triangle = rayQueryGetIntersectionTypeEXT(query, false) == gl_RayQueryCandidateIntersectionTriangleEXT;
    return triangle ? RAY_QUERY_INTERSECTION_TRIANGLE : RAY_QUERY_INTERSECTION_AABB;
}

RayIntersection ray_query_no_intersection() {
    RayIntersection nothing;
    nothing.kind = RAY_QUERY_INTERSECTION_NONE;
    nothing.t = 0.0;
    nothing.instance_custom_data = nothing.instance_index = nothing.sbt_record_offset = 0u;
    nothing.geometry_index = nothing.primitive_index = 0u;
    nothing.barycentrics = vec2(0.0);
    nothing.front_face = false;
    nothing.object_to_world = nothing.world_to_object = mat4x3(0.0);
    return nothing;
}

// COMMITTED selects the committed or the candidate intersection; Vulkan requires a constant.
#define RAY_QUERY_DEFINE_GETTER(NAME, COMMITTED, KIND) \
    RayIntersection NAME(rayQueryEXT query) { \
        RayIntersection found = ray_query_no_intersection(); \
        found.kind = KIND; \
        if (found.kind == RAY_QUERY_INTERSECTION_NONE) { return found; } \
        found.instance_custom_data = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, COMMITTED)); \
        found.instance_index = uint(rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED)); \
        found.sbt_record_offset = rayQueryGetIntersectionInstanceShaderBindingTableRecordOffsetEXT(query, COMMITTED); \
        found.geometry_index = uint(rayQueryGetIntersectionGeometryIndexEXT(query, COMMITTED)); \
        found.primitive_index = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, COMMITTED)); \
        found.object_to_world = rayQueryGetIntersectionObjectToWorldEXT(query, COMMITTED); \
        found.world_to_object = rayQueryGetIntersectionWorldToObjectEXT(query, COMMITTED); \
        if (found.kind != RAY_QUERY_INTERSECTION_AABB) { found.t = rayQueryGetIntersectionTEXT(query, COMMITTED); } \
        if (found.kind == RAY_QUERY_INTERSECTION_TRIANGLE) { \
            found.barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, COMMITTED); \
            found.front_face = rayQueryGetIntersectionFrontFaceEXT(query, COMMITTED); \
        } \
        return found; \
    }
RAY_QUERY_DEFINE_GETTER(ray_query_committed, true, ray_query_committed_kind(query))
RAY_QUERY_DEFINE_GETTER(ray_query_candidate, false, ray_query_candidate_kind(query))

// Replaces a ray that breaks a rule: its mask matches no instance.
const RayDesc RAY_QUERY_NO_RAY = RayDesc(RAY_FLAG_NONE, 0u, 0.0, 0.0, vec3(0.0), vec3(0.0, 0.0, 1.0));

// Generating a hit behind the committed one is an error in Vulkan, and without effect in the document.
void ray_query_generate(rayQueryEXT query, float hit_t) {
    bool none = ray_query_committed_kind(query) == RAY_QUERY_INTERSECTION_NONE;
    if (none || hit_t <= rayQueryGetIntersectionTEXT(query, true)) { rayQueryGenerateIntersectionEXT(query, hit_t); }
}

#ifdef RAY_QUERY_VERTEX_RETURN
// The vertices of a hit triangle in object space. GLSL compilers before 2023 don't know the extension by name.
#extension GL_EXT_spirv_intrinsics : require
spirv_instruction(extensions = ["SPV_KHR_ray_tracing_position_fetch"], capabilities = [5391], id = 5340)
vec3[3] ray_query_positions(spirv_by_reference rayQueryEXT query, int committed);
#endif

// ---- the document's functions -----------------------------------------------------------------------

#include "scene/ray_query_state.glsl"

#endif
