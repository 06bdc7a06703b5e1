// Which pixel an invocation computes. With MANY_VIEWS the pictures of all views are one above the other in a strip, so
// that a buffer of the strip's pixels is an array (views, height, width).
#ifndef PASSES_STRIP_GLSL
#define PASSES_STRIP_GLSL

#include "common/pixel.glsl"
#include "scene/camera_block.glsl"

// From a pixel of the strip: the pixel within its view, and its element in buffers. Chooses the view. Returns false
// outside of the strip. With a single view the strip is its picture.
bool find_pixel(inout uvec2 pixel, out uint index) {
#ifdef MANY_VIEWS
    uvec2 size = views.at[0].current.size;
    if (!is_inside(pixel, uvec2(size.x, size.y * uint(views.at.length())))) { return false; }
    index = pixel_index(pixel, size);
    view_index = pixel.y / size.y;
    pixel.y -= view_index * size.y;
    return true;
#else
    index = pixel_index(pixel, camera.size);
    return is_inside(pixel, camera.size);
#endif
}

#endif
