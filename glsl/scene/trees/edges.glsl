// Where a ray meets the plane of a triangle, and whether it does so within the triangle, by the exact signs of its
// edges, so that neighbors leave no gap between them: Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection"
// (2013).
#ifndef SCENE_TREES_EDGES_GLSL
#define SCENE_TREES_EDGES_GLSL

// A triangle as the ray sees it: x and y of its vertices where the ray is the z axis, and their depths.
struct SeenTriangle {
    vec2 p;
    vec2 q;
    vec2 r;
    vec3 z;
};

#ifndef WITHOUT_DOUBLES
// found: t, and the weights of the second and third vertex. depth_scale: t of a depth of 1.
bool meets_edges(SeenTriangle seen, float depth_scale, out vec3 found, out bool front_face) {
    precise dvec2 P = dvec2(seen.p), Q = dvec2(seen.q), R = dvec2(seen.r);
    precise double u = R.x * Q.y - R.y * Q.x, v = P.x * R.y - P.y * R.x, w = Q.x * P.y - Q.y * P.x;
    bool any_below = u < 0.0 || v < 0.0 || w < 0.0, any_above = u > 0.0 || v > 0.0 || w > 0.0;
    precise double determinant = u + (v + w);
    front_face = determinant > 0.0;
    precise dvec3 depth = double(depth_scale) * dvec3(seen.z);
    precise double t = (u * depth.x + v * depth.y) + w * depth.z;
    precise float area = float(determinant);
    found = vec3(float(t / determinant), float(v) / area, float(w) / area);
    return determinant != 0.0 && !(any_below && any_above);
}
#else
// A number as the sum of two, for devices without 64-bit numbers: Dekker, "A Floating-Point Technique for Extending the
// Available Precision" (1971). Signs are exact, or 0 where the exact number is far below the rounding of its terms.
struct Pair {
    float high;  // the sum, rounded
    float low;
};

Pair pair_product(float a, float b) {
    // Halves of their digits have exact products.
    precise float scaled_a = 4097.0 * a, scaled_b = 4097.0 * b;
    precise float high_a = scaled_a - (scaled_a - a), high_b = scaled_b - (scaled_b - b);
    precise float low_a = a - high_a, low_b = b - high_b;
    precise float product = a * b;
    precise float error = ((high_a * high_b - product) + high_a * low_b + low_a * high_b) + low_a * low_b;
    return Pair(product, error);
}

Pair pair_of(float high, float low) {
    precise float sum = high + low;
    precise float error = low - (sum - high);
    return Pair(sum, error);
}

Pair pair_sum(Pair a, Pair b) {
    precise float sum = a.high + b.high;
    precise float of_b = sum - a.high;
    precise float error = (a.high - (sum - of_b)) + (b.high - of_b);
    precise float low = error + (a.low + b.low);
    return pair_of(sum, low);
}

Pair pair_product(Pair a, Pair b) {
    Pair product = pair_product(a.high, b.high);
    precise float low = product.low + (a.high * b.low + a.low * b.high);
    return pair_of(product.high, low);
}

float pair_quotient(Pair a, Pair b) {
    precise float quotient = a.high / b.high;
    Pair product = pair_product(Pair(quotient, 0.0), b);
    precise float rest = (a.high - product.high) + (a.low - product.low);
    precise float better = quotient + rest / b.high;
    return better;
}

bool meets_edges(SeenTriangle seen, float depth_scale, out vec3 found, out bool front_face) {
    // By a power of two to a size near 1, so that no product's digits get lost.
    vec2 size = max(max(abs(seen.p), abs(seen.q)), abs(seen.r));
    uint exponent = min(floatBitsToUint(max(size.x, size.y)) & 0x7F800000u, 0x7E800000u);
    float scale = uintBitsToFloat(0x7F000000u - exponent);
    vec2 p = scale * seen.p, q = scale * seen.q, r = scale * seen.r;
    Pair u = pair_sum(pair_product(r.x, q.y), pair_product(-r.y, q.x));
    Pair v = pair_sum(pair_product(p.x, r.y), pair_product(-p.y, r.x));
    Pair w = pair_sum(pair_product(q.x, p.y), pair_product(-q.y, p.x));
    bool any_below = u.high < 0.0 || v.high < 0.0 || w.high < 0.0;
    bool any_above = u.high > 0.0 || v.high > 0.0 || w.high > 0.0;
    Pair determinant = pair_sum(u, pair_sum(v, w));
    front_face = determinant.high > 0.0;
    Pair t = pair_sum(
        pair_sum(
            pair_product(u, pair_product(depth_scale, seen.z.x)), pair_product(v, pair_product(depth_scale, seen.z.y))
        ),
        pair_product(w, pair_product(depth_scale, seen.z.z))
    );
    found = vec3(pair_quotient(t, determinant), vec2(v.high, w.high) / determinant.high);
    return determinant.high != 0.0 && !(any_below && any_above);
}
#endif

#endif
