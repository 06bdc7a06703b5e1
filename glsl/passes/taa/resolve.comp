// The picture: a mean of samples at different positions in each pixel, over frames. Yang et al., "A Survey of Temporal
// Antialiasing Techniques" (2020). Where a pixel has had few samples, those around count too; later ones are those
// inside it alone, so that the mean of a still picture tends to that of the pixel's area.
#version 460
#include "common/pixel.glsl"
#include "passes/taa/history.glsl"
#include "passes/taa/strata.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x510E527Fu;

// Moves the previous frame's color into the range of what the samples around show: Salvi, "An Excursion in Temporal
// Supersampling" (GDC 2016). Where nothing moves, that color changes only if most samples around differ from it in the
// same direction, as they do when the light changes, and by the share that they have in common.
HistorySample limited(HistorySample history, Neighborhood around) {
    if (in_exposure()) { return history; }
    vec3 color = to_ycocg(history.radiance) - around.mean;
    vec3 extent = BOX * around.deviation + DENOISED_ERROR * around.mean.x + 1e-30;
    float outside = max_component(abs(color) / extent);
    if (around.count == 0.0 || !(outside > SUSPECT)) { return history; }
    bool differs = abs(relative_difference(load_sample(around.center), history.radiance)) > UNNOTICED;
    if (!(outside > 1.0) && !differs) { return history; }
    float kept = min(1.0 / outside, 1.0), trusted = kept;
    bool gone = SCENE_BLEND && history.blended && this_frame.blended_changed != 0u && !is_blended(around.center);
    if (!gone && is_still(around.center)) {
        // By chance all samples around may show a blended surface, or none of them, even in many frames.
        history.blended = SCENE_BLEND && (history.blended || is_blended(around.center));
        // So they may through one point of the lens.
        bool by_chance = (history.blended || camera.lens_radius > 0.0) && this_frame.lighting_change == 0.0;
        trusted = by_chance ? 1.0 : 1.0 - common_difference(around.center);
        kept = max(kept, trusted);
    } else {
        history.blended = false;
    }
    return HistorySample(max(from_ycocg(around.mean + kept * color), vec3(0.0)), trusted * history.weight,
        history.blended);
}

// Whether the shutter is open at a row of the picture at this frame's time.
bool is_exposed(uint row) {
    return !in_exposure() || row >= this_frame.exposed_rows.x && row < this_frame.exposed_rows.y;
}

// Adds a sample to the strata of a pixel, and replaces the picture by their mean where that is better.
// goes_on: whether they hold: the pixel was at rest and none of its history was given up, or coverage.comp began them.
// flickers: whether it was at rest, and some was given up though nobody changed the scene.
void stratify(
    uint index, ivec2 center, NearestSample found, bool goes_on, bool flickers, inout HistorySample history,
    inout uint rng
) {
    Strata strata = NO_STRATA;
    if (goes_on) { strata = load_strata(index); }
    if (flickers) { strata.share = FLICKERS; }
    if (found.exists && is_finite_color(found.radiance)) { add_sample(strata, surface_code(center), found.radiance); }
    store_strata(index, strata, rng);
    float count = sample_count(strata);
    if (count >= samples_needed(strata) && count >= MIN_STRATIFIED * history.weight) {
        history.radiance = mean_of(strata);
    }
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy;
    uint index;
    if (!find_element(pixel, camera.picture_size, index)) { return; }
    ivec2 at = ivec2(pixel);
    NearestSample found = find_own_sample(at);
    if (taa_settings.antialiasing == 0u && !in_exposure()) {
        radiance.at[index] = found.exists ? found.radiance : interpolate(at, find_neighborhood(at)).radiance;
        taa_history.at[index] = uvec2(0u);
        return;
    }
    Neighborhood around = find_neighborhood(at);
    bool anew = !in_exposure() && begins_anew(around.center);
    HistorySample history = anew ? NO_HISTORY_SAMPLE : find_history(at, around);
    float known = history.weight;
    if (!in_exposure()) {  // the picture of an exposure is that of all times
        if (SCENE_ALPHA && this_frame.expected_change > 0.0 && has_new_opacity(around.center)) { history.weight = 0.0; }
        history.weight *= confidence_at(around.center);
    }
    if (history.weight > 0.0) { history = limited(history, around); }
    bool stays = known > 0.0 && !in_exposure() && is_still(around.center), goes_on = stays && history.weight >= known;
    NearestSample own = found;

    // What several camera rays show tells more than one sample with its neighbors.
    vec3 covered = in_exposure() ? NO_COVERAGE : radiance.at[index];
    float weight = 1.0;
    bool settled = history.weight >= ENOUGH;
    bool exposed = is_exposed(pixel.y);
    if (!exposed && history.weight > 0.0) {
        found = NO_NEAREST_SAMPLE;
    } else if (!found.exists || !is_finite_color(found.radiance)) {
        found = settled ? NO_NEAREST_SAMPLE : interpolate(at, around);
        weight = INTERPOLATED;
    } else {
        // Not wherever means are short: those of moving reflections always are, and would be blurred. Blended surfaces
        // in motion are always softened, since it is chance which samples show them.
        bool softens = history.weight == 0.0 || !settled && is_still(around.center);
        bool blended = SCENE_BLEND && is_blended(around.center);
        if (covered == NO_COVERAGE && (softens || blended && !is_still(around.center))) {
            found.radiance = soften(around.center, at, history.weight + 1.0, blended);
        }
        if (!exposed) { weight = UNEXPOSED; }  // stands for samples of the row's time, until there are some
    }
    if (covered != NO_COVERAGE) { found = NearestSample(covered, true); }
    if (found.exists) {
        // A sample counts in proportion to its number in the sequence, since the denoiser knows more from frame to
        // frame. Up to a factor, these weights sum to the square of the number. Times of an exposure count the same.
        float total = history.weight + weight, kept = history.weight / total;  // never above 1 by rounding
        float share = in_exposure() ? 1.0 - kept : 1.0 - square(kept);
        bool differs = abs(relative_difference(found.radiance, history.radiance)) > UNNOTICED;
        if (history.weight > 0.0 && differs && !is_still(around.center)) {
            // Means in motion have few samples: bright ones count less, or pixels at edges of lamps would flash. What
            // moves loses some light of its brightest samples.
            float counts = share * tone_weight(found.radiance, around);
            share = counts / max(counts + (1.0 - share) * tone_weight(history.radiance, around), 1e-30);
        }
        history = HistorySample(mix(history.radiance, found.radiance, share), total, history.blended);
    }
    uint rng = seed_rng(uvec2(at), this_frame.index, this_frame.seed ^ PASS_SALT);
    if (has_strata()) {
        bool flickers = stays && !goes_on && this_frame.expected_change == 0.0;
        stratify(index, around.center, own, goes_on || covered != NO_COVERAGE, flickers, history, rng);
    }
    radiance.at[index] = history.radiance;
    taa_history.at[index] = in_exposure() ? uvec2(floatBitsToUint(history.weight), 0u) : pack_history(history, rng);
}
