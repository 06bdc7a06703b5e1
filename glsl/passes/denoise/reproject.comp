// Reprojects the history of each pixel's light. It is taken from the pixels around where the surface was, or for smooth
// surfaces where its reflection was, as far as they showed the same surface.
// Schied et al., "Spatiotemporal Variance-Guided Filtering" (HPG 2017); reflections as in Zhdan, "ReBLUR" (2021).
#version 460
#include "common/pixel.glsl"
#include "passes/denoise/alternate_history.glsl"
#include "passes/denoise/guide.glsl"
#include "passes/denoise/lobe_history.glsl"
#include "passes/denoise/previous_frame.glsl"
#include "passes/denoise/virtual_motion.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

const uint PASS_SALT = 0x6A09E667u;

// The mean of two histories.
LobeHistory blend(LobeHistory a, LobeHistory b, float share) {
    return LobeHistory(
        mix(a.radiance, b.radiance, share), mix(a.second_moment, b.second_moment, share),
        mix(a.fast_luminance, b.fast_luminance, share), mix(a.frames, b.frames, share),
        mix(a.inverse_hit_distance, b.inverse_hit_distance, share)
    );
}

// The history of the specular lobe: by surface motion and by virtual motion (of the virtual image), blended by
// roughness.
LobeHistory find_specular(ivec2 pixel, Guide guide, PreviousSurface previous, Taps surface_taps) {
    LobeHistory surface_history = read_specular(surface_taps);
    if (guide.kind != PRIMARY_SURFACE) { return surface_history; }
    float alpha = guide.roughness_or_albedo * guide.roughness_or_albedo;
    // Pixels whose normals differ, as they do where the surface is curved, reflected light from another direction.
    float normal_deviation = surface_taps.normal_deviation / surface_taps.weight;
    surface_history.frames /= 1.0 + square(normal_deviation / (LOBE_NORMAL_TOLERANCE * max(alpha, MIN_LOBE_ALPHA)));
    float turned = view_change(guide, previous);
    if (turned < MIN_VIEW_CHANGE) { return surface_history; }

    // Light moved by surface motion stays valid for angles within the lobe.
    surface_history.frames /= 1.0 + square(turned / (VIEW_TOLERANCE * alpha + MIRROR_VIEW_TOLERANCE));
    float share = 1.0 - smoothstep(VIRTUAL_MOTION_ROUGHNESS, SURFACE_MOTION_ROUGHNESS, guide.roughness_or_albedo);
    if (share == 0.0 || surface_history.inverse_hit_distance == 0.0) { return surface_history; }
    float twice_curvature = 2.0 * curvature(pixel, guide);
    vec2 virtual_pixel;
    bool has_image = find_virtual_pixel(
        pixel, guide, previous, surface_history.inverse_hit_distance, twice_curvature, virtual_pixel
    );
    if (!has_image) { return surface_history; }
    Taps virtual_taps = find_taps(virtual_pixel, previous, guide, MAX_REFLECTION_PLANE_DISTANCE);
    if (virtual_taps.weight == 0.0) { return surface_history; }
    LobeHistory virtual_history = read_specular(virtual_taps);
    // On a curved surface the reflected ray may turn by more than the lobe's width from pixel to pixel, so that the
    // virtual position is uncertain.
    virtual_history.frames /= 1.0 + square(VIRTUAL_POSITION_ERROR * twice_curvature * pixel_width(guide.depth)
        / (alpha + MIN_LOBE_ALPHA));
    return blend(surface_history, virtual_history, share);
}

// The alternate history of a pixel of the previous frame, with the depth that its surface has in this frame if it stays
// in place. guide: of the pixel that takes it. Both surfaces may move against each other, which the tolerance allows.
AlternateHistory moved_alternate(AlternateHistory alternate, ivec2 from, Guide guide) {
    if (kind_of(alternate.surface) == NOT_DENOISED) { return NO_ALTERNATE; }
    Guide moved = unpack_guide(surface_of(alternate), from, previous_camera);
    vec3 position = moved.position + previous_camera.world_from_view[3] - camera.world_from_view[3];
    moved.depth = is_orthographic(camera)
        ? -dot(position, camera.world_from_view[2])
        : length(position) * guide.depth / length(guide.position);
    alternate.surface = with_frames(pack_guide(moved), frames_of(alternate.surface));
    return moved.depth > 0.0 ? alternate : NO_ALTERNATE;
}

// The pixel of the previous frame in which the surface was, `from`, showed one of two surfaces. If its alternate
// history is of this pixel's surface, lobes without a history take that. Returns the history of the other surface.
AlternateHistory swap_alternate(
    ivec2 from, PreviousSurface previous, Guide guide, inout LobeHistory diffuse, inout LobeHistory specular,
    inout uint rng
) {
    uint from_index = element_index(from, camera.size);
    bool has_surface = guide.kind != NOT_DENOISED;
    AlternateHistory alternate = previous_denoise_alternate.at[from_index];
    Guide aside = unpack_guide(surface_of(alternate), from, previous_camera);
    bool was_aside = has_surface && is_consistent(aside, previous, guide, MAX_ALTERNATE_PLANE_DISTANCE);
    if (was_aside && diffuse.frames == 0.0) { unpack_alternate(alternate, diffuse, specular); }
    if (was_aside) { alternate = NO_ALTERNATE; }
    Guide shown = load_previous_guide(from);
    bool showed_this = has_surface && is_consistent(shown, previous, guide, MAX_PLANE_DISTANCE);
    if (!showed_this && shown.kind != NOT_DENOISED) {
        LobeHistory diffuse_before = unpack_lobe_history(previous_denoise_diffuse.at[from_index]);
        LobeHistory specular_before = unpack_lobe_history(previous_denoise_specular.at[from_index]);
        alternate = pack_alternate(previous_denoise_guides.at[from_index], diffuse_before, specular_before, rng);
    }
    return moved_alternate(alternate, from, guide);
}

void main() {
    uvec2 found = gl_GlobalInvocationID.xy;
    uint index;
    if (!find_pixel(found, index)) { return; }
    ivec2 pixel = ivec2(found);
    Guide guide = make_guide(pixel);
    if (denoise_settings.denoise == 0u) { guide.kind = NOT_DENOISED; }
    bool has_surface = guide.kind != NOT_DENOISED;
    denoise_guides.at[index] = has_surface ? pack_guide(guide) : uvec2(0u);
    uint rng = seed_rng(uvec2(pixel), this_frame.index, this_frame.seed ^ PASS_SALT);
    LobeHistory diffuse = NO_HISTORY, specular = NO_HISTORY;
    AlternateHistory alternate = NO_ALTERNATE;
    if (denoise_settings.denoise != 0u && this_frame.has_history != 0u) {
        PreviousSurface previous = find_previous_surface(pixel, guide);
        bool moved = previous.pixel != vec2(pixel) + 0.5 || previous.position != guide.position;
        if (!moved && has_surface && is_consistent(load_previous_guide(pixel), previous, guide, MAX_PLANE_DISTANCE)) {
            denoise_diffuse.at[index] = previous_denoise_diffuse.at[index];
            denoise_specular.at[index] = previous_denoise_specular.at[index];
            denoise_alternate.at[index] = previous_denoise_alternate.at[index];
            return;
        }
        Taps taps = has_surface && moved ? find_taps(previous.pixel, previous, guide, MAX_PLANE_DISTANCE) : no_taps();
        if (taps.weight > 0.0) {
            diffuse = read_diffuse(taps);
            specular = find_specular(pixel, guide, previous, taps);
        }
        ivec2 from = ivec2(floor(previous.pixel));
        if (is_inside(from, camera.size)) {
            alternate = swap_alternate(from, previous, guide, diffuse, specular, rng);
        }
    }
    denoise_alternate.at[index] = alternate;
    denoise_diffuse.at[index] = has_surface ? pack_lobe_history(diffuse, rng) : uvec4(0u);
    denoise_specular.at[index] = has_surface ? pack_lobe_history(specular, rng) : uvec4(0u);
}
