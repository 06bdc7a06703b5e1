// Lenses that aren't pinholes: how directions become positions of the picture, and back. Positions are in focal lengths
// from the principal point, x right and y down; directions have x right, y down and z forward, as in OpenCV.
// solari_vk/scene/lens.py has the same functions in numpy.
#ifndef SCENE_LENS_GLSL
#define SCENE_LENS_GLSL

#include "common/math.glsl"
#include "scene/camera_block.glsl"

const int NEWTON_STEPS = 12;
const float LENS_TOLERANCE = 1e-7;  // in focal lengths

// Brown, "Close-Range Camera Calibration" (1971), with the further terms of OpenCV. slopes: x / z, y / z.
vec2 distort(vec2 slopes, Lens lens, out mat2 derivative) {
    float x = slopes.x, y = slopes.y, r2 = dot(slopes, slopes);
    vec4 k = lens.high;
    float above = 1.0 + r2 * (lens.low.x + r2 * (lens.low.y + r2 * k.x));
    float below = 1.0 + r2 * (k.y + r2 * (k.z + r2 * k.w));
    float above_slope = lens.low.x + r2 * (2.0 * lens.low.y + 3.0 * r2 * k.x);
    float below_slope = k.y + r2 * (2.0 * k.z + 3.0 * r2 * k.w);
    float scale = above / below, scale_slope = (above_slope * below - above * below_slope) / (below * below);
    vec2 p = lens.low.zw, prism = lens.prism.xz + lens.prism.yw * r2, prism_slope = prism + lens.prism.yw * r2;
    float across = 2.0 * x * y * scale_slope + 2.0 * (p.x * x + p.y * y);
    derivative = mat2(
        scale + 2.0 * x * x * scale_slope + 2.0 * p.x * y + 6.0 * p.y * x + 2.0 * x * prism_slope.x,
        across + 2.0 * x * prism_slope.y,
        across + 2.0 * y * prism_slope.x,
        scale + 2.0 * y * y * scale_slope + 6.0 * p.x * y + 2.0 * p.y * x + 2.0 * y * prism_slope.y
    );
    return slopes * scale + vec2(2.0 * p.x * x * y + p.y * (r2 + 2.0 * x * x), p.x * (r2 + 2.0 * y * y)
        + 2.0 * p.y * x * y) + prism * r2;
}

// By Newton's method.
vec2 undistort(vec2 at, Lens lens) {
    vec2 slopes = at;
    mat2 derivative;
    for (int i = 0; i < NEWTON_STEPS; i++) {
        vec2 error = distort(slopes, lens, derivative) - at;
        slopes -= inverse(derivative) * error;
        if (dot(error, error) < LENS_TOLERANCE * LENS_TOLERANCE) { break; }
    }
    return slopes;
}

// Kannala and Brandt, "A Generic Camera Model and Calibration Method" (2006). The distance from the principal point of
// an angle from the view axis; without distortion the equidistant projection.
float fisheye_radius(float angle, Lens lens) {
    float a2 = angle * angle;
    vec4 k = lens.low;
    return angle * (1.0 + a2 * (k.x + a2 * (k.y + a2 * (k.z + a2 * k.w))));
}

// By Newton's method.
float fisheye_angle(float radius, Lens lens) {
    float angle = min(radius, lens.limit);
    if (lens.low == vec4(0.0)) { return angle; }
    vec4 k = vec4(3.0, 5.0, 7.0, 9.0) * lens.low;
    for (int i = 0; i < NEWTON_STEPS; i++) {
        float a2 = angle * angle, error = fisheye_radius(angle, lens) - radius;
        angle -= error / (1.0 + a2 * (k.x + a2 * (k.y + a2 * (k.z + a2 * k.w))));
        angle = clamp(angle, 0.0, lens.limit);
        if (abs(error) < LENS_TOLERANCE) { break; }
    }
    return angle;
}

// ---- cubes ------------------------------------------------------------------------------------------

// Six faces in a row, each two focal lengths wide. What is right in the picture of a face, below, and ahead: the faces
// of CameraRig.cube.
mat3 cube_face(uint face) {
    float side = (face & 1u) == 0u ? 1.0 : -1.0;
    if (face < 2u) { return mat3(vec3(0.0, 0.0, -side), vec3(0.0, 1.0, 0.0), vec3(side, 0.0, 0.0)); }
    if (face < 4u) { return mat3(vec3(1.0, 0.0, 0.0), vec3(0.0, 0.0, side), vec3(0.0, -side, 0.0)); }
    return mat3(vec3(-side, 0.0, 0.0), vec3(0.0, 1.0, 0.0), vec3(0.0, 0.0, -side));
}

uint cube_face_at(float x) { return uint(clamp(0.5 * x + 3.0, 0.0, 5.0)); }

vec3 cube_direction(vec2 at) {
    uint face = cube_face_at(at.x);
    return normalize(cube_face(face) * vec3(at.x + 5.0 - 2.0 * float(face), at.y, 1.0));
}

vec2 cube_position(vec3 point) {
    vec3 size = abs(point);
    uint face = size.x >= size.y && size.x >= size.z ? (point.x > 0.0 ? 0u : 1u)
        : size.y >= size.z ? (point.y < 0.0 ? 2u : 3u) : (point.z < 0.0 ? 4u : 5u);
    vec3 local = point * cube_face(face);
    return local.xy / local.z + vec2(2.0 * float(face) - 5.0, 0.0);
}

// ---- any lens ---------------------------------------------------------------------------------------

// Where rays of a position start: in omnidirectional stereo on a circle about the camera. Ishiguro, Yamamoto and Tsuji,
// "Omni-Directional Stereo" (1992).
vec3 lens_start(vec2 at, Lens lens) {
    return lens.kind == EQUIRECTANGULAR ? lens.low.x * vec3(cos(at.x), 0.0, -sin(at.x)) : vec3(0.0);
}

// Of length 1; of BROWN_CONRADY with z = 1.
vec3 lens_direction(vec2 at, Lens lens) {
    if (lens.kind == BROWN_CONRADY) { return vec3(undistort(at, lens), 1.0); }
    if (lens.kind == EQUIRECTANGULAR) { return vec3(vec2(sin(at.x), cos(at.x)) * cos(at.y), sin(at.y)).xzy; }
    if (lens.kind == CUBE) { return cube_direction(at); }
    float radius = length(at);
    float angle = lens.kind == STEREOGRAPHIC ? 2.0 * atan(0.5 * radius) : fisheye_angle(radius, lens);
    return vec3(radius > 0.0 ? at * (sin(angle) / radius) : vec2(0.0), cos(angle));
}

// Returns whether the lens sees a point, and where.
bool find_lens_position(vec3 point, Lens lens, out vec2 at) {
    float across = length(point.xy);
    if (lens.kind == BROWN_CONRADY) {
        mat2 derivative;
        at = distort(point.xy / point.z, lens, derivative);
        return point.z > 0.0 && across < lens.limit * point.z;
    }
    if (lens.kind == EQUIRECTANGULAR) {
        // The ray to the point touches the circle on which the eye moves.
        float eye = lens.low.x, away = length(point.xz);
        float along = sqrt(max(away * away - eye * eye, 0.0));
        at = vec2(atan(point.x, point.z) - asin(clamp(eye / max(away, 1e-30), -1.0, 1.0)), atan(point.y, along));
        at.x -= 2.0 * PI * round(at.x / (2.0 * PI));
        return away >= abs(eye);
    }
    if (lens.kind == CUBE) {
        at = cube_position(point);
        return true;
    }
    float angle = atan(across, point.z);
    float radius = lens.kind == STEREOGRAPHIC ? 2.0 * tan(0.5 * angle) : fisheye_radius(angle, lens);
    at = across > 0.0 ? point.xy * (radius / across) : vec2(0.0);
    return angle < lens.limit;
}

#endif
