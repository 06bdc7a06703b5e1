// The numbers of the denoiser, each with the paper that it is from. Those without a paper were chosen together, by the
// errors that `solari-vk bench denoise` measures; docs/explained/denoising.md has them.
#ifndef PASSES_DENOISE_CONSTANTS_GLSL
#define PASSES_DENOISE_CONSTANTS_GLSL

// ---- the previous frame: Schied et al., "Spatiotemporal Variance-Guided Filtering" (HPG 2017) --------

// Largest plane distance at which a pixel showed the same surface, in pixel widths: for surface motion, for the
// alternate history, and for virtual motion.
const float MAX_PLANE_DISTANCE = 1.5, MAX_ALTERNATE_PLANE_DISTANCE = 2.5, MAX_REFLECTION_PLANE_DISTANCE = 8.0;
const float MIN_NORMAL_COSINE = 0.9;
const float MAX_MATERIAL_DIFFERENCE = 0.1;  // of Guide.roughness_or_albedo
const float BACKGROUND_DEPTH = 1e6;
// Difference from 1 of the sum of the taps' weights: beyond it, some of the taps showed another surface.
const float MAX_TAP_WEIGHT_ERROR = 0.02;
const float MIN_PSR_ALBEDO = 0.02;  // least albedo by which light of primary surface replacement (PSR) is demodulated

// Reflections: Zhdan, "ReBLUR" (2021).
// Perceptual roughness from which reflections move like their surface; and up to which like their virtual image.
const float SURFACE_MOTION_ROUGHNESS = 0.8, VIRTUAL_MOTION_ROUGHNESS = 0.5;
const float LOBE_NORMAL_TOLERANCE = 0.1;  // 1 - the cosine between normals, over alpha
const float MIN_LOBE_ALPHA = 0.02;  // the least that counts as the width of a lobe
// Change of the direction to the camera that surface motion tolerates: over alpha, and that of a mirror.
const float VIEW_TOLERANCE = 0.05, MIRROR_VIEW_TOLERANCE = 0.002;
// Squared differences of the normals of neighboring pixels between which a surface counts as curved.
const float MIN_CURVED_NORMALS = 1e-5, MAX_CURVED_NORMALS = 0.1;
const float VIRTUAL_POSITION_ERROR = 0.3;  // share of a pixel by which the virtual image's position may be off
const float MIN_INVERSE_HIT_DISTANCE = 1e-9;  // 1 / distance of light from the environment

// ---- changes of light: Schied et al., "Gradient Estimation" (HPG 2018) -------------------------------

const float FAST_WEIGHT = 0.2;  // weight of a frame in LobeHistory.fast_luminance
// The variance of LobeHistory.fast_luminance over that of a frame: FAST_WEIGHT / (2 - FAST_WEIGHT).
const float FAST_VARIANCE = 0.111;
const float MIN_GRADIENT_FRAMES = 3.0;  // shorter histories tell nothing
const int MAX_RING = 2;  // cells from the center of the widest neighborhood
// Standard deviations of noise between which a temporal gradient begins to count as a change of light and counts whole;
// and the same where passes/light_change.glsl expects that EXPECTED_CHANGE or more of the light changes.
const vec2 CHANGE_SIGMAS = vec2(3.5, 6.0), CHANGE_SIGMAS_IF_EXPECTED = vec2(0.5, 1.5);
const float EXPECTED_CHANGE = 0.25;  // share of the light
const float CHANGE_EXPONENT = 16.0;  // of the share of light that didn't change, for the confidence
const float MIN_TRIMMED_PIXELS = 8.0;  // fewer are too few to leave out the brightest

// ---- variance and fireflies -------------------------------------------------------------------------

const float SPATIAL_VARIANCE_FRAMES = 4.0;  // frames that the spatial estimate of the variance counts for
const float CENTER_MOMENTS_WEIGHT = 4.0;  // center weight of the 3 x 3 kernel, (1 2 1) x (1 2 1), of moments
const float FIREFLY_FRAMES = 40.0;  // frames up to which fireflies are limited
// Effective sample size below which longer histories are limited too, and its share of the frames if that is less.
const float CONFIRMED_FRAMES = 4.0, CONFIRMED_SHARE = 0.0625;
// Fireflies are clamped to the larger of two limits: these factors times the neighbors' mean, and times the mean of the
// 3 x 3 cells and the squared effective sample size, up to the history length, so that light that more frames confirm
// stays.
const float MAX_OVER_NEIGHBORS = 2.0, MAX_OVER_CELLS = 4.0;
const float MIN_NEIGHBOR_WEIGHT = 0.1;  // least weight of the neighbors that a pixel is compared with
const float MIN_VARIANCE_FRAMES = 2.0;  // fewer tell nothing of how samples differ

// ---- edge-stopping weights --------------------------------------------------------------------------

// A tolerance is the difference that makes a weight 1/e. PLANE_TOLERANCE: distance from the plane in pixel widths,
// beyond what the curvature that the normals show explains (the sagitta).
const float PLANE_TOLERANCE = 1.0;
const float DIFFUSE_NORMAL_TOLERANCE = 0.12;  // 1 - the cosine between normals
const float MIRROR_NORMAL_TOLERANCE = 0.05;  // the same for surfaces seen in mirrors
const float SPECULAR_NORMAL_TOLERANCE = 0.1;  // the same for the specular lobe, over alpha
// The least alpha (squared perceptual roughness) that counts, for certain light and for uncertain light: it is better
// to blur reflections of smooth surfaces than to show their noise, but little in pixels with so short a history that
// the edges of bright reflections aren't known (REFLECTION_EDGES_UNKNOWN).
const float MIN_ALPHA_CONVERGED = 0.003, MIN_ALPHA_NOISY = 0.4, MIN_ALPHA_UNKNOWN_EDGES = 0.04;
const float MATERIAL_TOLERANCE = 0.1;  // of Guide.roughness_or_albedo

// ---- the blur: Dammertz et al. (HPG 2010) ------------------------------------------------------------

const float SIGMA_LUMINANCE = 2.2;  // sigma_l in SVGF
const float CENTER_WEIGHT = 4.0;  // of the 3 x 3 kernel, (1 2 1) x (1 2 1); Dammertz et al. have 5 x 5
const float CONVERGED_NOISE = 0.025;  // standard deviation over mean, below which a pixel is filtered no more
const float MIN_ACCEPTED_RATIO = 0.25;  // FilterSum.accepted_weight over weight_sum
// Correlation of the noise of pixels that a pass averages, by level up to 2: earlier passes share some of their taps.
const float CORRELATION[3] = float[](0.0, 0.081, 0.125);
const float EPSILON = 1e-30;

// The estimated error over the standard deviation of the noise that is left, since the blur also has a bias, which
// falls as one over the root of the history's length: ERROR_OVER_NOISE, plus BIAS_OVER_NOISE at 8 frames. Chosen so
// that the error of about 68 % of the pixels of mirror_hall and other scenes is at most the estimate.
const float ERROR_OVER_NOISE = 1.2;
const float BIAS_OVER_NOISE = 0.2;

#endif
