// Begins the filter: the light of each lobe, and how far it may be off, from the spread over frames and over the
// nearest pixels. A value far from its neighbors counts as uncertain, since in few frames it is most often noise.
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/gradient_cell.glsl"
#include "passes/denoise/edge_stopping.glsl"
#include "passes/denoise/signal.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0xBB67AE85u;

struct Moments {
    float weight;
    float mean;
    float second_moment;
};

void add_moments(inout Moments sum, LobeHistory lobe, float weight) {
    if (lobe.frames == 0.0) { weight = 0.0; }
    sum.weight += weight;
    sum.mean += weight * luminance(lobe.radiance);
    sum.second_moment += weight * lobe.second_moment;
}

// The luminances of the reflections around a pixel.
struct Range {
    float brightest;  // the largest mean minus its standard deviation
    float darkest;    // the smallest mean plus its standard deviation
};

void extend(inout Range range, LobeHistory lobe) {
    if (lobe.frames == 0.0) { return; }
    float mean = luminance(lobe.radiance);
    float deviation = sqrt(max(lobe.second_moment - mean * mean, 0.0) / lobe.frames);
    range.brightest = max(range.brightest, mean - deviation);
    range.darkest = min(range.darkest, mean + deviation);
}

// In few frames, a pixel far brighter than its neighbors and the block around it is limited, unless these are black or
// no neighbor shows a surface like the pixel's: then it isn't noise, but a small object. The history isn't limited, so
// that this light is in the picture when more frames confirm it.
Signal begin(LobeHistory lobe, Moments sum, float block_luminance) {
    if (lobe.frames == 0.0) { return Signal(vec3(0.0), -1.0); }
    float near = sum.mean / sum.weight, value = luminance(lobe.radiance);
    float alike = sum.weight - OWN_WEIGHT, others = max(sum.mean - OWN_WEIGHT * value, 0.0) / max(alike, ALIKE);
    float settled = min(SETTLED, float(denoise_settings.frames));
    float limit = max(NEIGHBORS_LIMIT * others, BLOCK_LIMIT * lobe.frames * block_luminance);
    if (value > limit && limit > 0.0 && alike > ALIKE && lobe.frames < settled) {
        lobe.radiance *= limit / value;
        lobe.second_moment *= square(limit / value);
        near += OWN_WEIGHT * (limit - value) / sum.weight;
        value = limit;
    }
    float spread = max(sum.second_moment / sum.weight - near * near, 0.0);
    float own = max(lobe.second_moment + near * (near - 2.0 * value), 0.0);  // mean square of sample - near
    float of_sample = (NEIGHBORHOOD * spread + lobe.frames * own) / (NEIGHBORHOOD + lobe.frames);
    return Signal(lobe.radiance, sqrt(of_sample / lobe.frames));
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = ivec2(camera.size);
    if (denoise_settings.denoise == 0u || !is_inside(pixel, size)) { return; }
    uint index = pixel_index(pixel, camera.size);
    Guide guide = load_guide(pixel);
    if (guide.kind == NOTHING_SHOWN) {
        denoise_ping.at[index] = denoise_pong.at[index] = uvec4(0u, 0u, IN_BOTH << 30u, 0u);
        return;
    }
    LobeHistory own_diffuse = unpack_lobe_history(denoise_diffuse.at[index]), own_specular =
        unpack_lobe_history(denoise_specular.at[index]);
    Moments diffuse = Moments(0.0, 0.0, 0.0), specular = diffuse;
    Range range = Range(0.0, INFINITY);
    bool settled = min(own_diffuse.frames, own_specular.frames) >= SETTLED;
    bool knows_edges = !settled && own_specular.frames >= FEW_FRAMES;
    EdgeStopping edges;
    if (!settled) {
        float uncertainty = inversesqrt(max(own_specular.frames, 1.0));
        edges = make_edge_stopping(guide, uncertainty, knows_edges ? UNCERTAIN_ALPHA : NARROW_ALPHA);
    }
    for (int i = settled ? 4 : 0; i < (settled ? 5 : 9); i++) {
        ivec2 step = ivec2(i % 3, i / 3) - 1, other = pixel + step;
        ivec2 inside = clamp(other, ivec2(0), size - 1);
        uint at = pixel_index(inside, camera.size);
        vec2 weights = vec2(inside == other ? (2 - abs(step.x)) * (2 - abs(step.y)) : 0);
        if (i != 4) { weights *= edge_stopping_weights(edges, denoise_guides.at[at], step); }
        add_moments(diffuse, unpack_lobe_history(denoise_diffuse.at[at]), weights.x);
        LobeHistory reflected = unpack_lobe_history(denoise_specular.at[at]);
        add_moments(specular, reflected, weights.y);
        if (weights.x > ALIKE && i != 4) { extend(range, reflected); }
    }
    uvec4 random = pcg4d(uvec4(pixel, this_frame.index, this_frame.seed ^ PASS_SALT));
    vec2 block = denoise_blocks.at[cell_at(pixel)].luminance;
    uint state = knows_edges ? 0u : NARROW;
    Signals begun = Signals(begin(own_diffuse, diffuse, block.x), begin(own_specular, specular, block.y), state);
    // At the edge of a bright reflection samples differ since they show both of its sides, which isn't noise. With a
    // deviation no larger than the dark side's light, the blur doesn't spread the bright side's over it.
    if (knows_edges && range.brightest > luminance(own_specular.radiance)) {
        begun.specular.deviation = min(begun.specular.deviation, range.darkest);
    }
    vec2 means = vec2(diffuse.mean, specular.mean) / max(vec2(diffuse.weight, specular.weight), 1e-9);
    denoise_ping.at[index] = uvec4(pack_signals(begun, random.xyz), pack_two(means.x, means.y, random.w));
}
