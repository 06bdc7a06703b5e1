// Which pixel of which view an invocation computes, and where a view's pixels are in the frame's buffers and images.
// With MANY_VIEWS a dispatch covers the pictures of all views in a grid. Images have the same grid; in buffers one view
// follows the other, so that a buffer is an array (views, height, width). Passes know a pixel by its place within its
// view, so that nothing of one view reaches another.
#ifndef PASSES_VIEWS_GLSL
#define PASSES_VIEWS_GLSL

#include "common/pixel.glsl"
#include "scene/camera_block.glsl"

#ifdef MANY_VIEWS

uvec2 view_tile = uvec2(0u);  // of the invocation's view: its place in the grid

// The element of a place within the view, in buffers that have `size` elements for each view.
uint element_index(uvec2 place, uvec2 size) { return pixel_index(place, size) + view_index * (size.x * size.y); }

// Where a pixel of the view is in images.
ivec2 texel_of(uvec2 pixel) { return ivec2(pixel + view_tile * camera.size); }

uint view_count() { return uint(views.at.length()); }

void choose_view(uint index) {
    view_index = index;
    view_tile = uvec2(index % views.columns, index / views.columns);
    world_index = views.at[index].world;
}

// From a place in the grid of all views: the place within its view, and its element in buffers that have `size`
// elements for each view. Chooses the view. Returns false outside of all views.
bool find_element(inout uvec2 place, uvec2 size, out uint index) {
    uvec2 tile = place / size;
    uint view = tile.y * views.columns + tile.x;
    if (tile.x >= views.columns || view >= view_count()) { return false; }
    choose_view(view);
    place -= tile * size;
    index = element_index(place, size);
    return true;
}

// From an element in buffers: the place within its view, which is chosen.
uvec2 find_place_of(uint index, uvec2 size) {
    uint places = size.x * size.y;
    choose_view(index / places);
    index %= places;
    return uvec2(index % size.x, index / size.x);
}

#else

uint view_count() { return 1u; }

void choose_view(uint index) {}

#define element_index pixel_index
#define texel_of ivec2

bool find_element(uvec2 place, uvec2 size, out uint index) {
    index = pixel_index(place, size);
    return is_inside(place, size);
}

uvec2 find_place_of(uint index, uvec2 size) { return uvec2(index % size.x, index / size.x); }

#endif

// Turns an invocation's place in the grid of all views into the pixel within its view, which is chosen, and the pixel's
// element in buffers. Returns false outside of all views.
bool find_pixel(inout uvec2 pixel, out uint index) { return find_element(pixel, camera.size, index); }

// From a pixel's element in buffers: the pixel within its view, which is chosen.
uvec2 find_pixel_of(uint index) { return find_place_of(index, camera.size); }

#endif
