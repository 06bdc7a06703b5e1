// Rays that ask for records of the shader binding table; hit and miss shaders return their numbers.
#ifndef CONFORMANCE_RECORDS_GLSL
#define CONFORMANCE_RECORDS_GLSL

#extension GL_EXT_ray_tracing : require
#extension GL_EXT_scalar_block_layout : require

struct RecordRay {
    vec3 origin;
    uint offset;
    uint stride;
    uint miss;
};

layout(set = 0, scalar) readonly buffer RecordRays { RecordRay at[]; } record_rays;
layout(set = 0, scalar) writeonly buffer RecordsRun { uint at[]; } records_run;

#endif
