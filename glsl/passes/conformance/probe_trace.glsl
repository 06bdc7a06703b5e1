// What the ray generation shaders of probes do.
#ifndef PASSES_CONFORMANCE_PROBE_TRACE_GLSL
#define PASSES_CONFORMANCE_PROBE_TRACE_GLSL

layout(set = 0) uniform accelerationStructureEXT tlas;
layout(location = 0) rayPayloadEXT uint ended;

void main() {
    Probe probe = probes.at[gl_LaunchIDEXT.x];
    ended = ENDED_NOWHERE;
    traceRayEXT(tlas, probe.flags, probe.cull_mask, 0u, 0u, 0u, probe.origin, probe.t_min, probe.direction,
                probe.t_max, 0);
    RAY_ANSWER.ended = ended;
}

#endif
