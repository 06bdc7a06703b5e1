// What the functions of a lobe return that scene/brdf.glsl calls for each lobe of scene/lobes/list.glsl.
#ifndef SCENE_LOBES_INTERFACE_GLSL
#define SCENE_LOBES_INTERFACE_GLSL

#include "common/math.glsl"

// The share of uniform incoming light that a lobe reflects towards a direction: color times share.
struct LobeAlbedo {
    vec3 color;
    float share;
    bool diffuse;  // of which kind it is
};

// A direction that a lobe samples.
struct LobeSample {
    vec3 wi;
    bool valid;
    bool diffuse;  // of which kind its value is
    // Of a delta lobe alone: the value over the probability of wi is color times share; 0 otherwise.
    bool delta;
    vec3 color;
    float share;
};

LobeSample invalid_lobe_sample() { return LobeSample(vec3(0.0), false, false, false, vec3(0.0), 0.0); }
LobeSample spread_sample(vec3 wi, bool diffuse) { return LobeSample(wi, true, diffuse, false, vec3(0.0), 0.0); }
LobeSample mirrored_sample(vec3 wi, vec3 color, float share) { return LobeSample(wi, true, false, true, color, share); }

#endif
