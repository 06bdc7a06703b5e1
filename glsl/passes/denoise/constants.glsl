// The numbers of the denoiser, each with what it was chosen by: a paper, or a section of docs/denoising.md. Those
// without a source of their own were chosen together, by the errors in its section "Measured".
#ifndef PASSES_DENOISE_CONSTANTS_GLSL
#define PASSES_DENOISE_CONSTANTS_GLSL

// ---- the previous frame: Schied et al., "Spatiotemporal Variance-Guided Filtering" (HPG 2017) ---------

// Largest distance from a surface's plane, in widths of a pixel: of the surface itself, of the same surface at another
// sample of the pixel ("Pixels that are new"), and of where it shows the same reflection.
const float SAME_PLANE = 1.5, PLANE_OF_ALTERNATE = 2.5, PLANE_OF_REFLECTION = 8.0;
const float SAME_NORMAL = 0.9;    // smallest cosine between normals
const float SAME_MATERIAL = 0.1;
const float FARTHEST = 1e6;       // depth of what is nowhere

// Reflections: Zhdan, "ReBLUR" (2021); measured: "Reflections in dielectrics and rough metals".
const float ONLY_SURFACE_MOTION = 0.8;  // perceptual roughness from which reflections move like their surface
const float ONLY_VIRTUAL_MOTION = 0.5;
const float NORMALS_OF_LOBE = 0.1;      // 1 - the cosine between normals, over the squared roughness
const float UNCERTAIN = 0.3;            // share of a pixel by which a reflection's place may be off
const float INVERSE_OF_INFINITY = 1e-9; // 1 / distance of light from the environment

// ---- changes of light: Schied et al., "Gradient Estimation" (HPG 2018); measured: "Lights that change" ----

const float RECENT = 0.2;             // weight of a frame in LobeHistory.recent
const float RECENT_VARIANCE = 0.111;  // of LobeHistory.recent over that of a frame: RECENT / (2 - RECENT)
const float MIN_FRAMES = 3.0;         // shorter histories tell nothing
const int WIDEST = 2;                 // cells from the center of the widest block
// Standard deviations between which a difference becomes certain; and the same where all light may have changed.
const vec2 CERTAIN = vec2(3.5, 6.0), CERTAIN_AFTER_CHANGE = vec2(0.5, 1.5);
const float EXPONENT = 16.0;          // of the share of light that didn't change
const float FEW = 8.0;                // pixels

// ---- what is uncertain, and outliers; measured: "Why the world cache isn't a prior for new pixels" ----

const float NEIGHBORHOOD = 4.0;  // frames that the neighborhood's spread counts for
const float OWN_WEIGHT = 4.0;    // of a pixel in its neighborhood
const float SETTLED = 40.0;      // frames from which a pixel's own spread tells enough
const float NEIGHBORS_LIMIT = 2.0, BLOCK_LIMIT = 4.0;
const float ALIKE = 0.1;         // least weight of the neighbors that a pixel is compared with
const float FEW_FRAMES = 2.0;    // fewer tell nothing of how samples differ

// ---- how alike surfaces are; measured: "Edges of bright reflections" ----------------------------------

// Distance from the surface's plane, in widths of a pixel, beyond that of a surface that bends as the normals turn.
const float PLANE_TOLERANCE = 1.0;
const float DIFFUSE_NORMAL_TOLERANCE = 0.12;  // 1 - the cosine between normals
const float MIRROR_NORMAL_TOLERANCE = 0.05;   // the same for surfaces seen in mirrors
const float SPECULAR_NORMAL_TOLERANCE = 0.1;  // the same for the specular lobe, over its squared roughness
// The least squared roughness that counts, for certain light and for uncertain light: it is better to blur reflections
// of smooth surfaces than to show their noise, but little in new pixels and settled ones, in which the edges of bright
// reflections aren't known.
const float CERTAIN_ALPHA = 0.003, UNCERTAIN_ALPHA = 0.4, NARROW_ALPHA = 0.04;
const float MATERIAL_TOLERANCE = 0.1;

// ---- the blur: Dammertz et al. (HPG 2010); measured: "Edges of bright reflections" ---------------------

const float TOLERANCE = 2.2;    // standard deviations
const float CENTER_WEIGHT = 4.0;
const float CLEAN = 0.025;      // standard deviation over mean
const float TOO_LITTLE = 0.25;  // share of the neighbors' weight that is taken
// Of the noise of the pixels that a pass averages, by its level, since earlier passes averaged some of the same pixels.
const float CORRELATION[3] = float[](0.0, 0.081, 0.125);
const float DARKEST = 1e-30;    // keeps quotients of black finite

// The error over the deviation of the noise that is left, since the blur has an error of its own: chosen so that about
// 68 % of the pixels of mirror_hall and other scenes are within one standard error; measured: "Estimated errors".
const float ERROR_OVER_NOISE = 1.38;

#endif
