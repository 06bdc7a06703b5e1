// Finds where light changed: where the mean of the latest frames differs from that of all frames by more than its noise,
// over a block of pixels. The next frame keeps histories by as much as they are still valid. Signed differences are
// summed, so that noise averages out; Schied et al., "Gradient Estimation for Real-Time Adaptive Temporal Filtering"
// (HPG 2018) has the exponent.
#version 460
#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const int BLOCK = 12, STEP = 2;      // width of a block in pixels; every second pixel is read
const float MIN_LENGTH = 3.0;        // shorter histories tell nothing
const float RECENT_VARIANCE = 0.111; // of the mean of the latest frames over that of a frame: 0.2 / (2 - 0.2)
const float CERTAIN = 3.0;           // standard deviations that may be noise
const float EXPONENT = 8.0;

struct Difference {
    float signed_sum;
    float variance;
    float largest;
};

void add_difference(inout Difference sum, Lobe lobe) {
    if (lobe.frames < MIN_LENGTH) { return; }
    float mean = luminance(lobe.radiance);
    sum.signed_sum += lobe.recent - mean;
    sum.variance += RECENT_VARIANCE * max(lobe.second_moment - mean * mean, 0.0);
    sum.largest += max(lobe.recent, mean);
}

float confidence(Difference sum) {
    float certain = max(abs(sum.signed_sum) - CERTAIN * sqrt(sum.variance), 0.0);
    return sum.largest > 0.0 ? pow(1.0 - min(certain / sum.largest, 1.0), EXPONENT) : 1.0;
}

void main() {
    uvec2 cell = gl_GlobalInvocationID.xy, cells = (camera.size + CHANGE_CELL - 1u) / CHANGE_CELL;
    if (denoise_settings.denoise == 0u || any(greaterThanEqual(cell, cells))) { return; }
    ivec2 first = ivec2(cell * CHANGE_CELL) - (BLOCK - int(CHANGE_CELL)) / 2;
    ivec2 begin = max(first, ivec2(0)), end = min(first + BLOCK, ivec2(camera.size));
    Difference diffuse = Difference(0.0, 0.0, 0.0), specular = diffuse;
    for (int y = begin.y; y < end.y; y += STEP) {
        for (int x = begin.x; x < end.x; x += STEP) {
            uint index = uint(y) * camera.size.x + uint(x);
            add_difference(diffuse, unpack_lobe(denoise_diffuse.at[index]));
            add_difference(specular, unpack_lobe(denoise_specular.at[index]));
        }
    }
    denoise_confidence.at[cell.y * cells.x + cell.x] = vec2(confidence(diffuse), confidence(specular));
}
