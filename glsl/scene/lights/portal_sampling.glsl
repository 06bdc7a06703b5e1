// Sampling of directions through portals, openings through which environments light a room: Bitterli, Novak and Jarosz,
// "Portal-Masked Environment Map Sampling" (2015); PortalImageInfiniteLight in pbrt-v4. Each portal has two rectified
// maps of the environment, one for the directions to each side of its plane. Rectified: the coordinates are slopes
// along the portal's sides, so that what any receiver sees through the portal is an axis-aligned window of the map. The
// weight of a window comes from a summed-area table of integers, whose differences are exact.
#ifndef SCENE_LIGHTS_PORTAL_SAMPLING_GLSL
#define SCENE_LIGHTS_PORTAL_SAMPLING_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/choice.glsl"
#include "scene/lights/types.glsl"

struct Portal {
    vec3 corner;
    vec3 side_u, side_v;
    vec3 dual_u, dual_v;  // the dual basis of the sides: dot products with (point - corner) are the point's uv
    vec3 normal;
    float area;
    Words map;      // summed-area tables (2, size + 1, size + 1): solari_vk/bound/lights/portal_maps.py
    uint map_size;  // texels along each edge of a map; 0 without an environment
};

layout(set = 0, scalar) readonly buffer PortalsBlock {
    Portal at[];
} portals;

// The window of a portal's map that a receiver sees through the portal. `uv` are coordinates on the portal, from 0 to 1
// along its sides.
struct MapWindow {
    vec2 receiver_uv;   // of the receiver's projection onto the portal's plane
    vec2 slope_per_uv;
    uint map_offset;    // where the table begins of the map that the receiver sees
    // Texels of which the receiver sees half or more, both ends included. The outermost ones are taken to end at the
    // portal's edges.
    uvec2 first, last;
    uint weight_sum;    // of these texels; 0 if the receiver sees no light
};

// The rectangle on the portal, in uv, through which a receiver sees a texel of the map.
struct TexelRectangle {
    vec2 low, high;
    uint weight;
};

// Whether the scene has portals, and not only those of other worlds.
bool has_portals() { return SCENE_PORTAL && scene_info.first_pass_through_light != scene_info.first_portal; }

// One more than the index of the last portal, of which the first is scene_info.first_portal_record.
uint portal_end() {
    return scene_info.first_portal_record + scene_info.first_pass_through_light - scene_info.first_portal;
}

// The index of a portal's light source.
uint portal_light(uint index) { return scene_info.first_portal + index - scene_info.first_portal_record; }

// The slope at a coordinate of the map, from 0 to 1: the inverse of map_position's a / (1 + |a|).
vec2 slope_at(vec2 position) {
    vec2 from_middle = 2.0 * position - 1.0;
    return from_middle / max(1.0 - abs(from_middle), 1e-7);
}

uint summed_area(Portal portal, MapWindow window, uvec2 end) {
    return portal.map.at[window.map_offset + end.y * (portal.map_size + 1u) + end.x];
}

// The weight of a rectangle of texels, both ends included. Differences of unsigned numbers are exact.
uint weight_of(Portal portal, MapWindow window, uvec2 first, uvec2 last) {
    return summed_area(portal, window, last + 1u) - summed_area(portal, window, uvec2(first.x, last.y + 1u))
        - summed_area(portal, window, uvec2(last.x + 1u, first.y)) + summed_area(portal, window, first);
}

// The position in the map, in texels, that the receiver sees through a point of the portal.
vec2 map_position(Portal portal, MapWindow window, vec2 uv) {
    vec2 slope = (uv - window.receiver_uv) * window.slope_per_uv;
    return float(portal.map_size) * (0.5 + 0.5 * slope / (1.0 + abs(slope)));
}

uvec2 texel_at(Portal portal, MapWindow window, vec2 uv) {
    return clamp(uvec2(map_position(portal, window, uv)), window.first, window.last);
}

MapWindow find_window(Portal portal, vec3 receiver) {
    vec3 from_corner = receiver - portal.corner;
    float height = dot(from_corner, portal.normal);
    MapWindow window;
    window.weight_sum = 0u;
    if (portal.map_size == 0u || !(abs(height) > 1e-20)) { return window; }
    window.receiver_uv = vec2(dot(from_corner, portal.dual_u), dot(from_corner, portal.dual_v));
    window.slope_per_uv = 1.0 / (abs(height) * vec2(length(portal.dual_u), length(portal.dual_v)));
    window.map_offset = height < 0.0 ? 0u : (portal.map_size + 1u) * (portal.map_size + 1u);
    vec2 low = map_position(portal, window, vec2(0.0)), high = map_position(portal, window, vec2(1.0));
    vec2 first = round(low), last = round(high) - 1.0, middle = floor(0.5 * (low + high));
    bvec2 is_narrow = lessThan(last, first);
    float last_of_map = float(portal.map_size) - 1.0;
    window.first = uvec2(clamp(mix(first, middle, is_narrow), 0.0, last_of_map));
    window.last = uvec2(clamp(mix(last, middle, is_narrow), 0.0, last_of_map));
    window.weight_sum = weight_of(portal, window, window.first, window.last);
    return window;
}

TexelRectangle texel_rectangle(Portal portal, MapWindow window, uvec2 texel) {
    vec2 low = window.receiver_uv + slope_at(vec2(texel) / float(portal.map_size)) / window.slope_per_uv;
    vec2 high = window.receiver_uv + slope_at(vec2(texel + 1u) / float(portal.map_size)) / window.slope_per_uv;
    low = mix(low, vec2(0.0), equal(texel, window.first));
    high = mix(high, vec2(1.0), equal(texel, window.last));
    return TexelRectangle(low, high, weight_of(portal, window, texel, texel));
}

// The pdf, over the portal's area, of light samples within a texel's rectangle.
float texel_pdf(TexelRectangle rectangle, Portal portal, MapWindow window) {
    vec2 size = rectangle.high - rectangle.low;
    float area = size.x * size.y * portal.area;
    return area > 0.0 ? float(rectangle.weight) / (float(window.weight_sum) * area) : 0.0;
}

// A row or column chosen by a random number, and that number remapped to [0, 1] within it, as in pbrt's SampleDiscrete.
struct DiscreteSample {
    uint index;
    uint weight;
    float u_remapped;
};

// The weight of the texels of a window before a column (axis 0) or a row (axis 1), up to a constant.
uint weight_before(Portal portal, MapWindow window, uvec2 first, uvec2 last, uint axis, uint at) {
    uvec2 upper = first, lower = last + 1u;
    upper[axis] = lower[axis] = at;
    return summed_area(portal, window, lower) - summed_area(portal, window, upper);
}

// Chooses a column (axis 0) or a row (axis 1) of the texels from `first` to `last` by weight, with a binary search.
DiscreteSample sample_column_or_row(
    Portal portal, MapWindow window, uvec2 first, uvec2 last, uint weight, uint axis, float u
) {
    float chosen = u * float(weight);
    uint low = first[axis], high = last[axis] + 1u, whole = min(uint(chosen), weight - 1u);
    uint start = weight_before(portal, window, first, last, axis, low), before = 0u, end = weight;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        uint up_to_middle = weight_before(portal, window, first, last, axis, middle) - start;
        if (up_to_middle <= whole) {
            low = middle;
            before = up_to_middle;
        } else {
            high = middle;
            end = up_to_middle;
        }
    }
    return DiscreteSample(low, end - before, clamp((chosen - float(before)) / float(end - before), 0.0, 1.0));
}

// Samples a point of the portal in proportion to the light that the receiver sees there, for random numbers in [0, 1).
vec2 sample_window(Portal portal, MapWindow window, vec2 u, out float area_pdf) {
    DiscreteSample column = sample_column_or_row(portal, window, window.first, window.last, window.weight_sum, 0u, u.x);
    uvec2 first = uvec2(column.index, window.first.y), last = uvec2(column.index, window.last.y);
    DiscreteSample row = sample_column_or_row(portal, window, first, last, column.weight, 1u, u.y);
    TexelRectangle rectangle = texel_rectangle(portal, window, uvec2(column.index, row.index));
    area_pdf = texel_pdf(rectangle, portal, window);
    return mix(rectangle.low, rectangle.high, vec2(column.u_remapped, row.u_remapped));
}

// The inverse of sample_window: the random numbers for which it returns a uv.
vec2 invert_window_sample(Portal portal, MapWindow window, vec2 uv) {
    uvec2 texel = texel_at(portal, window, uv);
    TexelRectangle rectangle = texel_rectangle(portal, window, texel);
    vec2 u_remapped = clamp((uv - rectangle.low) / max(rectangle.high - rectangle.low, 1e-20), 0.0, 1.0);
    uint column = weight_of(portal, window, uvec2(texel.x, window.first.y), uvec2(texel.x, window.last.y));
    uint left = texel.x > window.first.x
        ? weight_of(portal, window, window.first, uvec2(texel.x - 1u, window.last.y)) : 0u;
    uint above = texel.y > window.first.y
        ? weight_of(portal, window, uvec2(texel.x, window.first.y), uvec2(texel.x, texel.y - 1u)) : 0u;
    // for each axis: the weight before the texel, its own, and that of all
    vec2 before = vec2(left, above), own = vec2(column, rectangle.weight), all = vec2(window.weight_sum, column);
    return (before + u_remapped * own) / max(all, 1.0);
}

// Where a ray goes through a portal's plane.
struct PortalIntersection {
    float t;       // not above 0 if the ray misses the portal
    float cosine;  // between the ray and the portal's normal, without sign
    vec2 uv;
};

PortalIntersection intersect_portal_plane(Portal portal, vec3 origin, vec3 direction) {
    float cosine = dot(direction, portal.normal);
    float t = dot(portal.corner - origin, portal.normal) / cosine;
    vec3 from_corner = origin + t * direction - portal.corner;
    vec2 uv = vec2(dot(from_corner, portal.dual_u), dot(from_corner, portal.dual_v));
    bool passes = t > 0.0 && t < INFINITY && uv == clamp(uv, 0.0, 1.0);
    return PortalIntersection(passes ? t : -1.0, abs(cosine), uv);
}

bool passes_a_portal(vec3 origin, vec3 direction) {
    for (uint i = scene_info.first_portal_record; i < portal_end(); i++) {
        if (intersect_portal_plane(portals.at[i], origin, direction).t > 0.0) { return true; }
    }
    return false;
}

// The pdf, in solid angle, with which light samples of this portal take a direction, times the portal's probability by
// power; 0 if the ray misses the portal.
float evaluate_portal_pdf(uint index, vec3 origin, vec3 direction) {
    Portal portal = portals.at[index];
    PortalIntersection intersection = intersect_portal_plane(portal, origin, direction);
    if (!(intersection.t > 0.0)) { return 0.0; }
    MapWindow window = find_window(portal, origin);
    if (window.weight_sum == 0u) { return 0.0; }
    TexelRectangle rectangle = texel_rectangle(portal, window, texel_at(portal, window, intersection.uv));
    float probability = light_probability_by_power(light_sources.at[portal_light(index)]);
    return probability * texel_pdf(rectangle, portal, window) * square(intersection.t) / intersection.cosine;
}

// The random numbers for which a light sample of the portal has the direction of a ray that goes through it.
vec2 invert_portal_sample(uint index, vec3 origin, vec3 direction) {
    Portal portal = portals.at[index];
    return invert_window_sample(
        portal, find_window(portal, origin), intersect_portal_plane(portal, origin, direction).uv
    );
}

// The sum of evaluate_portal_pdf over all portals but `left_out`, which may be NO_INDEX.
float sum_portal_pdfs(vec3 origin, vec3 direction, uint left_out) {
    float pdf = 0.0;
    for (uint i = scene_info.first_portal_record; i < portal_end(); i++) {
        if (i != left_out) { pdf += evaluate_portal_pdf(i, origin, direction); }
    }
    return pdf;
}

#endif
