// What each invocation of a launch is told, in its ray generation shader and in the miss shader of its ray.
#ifndef CONFORMANCE_LAUNCH_GLSL
#define CONFORMANCE_LAUNCH_GLSL

#extension GL_EXT_ray_tracing : require
#extension GL_EXT_scalar_block_layout : require

struct Told {
    uvec3 id;
    uvec3 size;
};

struct Launched {
    uint count;  // of invocations
    Told generation;
    Told miss;
};

#endif
