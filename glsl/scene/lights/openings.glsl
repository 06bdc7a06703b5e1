// The openings of portals, through which receivers see parts of the environment: Bitterli, Novak and Jarosz,
// "Portal-Masked Environment Map Sampling" (2015). Each portal has maps of the light behind it and before it,
// rectified, so that any receiver sees a rectangle of them: its coordinates are slopes against the portal's sides. Sums
// over rectangles come from a summed-area table of whole numbers, in which nothing is lost to rounding.
#ifndef SCENE_LIGHTS_OPENINGS_GLSL
#define SCENE_LIGHTS_OPENINGS_GLSL

#include "common/math.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/choice.glsl"
#include "scene/lights/types.glsl"

struct Portal {
    vec3 corner;
    vec3 side_u, side_v;
    vec3 across_u, across_v;  // their dot products with a place, from the corner, are its coordinates along the sides
    vec3 normal;
    float area;
    Words map;        // (side, size + 1, size + 1): solari_vk/bound/lights/portal_maps.py
    uint map_size;    // texels along each side; 0 without an environment
};

layout(set = 0, scalar) readonly buffer PortalsBlock {
    Portal at[];
} portals;

// What a receiver sees through a portal. Places on the portal go from 0 to 1 along its sides.
struct Outlook {
    vec2 receiver;         // the place nearest to it in the portal's plane
    vec2 slope_per_place;
    uint map_side;         // where the map begins of the side that it sees
    uvec2 first, last;     // texels of the map: those of which it sees half or more; the outer ones reach to the edges
    uint weight;           // the sum of their weights; 0 if it sees no light
};

// A texel of the map as a receiver sees it through the portal: a rectangle of places.
struct Pane {
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

vec2 slope_at(vec2 position) {
    vec2 from_middle = 2.0 * position - 1.0;
    return from_middle / max(1.0 - abs(from_middle), 1e-7);
}

uint summed_area(Portal portal, Outlook seen, uvec2 end) {
    return portal.map.at[seen.map_side + end.y * (portal.map_size + 1u) + end.x];
}

// The weight of a rectangle of texels, both ends included. Differences of unsigned numbers are exact.
uint weight_of(Portal portal, Outlook seen, uvec2 first, uvec2 last) {
    return summed_area(portal, seen, last + 1u) - summed_area(portal, seen, uvec2(first.x, last.y + 1u))
        - summed_area(portal, seen, uvec2(last.x + 1u, first.y)) + summed_area(portal, seen, first);
}

// In texels of the map.
vec2 map_position(Portal portal, Outlook seen, vec2 place) {
    vec2 slope = (place - seen.receiver) * seen.slope_per_place;
    return float(portal.map_size) * (0.5 + 0.5 * slope / (1.0 + abs(slope)));
}

uvec2 texel_at(Portal portal, Outlook seen, vec2 place) {
    return clamp(uvec2(map_position(portal, seen, place)), seen.first, seen.last);
}

Outlook look_through(Portal portal, vec3 receiver) {
    vec3 from_corner = receiver - portal.corner;
    float height = dot(from_corner, portal.normal);
    Outlook seen;
    seen.weight = 0u;
    if (portal.map_size == 0u || !(abs(height) > 1e-20)) { return seen; }
    seen.receiver = vec2(dot(from_corner, portal.across_u), dot(from_corner, portal.across_v));
    seen.slope_per_place = 1.0 / (abs(height) * vec2(length(portal.across_u), length(portal.across_v)));
    seen.map_side = height < 0.0 ? 0u : (portal.map_size + 1u) * (portal.map_size + 1u);
    vec2 low = map_position(portal, seen, vec2(0.0)), high = map_position(portal, seen, vec2(1.0));
    vec2 first = round(low), last = round(high) - 1.0, middle = floor(0.5 * (low + high));
    bvec2 is_narrow = lessThan(last, first);
    float last_of_map = float(portal.map_size) - 1.0;
    seen.first = uvec2(clamp(mix(first, middle, is_narrow), 0.0, last_of_map));
    seen.last = uvec2(clamp(mix(last, middle, is_narrow), 0.0, last_of_map));
    seen.weight = weight_of(portal, seen, seen.first, seen.last);
    return seen;
}

Pane pane_of(Portal portal, Outlook seen, uvec2 texel) {
    vec2 low = seen.receiver + slope_at(vec2(texel) / float(portal.map_size)) / seen.slope_per_place;
    vec2 high = seen.receiver + slope_at(vec2(texel + 1u) / float(portal.map_size)) / seen.slope_per_place;
    low = mix(low, vec2(0.0), equal(texel, seen.first));
    high = mix(high, vec2(1.0), equal(texel, seen.last));
    return Pane(low, high, weight_of(portal, seen, texel, texel));
}

// The density over the portal's area with which light samples of a receiver take places of a pane.
float density_in(Pane pane, Portal portal, Outlook seen) {
    vec2 size = pane.high - pane.low;
    float area = size.x * size.y * portal.area;
    return area > 0.0 ? float(pane.weight) / (float(seen.weight) * area) : 0.0;
}

// The step of a sum that a random number chooses, and the number's rest within the step, from 0 to 1.
struct ChosenStep {
    uint at;
    uint weight;
    float rest;
};

// The weight of what lies before a column (axis 0) or a row (axis 1) in the other axis's range, up to a constant.
uint weight_before(Portal portal, Outlook seen, uvec2 first, uvec2 last, uint axis, uint at) {
    uvec2 upper = first, lower = last + 1u;
    upper[axis] = lower[axis] = at;
    return summed_area(portal, seen, lower) - summed_area(portal, seen, upper);
}

// Chooses a column or a row of a rectangle of texels by weight.
ChosenStep choose_step(Portal portal, Outlook seen, uvec2 first, uvec2 last, uint weight, uint axis, float u) {
    float chosen = u * float(weight);
    uint low = first[axis], high = last[axis] + 1u, whole = min(uint(chosen), weight - 1u);
    uint start = weight_before(portal, seen, first, last, axis, low), before = 0u, end = weight;
    while (high - low > 1u) {
        uint middle = (low + high) / 2u;
        uint up_to_middle = weight_before(portal, seen, first, last, axis, middle) - start;
        if (up_to_middle <= whole) {
            low = middle;
            before = up_to_middle;
        } else {
            high = middle;
            end = up_to_middle;
        }
    }
    return ChosenStep(low, end - before, clamp((chosen - float(before)) / float(end - before), 0.0, 1.0));
}

// A place on the portal, in proportion to the light behind it, for random numbers in [0, 1).
vec2 sample_place(Portal portal, Outlook seen, vec2 u, out float density) {
    ChosenStep column = choose_step(portal, seen, seen.first, seen.last, seen.weight, 0u, u.x);
    uvec2 first = uvec2(column.at, seen.first.y), last = uvec2(column.at, seen.last.y);
    ChosenStep row = choose_step(portal, seen, first, last, column.weight, 1u, u.y);
    Pane pane = pane_of(portal, seen, uvec2(column.at, row.at));
    density = density_in(pane, portal, seen);
    return mix(pane.low, pane.high, vec2(column.rest, row.rest));
}

// The random numbers for which `sample_place` takes a place.
vec2 invert_sample_place(Portal portal, Outlook seen, vec2 place) {
    uvec2 texel = texel_at(portal, seen, place);
    Pane pane = pane_of(portal, seen, texel);
    vec2 rest = clamp((place - pane.low) / max(pane.high - pane.low, 1e-20), 0.0, 1.0);
    uint column = weight_of(portal, seen, uvec2(texel.x, seen.first.y), uvec2(texel.x, seen.last.y));
    uint columns = texel.x > seen.first.x
        ? weight_of(portal, seen, seen.first, uvec2(texel.x - 1u, seen.last.y)) : 0u;
    uint rows = texel.y > seen.first.y
        ? weight_of(portal, seen, uvec2(texel.x, seen.first.y), uvec2(texel.x, texel.y - 1u)) : 0u;
    vec2 before = vec2(columns, rows), own = vec2(column, pane.weight), all = vec2(seen.weight, column);
    return (before + rest * own) / max(all, 1.0);
}

// Where a ray passes a portal's plane.
struct Crossing {
    float t;  // of the ray; not above 0: it doesn't pass the portal
    float cosine;
    vec2 place;
};

Crossing cross_portal(Portal portal, vec3 origin, vec3 direction) {
    float cosine = dot(direction, portal.normal);
    float t = dot(portal.corner - origin, portal.normal) / cosine;
    vec3 from_corner = origin + t * direction - portal.corner;
    vec2 place = vec2(dot(from_corner, portal.across_u), dot(from_corner, portal.across_v));
    bool passes = t > 0.0 && t < INFINITY && place == clamp(place, 0.0, 1.0);
    return Crossing(passes ? t : -1.0, abs(cosine), place);
}

bool passes_a_portal(vec3 origin, vec3 direction) {
    for (uint i = scene_info.first_portal_record; i < portal_end(); i++) {
        if (cross_portal(portals.at[i], origin, direction).t > 0.0) { return true; }
    }
    return false;
}

// The density in solid angle with which light samples take the direction by this portal, where they choose it by power;
// 0: the ray doesn't pass it.
float density_of_opening(uint index, vec3 origin, vec3 direction) {
    Portal portal = portals.at[index];
    Crossing crossing = cross_portal(portal, origin, direction);
    if (!(crossing.t > 0.0)) { return 0.0; }
    Outlook seen = look_through(portal, origin);
    if (seen.weight == 0u) { return 0.0; }
    Pane pane = pane_of(portal, seen, texel_at(portal, seen, crossing.place));
    float probability = light_probability_by_power(light_sources.at[portal_light(index)]);
    return probability * density_in(pane, portal, seen) * square(crossing.t) / crossing.cosine;
}

// The random numbers for which a light sample of the portal has the direction of a ray that passes it.
vec2 numbers_of_opening(uint index, vec3 origin, vec3 direction) {
    Portal portal = portals.at[index];
    return invert_sample_place(
        portal, look_through(portal, origin), cross_portal(portal, origin, direction).place
    );
}

// The sum of the densities of all portals but one; NO_INDEX: of all.
float pdf_of_openings(vec3 origin, vec3 direction, uint left_out) {
    float density = 0.0;
    for (uint i = scene_info.first_portal_record; i < portal_end(); i++) {
        if (i != left_out) { density += density_of_opening(i, origin, direction); }
    }
    return density;
}

#endif
