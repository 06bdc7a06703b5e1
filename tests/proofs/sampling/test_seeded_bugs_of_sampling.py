"""Seeded bugs in random numbers, packing and surfaces: the check that should notice each must fail."""

from __future__ import annotations

import test_distributions as distributions
import test_packing as packing
import test_random as random_numbers
import test_ray_offsets as ray_offsets
import test_surface as surface
from support.seeded_bugs import Bug, bug_tests, with_shaders

RANDOM, PACKING, SURFACE, MATH = (
    "common/random.glsl", "common/packing.glsl", "scene/surface.glsl", "common/math.glsl",
)  # fmt: skip


test_a_seeded_bug_is_noticed = bug_tests({
    "generators": (with_shaders(random_numbers.test_generators), Bug(RANDOM, "pcg", "return correct(v) ^ (v & 1u);")),
    "ranges": (with_shaders(random_numbers.test_generators), Bug(
        RANDOM, "rand_range_u", "return correct(max(n, 1u) - 1u, rng);")),
    "disks": (with_shaders(distributions.test_disk), Bug(
        RANDOM, "sample_disk", "return correct(vec2(u.x * u.x, u.y));")),
    "hemispheres": (with_shaders(distributions.test_hemispheres), Bug(
        RANDOM, "sample_uniform_hemisphere", "return sample_cosine_hemisphere(u);")),
    "barycentrics": (with_shaders(distributions.test_barycentrics), Bug(
        RANDOM, "sample_triangle_barycentrics", "return correct(vec2(u.x * u.x, u.y));")),
    "cones": (with_shaders(distributions.test_cone, 0.01, (0, 0, 1)), Bug(
        RANDOM, "sample_cone", "return correct(axis, 2.0 * one_minus_cos_half_angle, u);")),
    "packing of numbers": (with_shaders(packing.test_packings), Bug(
        PACKING, "pack_rgb9e5", "return correct(color * 0.999);")),
    "packing of directions": (with_shaders(packing.test_packings), Bug(PACKING, "octahedral_wrap", "return v;")),
    "bent normals": (with_shaders(surface.test_bent_normals), Bug(SURFACE, "bend_shading_normal", "return normal;")),
    "heuristics": (with_shaders(surface.test_heuristics), Bug(
        MATH, "power_heuristic", "return f * f / (f * f + g * g);")),
    "offsets": (with_shaders(ray_offsets.test_offsets, 1e-3), Bug(
        SURFACE, "world_ray_offset", "return 0.1 * correct(reach, world_from_object, cofactors, object_normal);")),
    "offsets of lights": (with_shaders(ray_offsets.test_offsets, 1.0), Bug(
        "scene/light_visibility.glsl", "light_segment", "return light_sample.world_position - ray_origin;")),
}, quick=("disks", "packing of directions"))  # fmt: skip
