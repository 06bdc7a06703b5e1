// The numbers of the denoiser, each with the paper that it is from. Those without a paper were chosen together, by the
// errors that `solari-vk bench denoise` measures; docs/explained/denoising.md has them.
#ifndef PASSES_DENOISE_CONSTANTS_GLSL
#define PASSES_DENOISE_CONSTANTS_GLSL

// ---- the previous frame: Schied et al., "Spatiotemporal Variance-Guided Filtering" (HPG 2017) --------

// Largest distance, in pixel widths, of what a pixel of the previous frame showed from the surface's plane, if both are
// one surface: in surface motion, in the alternate history (alternate_history.glsl), and in virtual motion.
const float MAX_PLANE_DISTANCE = 1.5, MAX_ALTERNATE_PLANE_DISTANCE = 2.5, MAX_REFLECTION_PLANE_DISTANCE = 8.0;
const float MIN_NORMAL_COSINE = 0.9;
const float MAX_MATERIAL_DIFFERENCE = 0.1;  // of Guide.roughness_or_albedo
const float BACKGROUND_DEPTH = 1e6;  // meters
// If the accepted Catmull-Rom weights sum to something further from 1, taps were rejected: bilinear weights then.
const float MAX_TAP_WEIGHT_ERROR = 0.02;
const float MIN_PSR_ALBEDO = 0.02;  // least albedo by which light of primary surface replacement (PSR) is demodulated

// Reflections: Zhdan, "ReBLUR" (2021).
// Perceptual roughness from which reflections move like their surface; and up to which like their virtual image.
const float SURFACE_MOTION_ROUGHNESS = 0.8, VIRTUAL_MOTION_ROUGHNESS = 0.5;
// The same below which edges of a reflection are as sharp as those of surfaces, so that antialiasing follows it.
const float SHARP_REFLECTION = 0.06;
const float LOBE_NORMAL_TOLERANCE = 0.1;  // 1 - the cosine between the normals of two frames, as a multiple of alpha
const float MIN_LOBE_ALPHA = 0.02;  // narrower lobes count as this wide
// Specular light that surface motion moves stays valid while the direction to the camera changes by less than about
// VIEW_TOLERANCE * alpha + MIRROR_VIEW_TOLERANCE, in radians.
const float VIEW_TOLERANCE = 0.05, MIRROR_VIEW_TOLERANCE = 0.002;
// A surface counts as curved where the squared difference of neighboring pixels' normals is between these: less is
// flat, more is an edge.
const float MIN_CURVED_NORMALS = 1e-5, MAX_CURVED_NORMALS = 0.1;
const float VIRTUAL_POSITION_ERROR = 0.3;  // assumed error of the virtual image's position, in pixels
const float MIN_INVERSE_HIT_DISTANCE = 1e-9;  // 1 / distance of light from the environment

// ---- changes of light: Schied et al., "Gradient Estimation" (HPG 2018) -------------------------------

const float FAST_WEIGHT = 0.2;  // weight of the newest frame in LobeHistory.fast_luminance
// The variance of LobeHistory.fast_luminance over that of a single frame's luminance: FAST_WEIGHT / (2 - FAST_WEIGHT).
const float FAST_VARIANCE_RATIO = 0.111;
const float MIN_GRADIENT_FRAMES = 3.0;  // least history length that tells the noise of a pixel
// Shorter histories count as if this frame's light had so many times the variance that it shows: then only expected
// changes are noticed, and those that are far beyond noise.
const float YOUNG_VARIANCE_RATIO = 49.0;
const int MAX_NEIGHBORHOOD_RADIUS = 2;  // in gradient cells (gradient_cell.glsl) from the center one
// In standard deviations of a temporal gradient's noise: up to the first number the gradient counts as noise, from the
// second as a change of light, with a smoothstep between them. CHANGE_SIGMAS_IF_EXPECTED is for cells where
// passes/light_change.glsl expects that EXPECTED_CHANGE or more of the light changes.
const vec2 CHANGE_SIGMAS = vec2(3.5, 6.0), CHANGE_SIGMAS_IF_EXPECTED = vec2(0.5, 1.5);
const float EXPECTED_CHANGE = 0.25;  // share of the light
const float CHANGE_EXPONENT = 16.0;  // the confidence is the share of light that didn't change, to this power
const float MAX_UNTRIMMED_PIXELS = 8.0;  // a trimmed mean of more pixels leaves out the brightest

// ---- variance and fireflies -------------------------------------------------------------------------

// Weight of the spatial variance in frames; the weight of the temporal variance is the history length.
const float SPATIAL_VARIANCE_FRAMES = 4.0;
const float CENTER_MOMENTS_WEIGHT = 4.0;  // center weight of the 3 x 3 kernel, (1 2 1) x (1 2 1), of moments
const float FIREFLY_FRAMES = 40.0;  // fireflies are clamped in all histories shorter than this
// In longer histories they are clamped where few frames brought the light: the effective sample size is less than the
// first number, and less than the second times the history length.
const float MIN_EFFECTIVE_FRAMES = 4.0, MIN_EFFECTIVE_SHARE = 0.0625;
// Fireflies are clamped to the larger of two limits: MAX_OVER_NEIGHBORS times the neighbors' mean luminance, and
// MAX_OVER_CELLS times min(squared effective sample size, history length) times the trimmed mean of the 3 x 3 gradient
// cells around, so that light that many frames brought isn't clamped.
const float MAX_OVER_NEIGHBORS = 2.0, MAX_OVER_CELLS = 4.0;
const float MIN_NEIGHBOR_WEIGHT = 0.1;  // neighbors of less weight show other surfaces, and aren't compared with
const float MIN_VARIANCE_FRAMES = 2.0;  // history length from which samples of a pixel have a variance

// ---- edge-stopping weights --------------------------------------------------------------------------

// A tolerance is the difference that makes a weight 1/e. PLANE_TOLERANCE: distance from the center's tangent plane in
// pixel widths, beyond the sagitta, by which a curved surface with both pixels' normals would leave it.
const float PLANE_TOLERANCE = 1.0;
const float DIFFUSE_NORMAL_TOLERANCE = 0.12;  // 1 - the cosine between normals
const float PSR_NORMAL_TOLERANCE = 0.05;  // the same for the light of PSR surfaces
const float SPECULAR_NORMAL_TOLERANCE = 0.1;  // the same for the specular lobe, as a multiple of alpha
// Surfaces with less alpha (squared perceptual roughness) are filtered as if they had this: the first where light has
// converged; the second where it is noisy, since it is better to blur the reflections of smooth surfaces than to show
// their noise; the third where it is noisy and the blur can't tell the edges of bright reflections from noise
// (REFLECTION_EDGES_UNKNOWN in signal.glsl).
const float MIN_ALPHA_CONVERGED = 0.003, MIN_ALPHA_NOISY = 0.4, MIN_ALPHA_UNKNOWN_EDGES = 0.04;
const float MATERIAL_TOLERANCE = 0.1;  // of Guide.roughness_or_albedo

// ---- the blur: Dammertz et al. (HPG 2010) ------------------------------------------------------------

const float SIGMA_LUMINANCE = 2.2;  // sigma_l in SVGF
// Albedo of the specular lobe from which channels are compared beside luminances: of metals, and of half-metals.
const float MIN_METAL_ALBEDO = 0.1;
const float CENTER_WEIGHT = 4.0;  // of the 3 x 3 kernel, (1 2 1) x (1 2 1); Dammertz et al. have 5 x 5
const float CONVERGED_NOISE = 0.025;  // standard deviation over mean, below which a pixel is filtered no more
const float MIN_ACCEPTED_RATIO = 0.25;  // FilterSum.accepted_weight / weight_sum: below it in both lobes, the blur ends
// Correlation of the noise of pixels that a pass averages, in the first, the second, and all later passes: pixels that
// earlier passes have filtered share some of their input.
const float CORRELATION[3] = float[](0.0, 0.081, 0.125);
const float EPSILON = 1e-30;

// The estimated error of a pixel, frame["error"], over the standard deviation of the noise that is left in it:
// ERROR_OVER_NOISE + BIAS_OVER_NOISE / sqrt(effective sample size), the second term for the bias of the blur, which is
// wider where few frames brought the light. Chosen so that about 68 % of the pixels have at most this error, as within
// one standard deviation, in mirror_hall and other scenes of the benchmark.
const float ERROR_OVER_NOISE = 1.15;
const float BIAS_OVER_NOISE = 0.8;
const float MIN_FRAMES_OF_BIAS = 10.0;  // smaller sample sizes count as this

#endif
