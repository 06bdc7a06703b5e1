// What shaders know of a camera, and of a frame that it sees.
#ifndef SCENE_CAMERA_RECORDS_GLSL
#define SCENE_CAMERA_RECORDS_GLSL

#extension GL_EXT_scalar_block_layout : require

// The kinds, in the order of KINDS in solari_vk/scene/lens.py. The depth of PINHOLE and BROWN_CONRADY is measured along
// the view axis, that of the others along the ray.
const uint PINHOLE = 0u, BROWN_CONRADY = 1u, FISHEYE = 2u, STEREOGRAPHIC = 3u, EQUIRECTANGULAR = 4u, CUBE = 5u;

struct Lens {
    uint kind;
    float limit;    // what it sees: up to this angle from the view axis, of BROWN_CONRADY up to this slope
    float reach;    // how far from the principal point that is in the picture
    vec4 low;       // distortion: k1, k2, p1, p2, or of FISHEYE k1 to k4; EQUIRECTANGULAR: x, how far right the eye is
    vec4 high;      // k3 to k6
    vec4 prism;     // s1 to s4
};

struct Camera {
    mat4x3 world_from_view;  // the camera looks along -z, y up
    mat4x3 view_from_world;
    // Horizontal, vertical; of orthographic ones half the width and the height in meters, of lenses in focal
    // lengths.
    vec2 tan_half_fov;
    float near;              // distance of the near plane
    float orthographic_range;  // 0 for perspective; else how far raster sees behind the near plane
    float lens_radius;       // 0 where all is sharp
    float focus_distance;    // along the view axis, of wide lenses along the ray
    uint aperture_blades;    // the corners of the aperture; 0 for a disk
    float aperture_rotation;
    uvec2 size;              // in pixels, of what is rendered
    uvec2 picture_size;      // in pixels, of the picture that is made of it
    // Offset of this frame's samples from the pixels' positions, in pixels: the sum of FrameValues.sample_jitter, of
    // the jitter that the user gives the camera, and of principal_shift.
    vec2 jitter;
    vec2 principal_shift;    // by which the principal point lies beside the middle, in pixels
    vec2 lens_offset;        // in meters: the point of the lens through which all rays of this frame pass
    Lens lens;
};

struct FrameValues {
    uint index;             // counts the renderer's frames, and is never reset
    uint seed;
    uint has_history;       // 0 in the first frame and after a reset
    float exposure;
    float lighting_change;  // share of the lights' power that appeared, disappeared or moved in recent frames
    float expected_change;  // share of the light, about, that changed in recent frames by edits of the scene
    uint blended_changed;   // 1 when a blended instance changed, came or went since the previous frame
    vec2 sample_jitter;     // within the pixels, for antialiasing: a part of Camera.jitter
    // Change since the previous frame of the jitter that the user gives the camera, in pixels of the picture.
    vec2 user_jitter_change;
    uint shutter_state;     // below
    uvec2 exposed_rows;     // of the picture, if there is a shutter: the first one, and the one after the last
};

// A picture with a shutter is the mean of frames that show the scene at times of its exposure.
const uint NO_SHUTTER = 0u, FIRST_OF_EXPOSURE = 1u, LATER_OF_EXPOSURE = 2u;
const uint AFTER_EXPOSURE = 3u;  // no shutter, but the previous frame had one

// A view of shaders with MANY_VIEWS, which render many pictures in one frame.
struct View {
    Camera current;
    Camera previous;  // that of the previous frame; the same as `current` after a cut
    FrameValues frame;
    uint world;           // into world_structures
    uint first_instance;  // of the world, into instances
    uint previous_first_instance;  // the same in the previous frame
};

#endif
