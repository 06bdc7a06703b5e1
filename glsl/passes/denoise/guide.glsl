// What the denoiser knows of the surface that a pixel shows, by itself, in mirrors or through glass: its feature
// buffer, packed from the guide images.
#ifndef PASSES_DENOISE_GUIDE_GLSL
#define PASSES_DENOISE_GUIDE_GLSL

#include "common/packing.glsl"
#include "common/pixel.glsl"
#include "passes/bindings.glsl"
#include "passes/denoise/bindings.glsl"
#include "passes/denoise/constants.glsl"
#include "passes/guides/bindings.glsl"
#include "scene/camera.glsl"

const uint NOT_DENOISED = 0u;     // shows nothing noisy: no surface, or a metal mirror that shows a light or no surface
const uint PRIMARY_SURFACE = 1u;  // what the pixel shows itself
// Primary surface replacement: the guides are of the surface that a pixel shows in a mirror of metal or through clear
// glass, in the place of its own.
const uint PSR_SURFACE = 2u;

struct Guide {
    uint kind;
    float depth;    // view depth in meters, of PSR_SURFACE that of its virtual position
    vec3 position;  // relative to the camera
    vec3 normal;
    float roughness_or_albedo;  // perceptual roughness; of PSR_SURFACE the luminance of its albedo
};

const float NORMAL_SCALE = 511.0, MATERIAL_SCALE = 63.0;

// Normals have ten bits a coordinate, which unpack fast, as filters need. Depth is a 26-bit float without sign.
uvec2 pack_guide(Guide guide) {
    ivec3 normal = ivec3(round(NORMAL_SCALE * guide.normal)) & 0x3FF;
    uint depth = floatBitsToUint(guide.depth) + 0x10u >> 5u;
    return uvec2(
        uint(normal.x | normal.y << 10 | normal.z << 20) | guide.kind << 30u,
        depth << 6u | pack_unorm(guide.roughness_or_albedo, 6u)
    );
}

// The point that a pixel position shows at a depth, relative to the camera. `Camera.jitter` is more than this frame's
// sample jitter: it includes the jitter that the user gives the camera, and the shift of the principal point.
vec3 position_at(vec2 pixel_position, float depth, Camera from) {
    ViewRay ray = view_ray(pixel_position + from.jitter, from);
    return mat3(from.world_from_view) * ray.origin + depth * (mat3(from.world_from_view) * ray.direction);
}

uint kind_of(uvec2 guide) { return guide.x >> 30u; }

float depth_of(uvec2 guide) { return uintBitsToFloat(guide.y >> 6u << 5u); }

// In units of 1 / MATERIAL_SCALE.
float quantized_roughness_or_albedo(uvec2 guide) { return float(int(guide.y) & int(MATERIAL_SCALE)); }

// In units of 1 / NORMAL_SCALE; its length may be off by 0.2 %.
vec3 quantized_normal(uvec2 guide) {
    int bits = int(guide.x);
    return vec3(bitfieldExtract(bits, 0, 10), bitfieldExtract(bits, 10, 10), bitfieldExtract(bits, 20, 10));
}

Guide unpack_guide(uvec2 bits, ivec2 pixel, Camera from) {
    float depth = depth_of(bits);
    return Guide(
        kind_of(bits), depth, position_at(vec2(pixel) + 0.5, depth, from), quantized_normal(bits) / NORMAL_SCALE,
        quantized_roughness_or_albedo(bits) / MATERIAL_SCALE
    );
}

Guide load_guide(ivec2 pixel) {
    return unpack_guide(denoise_guides.at[element_index(pixel, camera.size)], pixel, camera);
}

Guide load_previous_guide(ivec2 pixel) {
    uvec2 bits = previous_denoise_guides.at[element_index(pixel, camera.size)];
    return unpack_guide(bits, pixel, previous_camera);
}

// The albedo, diffuse and specular, of the surface that the guide images describe.
vec3 guide_albedo(ivec2 pixel) {
    ivec2 at = texel_of(pixel);
    vec3 albedo = imageLoad(guides_diffuse_albedo, at).rgb + imageLoad(guides_specular_albedo, at).rgb;
    return min(albedo, vec3(1.0));
}

// By which the light of a PSR surface is demodulated too, so that filters keep its texture; else 1.
vec3 psr_albedo(ivec2 pixel, uint kind) {
    return kind == PSR_SURFACE ? mix(vec3(MIN_PSR_ALBEDO), vec3(1.0), guide_albedo(pixel)) : vec3(1.0);
}

// The guide of this frame, from the guide images.
Guide make_guide(ivec2 pixel) {
    float depth_value = imageLoad(guides_depth, texel_of(pixel)).x;
    vec4 normal_roughness = imageLoad(guides_normal_roughness, texel_of(pixel));
    // Flags of passes/guides/write.comp: whether the guides are of the primary surface, and whether what they show has
    // noise.
    bool is_primary = imageLoad(guides_specular_albedo, texel_of(pixel)).a > 0.5;
    bool is_noisy = imageLoad(guides_diffuse_albedo, texel_of(pixel)).a > 0.5;
    Guide guide;
    guide.kind = depth_value == 0.0 ? NOT_DENOISED : is_primary ? PRIMARY_SURFACE : is_noisy ? PSR_SURFACE
        : NOT_DENOISED;
    guide.depth = depth_value > 0.0 ? camera.near / depth_value : BACKGROUND_DEPTH;
    guide.position = position_at(vec2(pixel) + 0.5, guide.depth, camera);
    guide.normal = safe_normalize(normal_roughness.xyz, vec3(0.0, 0.0, 1.0));
    guide.roughness_or_albedo = is_primary ? normal_roughness.w : luminance(guide_albedo(pixel));
    return guide;
}

// The width in meters of what a pixel shows at a depth. In orthographic projections tan_half_fov is half the height in
// meters.
float pixel_width(float depth) {
    return 2.0 * camera.tan_half_fov.y / float(camera.size.y) * (is_orthographic(camera) ? 1.0 : depth);
}

#endif
