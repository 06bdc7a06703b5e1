// The numbers of antialiasing. Those without a source of their own were chosen together, by the errors that
// `solari-vk bench denoise` measures.
#ifndef PASSES_TAA_CONSTANTS_GLSL
#define PASSES_TAA_CONSTANTS_GLSL

// ---- samples ------------------------------------------------------------------------------------------

// Standard deviations of the Gaussian of a first sample, in pixels of the picture.
const float SOFTNESS = 0.5, SOFTNESS_OF_BLENDED = 1.0;
// Ratios of luminances up to which samples count whole: of two surfaces, and first samples of the same surface.
const float EXCHANGED = 16.0, EXCHANGED_ON_SURFACE = 8.0;
const float MIN_NORMAL_COSINE = 0.9;
const float INTERPOLATED = 0.125;    // weight of an interpolated sample
const float UNEXPOSED = 1e-6;        // the same of one at whose time the shutter is closed
const float ENOUGH = 8.0;            // samples that need no interpolated ones beside them, nor softening at rest
const float MIN_STRATIFIED = 0.5;    // share of a pixel's samples from which strata tell its picture

const float COVERED = 32.0;          // samples up to which rays tell what covers a pixel at rest
const float CLEAR_DIFFERENCE = 0.5;  // of the luminances of two strata, over their sum

const float JUMP = 0.0625;           // from frame to frame, in heights of the picture

// ---- the history ----------------------------------------------------------------------------------------

const float LONGEST = 63.0;            // samples in a mean: the largest that is packed
const float LONGEST_IN_MOTION = 15.0;  // the same where resampling would blur a longer one
// The sum of differences over the largest that it can be, between which they count as common.
const float ALONG_LINES = 0.8, OVER_AREAS = 0.95;

// Of a change of samples from frame to frame: standard deviations up to which it counts as noise, and from which as a
// change; and the least share of the samples that it must be. The first of each pair of numbers is for edits of the
// scene that change hardly any of its light, the second for those that change EXPECTED_CHANGE of it or more.
const vec2 NOISE_SIGMAS = vec2(3.5, 0.5), CHANGE_SIGMAS = vec2(6.0, 1.5);
const float EXPECTED_CHANGE = 0.25;
const float MIN_CHANGE = 0.15, MIN_EXPECTED_CHANGE = 0.03;
const float CHANGE_EXPONENT = 16.0;  // the share of the history that is kept is what didn't change, to this power
const float MIN_CHANNEL = 0.1;       // of the brightest one: darker channels of a color count as this bright

// What is believed: Salvi, "An Excursion in Temporal Supersampling" (GDC 2016).
const float BOX = 1.25;             // half width of the box of colors that are believed, in standard deviations
const float SUSPECT = 0.5;          // share of the box beyond which changes are looked for,
const float UNNOTICED = 0.05;       // if the nearest sample differs by more
const float DENOISED_ERROR = 0.02;  // of the samples, over their mean

#endif
