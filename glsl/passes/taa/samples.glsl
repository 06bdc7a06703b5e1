// This frame's samples, one for each rendered pixel, and what they tell of a pixel of the picture.
#ifndef PASSES_TAA_SAMPLES_GLSL
#define PASSES_TAA_SAMPLES_GLSL

#include "common/math.glsl"
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/guides/bindings.glsl"
#include "passes/taa/constants.glsl"

// Radiance, if there is any.
struct NearestSample {
    vec3 radiance;
    bool exists;
};

const NearestSample NO_NEAREST_SAMPLE = NearestSample(vec3(0.0), false);

// Rendered pixels for each pixel of the picture.
vec2 render_scale() { return vec2(camera.size) / vec2(camera.picture_size); }

// Whether pixels have strata: strata.glsl. Those of upscaled pictures don't, since most have no sample in a frame.
bool has_strata() { return camera.size == camera.picture_size; }

// Where a position of the picture lies among the samples, of which the first is at 0.
vec2 among_samples(vec2 position) { return position * render_scale() - 0.5 - this_frame.sample_jitter; }

vec3 load_sample(ivec2 pixel) { return sample_radiance.at[element_index(pixel, camera.size)]; }

// The sample inside a pixel of the picture. There is at most one, and always one when nothing is upscaled.
NearestSample find_own_sample(ivec2 at) {
    ivec2 pixel = ivec2(ceil(among_samples(vec2(at))));
    bool inside = all(lessThan(vec2(pixel), among_samples(vec2(at + 1)))) && is_inside(pixel, camera.size);
    return inside ? NearestSample(load_sample(pixel), true) : NO_NEAREST_SAMPLE;
}

// ---- the samples around a pixel of the picture --------------------------------------------------------

// Luminance and two differences of colors: Malvar and Sullivan, "YCoCg-R" (2003).
vec3 to_ycocg(vec3 c) { return mat3(0.25, 0.5, -0.25, 0.5, 0.0, 0.5, 0.25, -0.5, -0.25) * c; }
vec3 from_ycocg(vec3 c) { return vec3(c.x + c.y - c.z, c.x + c.z, c.x - c.y - c.z); }

// 3 x 3 samples.
struct Neighborhood {
    ivec2 center;
    ivec2 nearest;   // to the camera
    vec3 mean;       // YCoCg
    vec3 deviation;
    float count;     // of valid samples
};

// The sample that is nearest to the center of a pixel of the picture.
ivec2 find_center(ivec2 at) {
    return clamp(ivec2(round(among_samples(vec2(at) + 0.5))), ivec2(0), ivec2(camera.size) - 1);
}

Neighborhood find_neighborhood(ivec2 at) {
    Neighborhood found;
    found.center = find_center(at);
    found.nearest = found.center;
    float depth = imageLoad(guides_depth, texel_of(found.center)).x;
    vec3 sum = vec3(0.0), squares = vec3(0.0);
    found.count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = found.center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size)) { continue; }
        float other = imageLoad(guides_depth, texel_of(pixel)).x;
        if (other > depth) {
            depth = other;
            found.nearest = pixel;
        }
        vec3 radiance = load_sample(pixel);
        if (!is_finite_color(radiance)) { continue; }
        vec3 color = to_ycocg(radiance);
        sum += color;
        squares += color * color;
        found.count += 1.0;
    }
    found.mean = sum / max(found.count, 1.0);
    found.deviation = sqrt(max(squares / max(found.count, 1.0) - found.mean * found.mean, vec3(0.0)));
    return found;
}

// Lowers the weight of bright radiance in interpolations by how much it exceeds what is around, or lamps would bleed
// into what is dark: Karis, "High Quality Temporal Supersampling" (2014).
float tone_weight(vec3 found, Neighborhood around) {
    return around.mean.x > 0.0 ? around.mean.x / (around.mean.x + luminance(found)) : 1.0;
}

// Whether two samples show the same surface, by themselves or in mirrors.
bool show_the_same(ivec2 a, ivec2 b) {
    float depth = imageLoad(guides_depth, texel_of(a)).x, other = imageLoad(guides_depth, texel_of(b)).x;
    vec3 normal = imageLoad(guides_normal_roughness, texel_of(a)).xyz;
    return abs(depth - other) < MAX_DEPTH_DIFFERENCE * max(depth, other)
        && dot(normal, imageLoad(guides_normal_roughness, texel_of(b)).xyz) > MIN_NORMAL_COSINE;
}

// A sample with a share of those around it, by a Gaussian that is narrower the more samples the pixel's mean has: one
// sample tells whether an edge is there, its neighbors how much of the pixel it covers. Two samples exchange light, but
// less if one is far brighter, so that lamps keep theirs and don't bleed into what is dark. Of the same surface later
// samples exchange less: the denoiser has averaged its light over the pixel. Whether a sample shows a blended surface
// is chance, so that the Gaussian is wider there, and light is exchanged without a limit.
vec3 soften(ivec2 pixel, ivec2 at, float samples, bool blended) {
    vec2 where = among_samples(vec2(at) + 0.5);
    vec3 own = load_sample(pixel), exchanged = vec3(0.0);
    float total = 0.0, own_luminance = luminance(own);
    float narrowness = 0.5 * sqrt(samples) / square(blended ? SOFTNESS_OF_BLENDED : SOFTNESS);
    for (int i = 0; i < 9; i++) {
        ivec2 other = pixel + ivec2(i % 3, i / 3) - 1;
        vec2 apart = (vec2(other) - where) / render_scale();
        float weight = exp(-narrowness * dot(apart, apart));
        total += weight;
        if (!is_inside(other, camera.size)) { continue; }
        vec3 found = load_sample(other);
        if (!is_finite_color(found)) { continue; }
        float found_luminance = luminance(found), brighter = max(found_luminance, own_luminance);
        float limit = show_the_same(pixel, other) ? 1.0 + (EXCHANGED_ON_SURFACE - 1.0) / samples : EXCHANGED;
        float alike = min(limit * min(found_luminance, own_luminance) / max(brighter, 1e-30), 1.0);
        exchanged += (blended ? weight : weight * alike) * (found - own);
    }
    return own + exchanged / total;
}

float sinc(float x) { return abs(x) < 1e-4 ? 1.0 : sin(PI * x) / (PI * x); }

float lanczos(float x) { return abs(x) < 2.0 ? sinc(x) * sinc(0.5 * x) : 0.0; }

// The radiance at the center of a pixel of the picture, by Lanczos interpolation: Duchon, "Lanczos Filtering in One and
// Two Dimensions" (1979). It stays within the range of the nearest samples, so that edges have no rings.
NearestSample interpolate(ivec2 at, Neighborhood around) {
    vec2 where = among_samples(vec2(at) + 0.5);
    ivec2 corner = ivec2(floor(where));
    vec3 sum = vec3(0.0), low = vec3(INFINITY), high = vec3(0.0);
    float total = 0.0;
    for (int i = 0; i < 16; i++) {
        ivec2 step = ivec2(i & 3, i >> 2) - 1, pixel = clamp(corner + step, ivec2(0), ivec2(camera.size) - 1);
        vec2 apart = vec2(corner + step) - where;
        vec3 found = load_sample(pixel);
        if (!is_finite_color(found)) { continue; }
        float weight = lanczos(apart.x) * lanczos(apart.y) * tone_weight(found, around);
        sum += weight * found;
        total += weight;
        if (all(lessThan(abs(apart), vec2(1.0)))) {
            low = min(low, found);
            high = max(high, found);
        }
    }
    if (!(total > 0.0) || low.x > high.x) { return NO_NEAREST_SAMPLE; }
    return NearestSample(clamp(sum / total, low, high), true);
}

#endif
