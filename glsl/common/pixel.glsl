// Pixels of a picture, and their elements in buffers.
#ifndef COMMON_PIXEL_GLSL
#define COMMON_PIXEL_GLSL

// As unsigned numbers, coordinates below 0 are large.
bool is_inside(uvec2 pixel, uvec2 size) { return all(lessThan(pixel, size)); }

uint pixel_index(uvec2 pixel, uvec2 size) { return pixel.y * size.x + pixel.x; }

#endif
