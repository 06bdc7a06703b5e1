// How much of the light at a point may have changed in recent frames, from the host's list of changed lights: no light
// is sampled and no ray is traced, so that lights that went out count too.
#ifndef PASSES_LIGHT_CHANGE_GLSL
#define PASSES_LIGHT_CHANGE_GLSL

#include "common/math.glsl"
#include "passes/bindings.glsl"

// A light that was added, removed, moved or changed in power.
struct ChangedLight {
    vec3 place;     // the center of the light
    float power;    // by which the light changed, in lumens, roughly
    float recency;  // 1 in the first frame of a change; falls to 0
};
#ifdef MANY_VIEWS
struct ChangedLights {
    uint count;
    ChangedLight at[8];
    float fraction;  // of the light: FrameValues.expected_change, without cuts of views
};
layout(set = 1, scalar) readonly buffer WorldChangesBlock { ChangedLights at[]; } world_changes;
#define changed_lights world_changes.at[world_index * views.has_own_lights]
#else
layout(set = 1, scalar) uniform ChangedLightsBlock {
    uint count;
    ChangedLight at[8];
} changed_lights;
#endif

// Values of min_recency: lights that began to change in this frame, and all in the list.
const float NEW_CHANGE = 1.0, ANY_CHANGE = 0.0;
const float MIN_VISIBLE = 0.01;  // least visible luminance, as a share of white in the picture
const float GLOBAL_OVER_DIRECT = 8.0;  // upper estimate: direct and indirect light over direct light

// The share, from 0 to 1, of the irradiance at a position that may have changed: what the changed lights send there
// without occlusion, so that the share is too large behind walls. Lights that changed less recently don't count.
float light_change(vec3 world_position, float irradiance, float min_recency) {
    irradiance = max(irradiance, PI * MIN_VISIBLE / this_frame.exposure);
    float share = 0.0;
    for (uint i = 0u; i < changed_lights.count; i++) {
        ChangedLight light = changed_lights.at[i];
        if (light.recency < min_recency) { continue; }
        vec3 offset = light.place - world_position;
        share += light.recency
            * min(GLOBAL_OVER_DIRECT * INVERSE_PI * light.power / (dot(offset, offset) * irradiance), 1.0);
    }
    return min(share, 1.0);
}

#endif
