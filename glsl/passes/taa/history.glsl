// The picture of earlier frames at a pixel of this one: what it was, and where it still holds.
#ifndef PASSES_TAA_HISTORY_GLSL
#define PASSES_TAA_HISTORY_GLSL

#include "common/packing.glsl"
#include "common/pixel.glsl"
#include "generated/passes/taa.glsl"  // CELL_SIZE
#include "passes/gbuffer/gbuffer.glsl"
#include "passes/taa/bindings.glsl"
#include "passes/taa/samples.glsl"

struct HistorySample {
    vec3 radiance;
    float weight;  // number of samples in the mean, or less where a change made them count less; 0 without a history
    bool blended;  // whether it has shown a blended surface since it moved
};

const HistorySample NO_HISTORY_SAMPLE = HistorySample(vec3(0.0), 0.0, false);

uvec2 pack_history(HistorySample history, inout uint rng) {
    uint red = pack_positive(history.radiance.r, 18u, rng), green = pack_positive(history.radiance.g, 18u, rng);
    uint blue = pack_positive(history.radiance.b, 18u, rng), weight = uint(8.0 * min(history.weight, LONGEST) + 0.5);
    return uvec2(red | green << 18u, green >> 14u | blue << 4u | weight << 22u | uint(history.blended) << 31u);
}

HistorySample unpack_history(uvec2 bits) {
    vec3 found = vec3(unpack_positive(bits.x, 18u), unpack_positive(bits.x >> 18u | bits.y << 14u, 18u),
                      unpack_positive(bits.y >> 4u, 18u));
    return HistorySample(found, float(bitfieldExtract(bits.y, 22, 9)) / 8.0, bits.y >> 31u != 0u);
}

HistorySample load_history(ivec2 at) {
    ivec2 inside = clamp(at, ivec2(0), ivec2(camera.picture_size) - 1);
    return unpack_history(previous_taa_history.at[element_index(inside, camera.picture_size)]);
}

// Whether the picture is the mean over an exposure: of all its frames, and in full precision, since it lasts as long as
// the user likes. Then the history is the mean in `radiance`, and the number of samples alone in taa_history.
bool in_exposure() {
    return this_frame.shutter_state == FIRST_OF_EXPOSURE || this_frame.shutter_state == LATER_OF_EXPOSURE;
}

HistorySample load_exposure(uint index) {
    return HistorySample(radiance.at[index], uintBitsToFloat(previous_taa_history.at[index].x), false);
}

// The past between pixels.
HistorySample interpolate_history(vec2 position, Neighborhood around) {
    ivec2 corner = ivec2(floor(position - 0.5));
    vec2 share = position - 0.5 - vec2(corner);
    vec4 across = catmull_rom_weights(share.x), down = catmull_rom_weights(share.y);
    vec3 sum = vec3(0.0), low = vec3(INFINITY), high = vec3(0.0);
    float total = 0.0, shortest = LONGEST_IN_MOTION * render_scale().x * render_scale().y;
    for (int i = 0; i < 16; i++) {
        ivec2 step = ivec2(i & 3, i >> 2);
        HistorySample found = load_history(corner + step - 1);
        if (found.weight == 0.0) { continue; }
        float weight = across[step.x] * down[step.y] * tone_weight(found.radiance, around);
        sum += weight * found.radiance;
        total += weight;
        if (all(equal(step >> 1 ^ step & 1, ivec2(1)))) {  // one of the four nearest
            low = min(low, found.radiance);
            high = max(high, found.radiance);
            shortest = min(shortest, found.weight);
        }
    }
    if (low.x > high.x) { return NO_HISTORY_SAMPLE; }
    return HistorySample(total > 0.0 ? clamp(sum / total, low, high) : high, shortest, false);
}

// Whether what a rendered pixel shows was visible around a position of the previous picture.
bool was_visible(ivec2 pixel, vec2 position) {
    float now = imageLoad(depth, texel_of(pixel)).x;
    ivec2 center = ivec2(floor(position * render_scale())), last = ivec2(camera.size) - 1;
    for (int i = 0; i < 9; i++) {
        ivec2 step = ivec2((i + 4) % 9 % 3, (i + 4) % 9 / 3) - 1;  // the center first
        float before = imageLoad(previous_depth, texel_of(clamp(center + step, ivec2(0), last))).x;
        if (abs(now - before) <= MAX_DEPTH_DIFFERENCE * max(now, before)) { return true; }
    }
    return false;
}

// The motion in uv without that of the point of the lens through which a frame sees: the picture is the mean over the
// lens, which stays.
vec2 motion_without_lens(ivec2 pixel, vec2 motion) {
    if (only_lens_sample_moved(imageLoad(gbuffer_surface, texel_of(pixel)).y)) { return vec2(0.0); }
    float distance = camera.near / max(imageLoad(depth, texel_of(pixel)).x, 1e-9);
    vec2 uv = (vec2(pixel) + 0.5 + camera.jitter - camera.principal_shift) / vec2(camera.size);
    vec2 before = uv_from_lens_middle(uv + motion, distance, previous_camera);
    return shorter_way(before - uv_from_lens_middle(uv, distance, camera));
}

// The motion in pixels of the picture, from where it was in the previous frame; exactly 0 for what doesn't move.
vec2 motion_in_picture(ivec2 pixel) {
    vec2 motion = imageLoad(guides_specular_motion, texel_of(pixel)).xy;
    if (camera.lens_radius > 0.0) { motion = motion_without_lens(pixel, motion); }
    return motion * vec2(camera.picture_size) + this_frame.user_jitter_change;
}

// Whether a pixel begins a new mean, as in a first frame, because what it shows has jumped.
bool begins_anew(ivec2 center) {
    if (this_frame.has_history == 0u) { return true; }
    vec2 motion = motion_in_picture(center);
    return dot(motion, motion) > square(JUMP * float(camera.picture_size.y));
}

// ---- what still holds -------------------------------------------------------------------------------

// The row of the instance that the previous frame showed, or NO_INDEX. Those of a world move when the table grows.
uint previous_instance(ivec2 at) {
    uint row = imageLoad(previous_gbuffer_surface, at).y;
#ifdef MANY_VIEWS
    if (row != NO_INDEX) { row += views.at[view_index].first_instance - views.at[view_index].previous_first_instance; }
#endif
    return row;
}

// Whether neither the camera nor any surface around moved, among them those that only the previous frame shows there.
bool is_still(ivec2 center) {
    if (in_exposure()) { return true; }  // the picture is that of all times
    if (camera.world_from_view != previous_camera.world_from_view) { return false; }
    uint known = NO_INDEX;
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size)) { continue; }
        if (motion_in_picture(pixel) != vec2(0.0)) { return false; }
        uint instance = previous_instance(texel_of(pixel));
        if (instance == known || instance == NO_INDEX) { continue; }
        if (!is_static(instance)) { return false; }
        known = instance;
    }
    return true;
}

bool shows_blended(uint instance) {
    return instance != NO_INDEX && (materials.at[instances.at[instance].material].flags & MATERIAL_BLEND) != 0u;
}

// Whether a blended surface is around, in this frame or in the previous one: frames show it or what lies behind it.
bool is_blended(ivec2 center) {
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size)) { continue; }
        ivec2 at = texel_of(pixel);
        if (shows_blended(imageLoad(gbuffer_surface, at).y) || shows_blended(previous_instance(at))) { return true; }
    }
    return false;
}

// The share of the histories around a rendered pixel that is still true.
float confidence_at(ivec2 center) {
    uvec2 cells = (camera.size + CELL_SIZE - 1u) / CELL_SIZE;
    return taa_confidence.at[element_index(uvec2(center) / CELL_SIZE, cells)];
}

// Whether a surface around has another opacity than in the previous frame, or is blended or masked and has another
// material. Frames before showed it in other shares of their samples.
bool has_new_opacity(ivec2 center) {
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size)) { continue; }
        for (int frame = 0; frame < 2; frame++) {
            ivec2 at = texel_of(pixel);
            uint shown = frame == 0 ? imageLoad(gbuffer_surface, at).y : previous_instance(at);
            if (shown == NO_INDEX || previous_instances.at[shown].id != instances.at[shown].id) { continue; }
            PreviousInstance before = previous_instances.at[shown];
            uint material = instances.at[shown].material;
            float opacity = opacity_of(material);
            if (before.opacity != opacity || opacity >= 0.0 && before.material != material) { return true; }
        }
    }
    return false;
}

// The motion in pixels of the picture of what is seen around a pixel: of its nearest surface, or of what a smooth one
// reflects that the pixel shows, away from edges of what is before it.
vec2 seen_motion(Neighborhood around) {
    vec2 motion = motion_in_picture(around.nearest);
    vec2 reflected = unpackHalf2x16(reflection_motion.at[element_index(around.center, camera.size)]);
    bool follows = reflected.x < NO_REFLECTION_MOTION && show_the_same(around.center, around.nearest)
        && !is_still(around.center);
    return follows ? reflected / render_scale() : motion;
}

HistorySample find_history(ivec2 at, Neighborhood around) {
    if (this_frame.shutter_state == LATER_OF_EXPOSURE && this_frame.has_history != 0u) {
        return load_exposure(element_index(at, camera.picture_size));
    }
    if (this_frame.shutter_state != NO_SHUTTER) { return NO_HISTORY_SAMPLE; }
    vec2 motion = seen_motion(around);
    vec2 position = vec2(at) + 0.5 + motion;
    bool inside = all(greaterThanEqual(position, vec2(0.0))) && all(lessThan(position, vec2(camera.picture_size)));
    if (this_frame.has_history == 0u || !inside) { return NO_HISTORY_SAMPLE; }
    // What is smaller than a pixel may be missing from the previous samples though nothing moved.
    if (!was_visible(around.nearest, position) && !is_still(around.center)) { return NO_HISTORY_SAMPLE; }
    return motion == vec2(0.0) ? load_history(at) : interpolate_history(position, around);
}

// The difference of two luminances over their sum.
float relative_difference(vec3 now, vec3 before) {
    float difference = luminance(now) - luminance(before);
    return difference == 0.0 ? 0.0 : difference / (luminance(now) + luminance(before));
}

// By what share of the previous frame's picture the samples around differ from it in the same direction: 0 unless most
// of them do. What one frame's samples miss of edges and lines differs along a line at most.
float common_difference(ivec2 center) {
    float sum = 0.0, squares = 0.0, count = 0.0;
    for (int i = 0; i < 9; i++) {
        ivec2 pixel = center + ivec2(i % 3, i / 3) - 1;
        if (!is_inside(pixel, camera.size) || !is_finite_color(load_sample(pixel))) { continue; }
        HistorySample history = load_history(ivec2(floor((vec2(pixel) + 0.5
            + this_frame.sample_jitter) / render_scale())));
        if (history.weight == 0.0) { continue; }
        float difference = relative_difference(load_sample(pixel), history.radiance);
        sum += difference;
        squares += difference * difference;
        count += 1.0;
    }
    if (!(squares > 0.0)) { return 0.0; }
    return smoothstep(ALONG_LINES, OVER_AREAS, abs(sum) / sqrt(count * squares)) * min(2.0 * abs(sum) / count, 1.0);
}

#endif
