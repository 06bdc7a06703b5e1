// Where a pixel's surface was in the previous frame, and which pixels of that frame showed it.
#ifndef PASSES_DENOISE_PREVIOUS_FRAME_GLSL
#define PASSES_DENOISE_PREVIOUS_FRAME_GLSL

#include "common/pixel.glsl"
#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/guides/mirrors.glsl"

// Whether a frame may trace no path for some of its pixels, which then may have no history.
layout(constant_id = skips_pixels_id) const bool skips_pixels = false;

// A surface in the previous frame.
struct PreviousSurface {
    vec2 pixel;     // in pixels without jitter; centers are at + 0.5
    vec3 position;  // relative to the previous camera
    vec3 normal;
    // Whether position and normal are those of the previous frame. Else, for PSR surfaces and for meshes that skinning
    // or morph targets have deformed, they are this frame's, and is_consistent compares depths.
    bool has_plane;
};

// Pixels of the previous frame with their weights.
struct Taps {
    uint indices[16];
    float weights[16];
    int count;
    float weight;  // sum of `weights`, by which what is read is divided; 0 without taps
    float normal_deviation;  // sum of |weight| (1 - the cosine between their normals and the surface's)
};

// Converts motion from uv to pixels of the rendered frame. Adds the shift of the whole picture by a change of the
// jitter that the user gives the camera. The sample jitter is no motion.
vec2 motion_in_pixels(vec2 motion) {
    return (motion + this_frame.user_jitter_change / vec2(camera.picture_size)) * vec2(camera.size);
}

// The pixel of the previous frame that shows what this pixel shows, without jitter; exactly the same pixel when neither
// the camera nor the point moved. Both positions are relative to the cameras of their frames.
vec2 previous_pixel(vec3 position, vec3 previous_position, ivec2 pixel) {
    vec3 now = position + camera.world_from_view[3], before = previous_position + previous_camera.world_from_view[3];
    return vec2(pixel) + 0.5 + motion_in_pixels(motion_vector(now, before));
}

PreviousSurface find_previous_surface(ivec2 pixel, Guide guide) {
    // Surface motion, of both lobes, in spite of the image's name: that of the primary surface, or of the PSR surface's
    // virtual position.
    vec2 motion = motion_in_pixels(imageLoad(guides_specular_motion, texel_of(pixel)).xy);
    uint instance = imageLoad(gbuffer_surface, texel_of(pixel)).y;
    bool has_plane = guide.kind == PRIMARY_SURFACE && !has_new_pose(instance);
    // With depth of field each frame looks through another point of the lens. The history averages over these points as
    // over the positions within a pixel: their parallax isn't motion.
    if (only_lens_sample_moved(instance)) {
        return PreviousSurface(
            vec2(pixel) + 0.5 + motion_in_pixels(vec2(0.0)), guide.position, guide.normal, has_plane
        );
    }
    bool moved = motion != vec2(0.0) || previous_camera.world_from_view != camera.world_from_view;
    if (!has_plane || !moved) {
        return PreviousSurface(vec2(pixel) + 0.5 + motion, guide.position, guide.normal, has_plane);
    }
    vec3 origin = camera.world_from_view[3];
    SurfacePlane plane = previous_plane(instance, SurfacePlane(origin + guide.position, guide.normal));
    vec3 position = plane.point - previous_camera.world_from_view[3];
    return PreviousSurface(previous_pixel(guide.position, position, pixel), position, plane.normal, true);
}

// Whether a pixel of the previous frame showed the same surface.
bool is_consistent(Guide previous_guide, PreviousSurface previous, Guide guide, float plane_distance) {
    if (previous_guide.kind != guide.kind) { return false; }
    bool near = previous.has_plane
        ? abs(dot(previous_guide.position - previous.position, previous.normal))
            < plane_distance * pixel_width(previous_guide.depth)
        : abs(previous_guide.depth - guide.depth) < MAX_DEPTH_DIFFERENCE * guide.depth;
    return near && dot(previous_guide.normal, previous.normal) > MIN_NORMAL_COSINE
        && abs(previous_guide.roughness_or_albedo - guide.roughness_or_albedo) < MAX_MATERIAL_DIFFERENCE;
}

Taps no_taps() {
    Taps taps;  // arrays stay undefined beyond `count`
    taps.count = 0;
    taps.weight = taps.normal_deviation = 0.0;
    return taps;
}

void add_tap(inout Taps taps, ivec2 pixel, float weight, PreviousSurface previous, Guide guide, float plane_distance) {
    if (abs(weight) < 1e-3 || !is_inside(pixel, camera.size)) { return; }
    Guide previous_guide = load_previous_guide(pixel);
    if (!is_consistent(previous_guide, previous, guide, plane_distance)) { return; }
    uint index = element_index(pixel, camera.size);
    if (skips_pixels && unpack_lobe_history(previous_denoise_diffuse.at[index]).frames == 0.0) { return; }
    taps.indices[taps.count] = index;
    taps.weights[taps.count] = weight;
    taps.count += 1;
    taps.weight += weight;
    // |weight|: Catmull-Rom reproduces quadratics, so that its signed weights would sum 1 - cosine to about 0.
    taps.normal_deviation += abs(weight) * (1.0 - dot(normalize(previous_guide.normal), previous.normal));
}

// The taps around a position that showed the surface: with Catmull-Rom weights, which keep reprojected light sharp, or
// bilinear ones where some of the taps showed another surface.
Taps find_taps(vec2 position, PreviousSurface previous, Guide guide, float plane_distance) {
    ivec2 corner = ivec2(floor(position - 0.5));
    vec2 fraction = position - 0.5 - vec2(corner);
    Taps taps = no_taps();
    if (max(fraction.x, fraction.y) < 1e-3) {  // nothing moved
        add_tap(taps, corner, 1.0, previous, guide, plane_distance);
        return taps;
    }
    vec4 across = catmull_rom_weights(fraction.x), down = catmull_rom_weights(fraction.y);
    for (int i = 0; i < 16; i++) {
        ivec2 step = ivec2(i & 3, i >> 2);
        add_tap(taps, corner + step - 1, across[step.x] * down[step.y], previous, guide, plane_distance);
    }
    if (abs(taps.weight - 1.0) < MAX_TAP_WEIGHT_ERROR) { return taps; }
    taps = no_taps();
    for (int i = 0; i < 4; i++) {
        ivec2 step = ivec2(i & 1, i >> 1);
        vec2 weights = mix(1.0 - fraction, fraction, vec2(step));
        add_tap(taps, corner + step, weights.x * weights.y, previous, guide, plane_distance);
    }
    return taps;
}

void add_history(inout LobeHistory sum, LobeHistory found, float weight) {
    sum.radiance += weight * found.radiance;
    sum.second_moment += weight * found.second_moment;
    sum.fast_luminance += weight * found.fast_luminance;
    sum.frames += weight * found.frames;
    sum.inverse_hit_distance += weight * found.inverse_hit_distance;
}

// Catmull-Rom weights may be negative, so that the sum overshoots beyond what is possible.
LobeHistory without_overshoot(LobeHistory lobe) {
    vec3 radiance = max(lobe.radiance, vec3(0.0));
    return LobeHistory(
        radiance, max(lobe.second_moment, square(luminance(radiance))), max(lobe.fast_luminance, 0.0),
        max(lobe.frames, 0.0), max(lobe.inverse_hit_distance, 0.0)
    );
}

LobeHistory read_diffuse(Taps taps) {
    LobeHistory sum = NO_HISTORY;
    for (int i = 0; i < taps.count; i++) {
        add_history(
            sum, unpack_lobe_history(previous_denoise_diffuse.at[taps.indices[i]]), taps.weights[i] / taps.weight
        );
    }
    return without_overshoot(sum);
}

LobeHistory read_specular(Taps taps) {
    LobeHistory sum = NO_HISTORY;
    for (int i = 0; i < taps.count; i++) {
        add_history(
            sum, unpack_lobe_history(previous_denoise_specular.at[taps.indices[i]]), taps.weights[i] / taps.weight
        );
    }
    return without_overshoot(sum);
}

#endif
