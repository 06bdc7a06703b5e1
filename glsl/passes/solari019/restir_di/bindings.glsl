// The reservoirs of direct light, one per pixel.
#ifndef PASSES_SOLARI019_RESTIR_DI_BINDINGS_GLSL
#define PASSES_SOLARI019_RESTIR_DI_BINDINGS_GLSL

#include "passes/bindings.glsl"
#include "passes/solari019/restir_di/reservoir.glsl"

// The first half reads those of the previous frame, the second half replaces them.
layout(set = 1, scalar) buffer DiReservoirsBlock { DiReservoir at[]; } di_reservoirs;
layout(set = 1, scalar) buffer DiTemporalReservoirsBlock { DiReservoir at[]; } di_temporal_reservoirs;

// For debug views: the index of the spatial neighbor, or NO_INDEX when none was found; whether the chosen light is
// visible.
layout(set = 1, scalar) buffer DiOutcomesBlock { uvec2 at[]; } di_outcomes;

#endif
