// Rays through a box whose intersection shader reports several hits, or through several boxes that report one each.
#ifndef CONFORMANCE_REPORT_GLSL
#define CONFORMANCE_REPORT_GLSL

#extension GL_EXT_ray_tracing : require
#extension GL_EXT_scalar_block_layout : require

const uint REPORT_COUNT = 3u;
const int SEVERAL_BOXES = 1;    // the custom index of their instance
const uint IGNORED_KIND = 127u;  // the any-hit shader ignores hits of this kind

struct ReportRay {
    vec3 origin;
    float t_min;
    float t_max;
    float t[REPORT_COUNT];
    uint kind[REPORT_COUNT];
};

struct Reported {
    uint accepted;    // bit i: reportIntersectionEXT returned true for report i
    uint any_hits;    // any-hit shaders that got the attributes of their report
    float t;          // of the closest hit; -1 for a miss
    uint kind;
    vec4 attributes;
};

layout(set = 0, scalar) readonly buffer ReportRays { ReportRay at[]; } report_rays;
layout(set = 0, scalar) buffer ReportedBlock { Reported at[]; } reported;

vec4 attributes_of(float t, uint kind) { return vec4(t, -t, float(kind), 0.25 * t + float(kind)); }

#endif
