"""Rays by compute shaders against Embree in files of others; the rules of the group fail with seeded bugs."""

from __future__ import annotations

import pytest
from red_rules import expect_red, failing
from support.seeded_bugs import Bug

import solari_vk as sv
from solari_vk.gpu.trees import tree
from solari_vk.lab.conformance import bulk_checks, embree_checks, structure_checks
from solari_vk.lab.embree import available
from solari_vk.lab.shader_runner import ShaderRunner

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not available(), reason="needs embreex: pip install solari-vk[test]"),
]
RAYS = 100_000  # of each of three aims
FILES = (
    "FlightHelmet/FlightHelmet.gltf",
    "AnisotropyBarnLamp/AnisotropyBarnLamp.gltf",
    "Fox/Fox.glb",
    "khronos_tests/SheenCloth.glb",
    "kaykit_dungeon/shelf_large.glb",
)


@pytest.fixture(scope="module", params=["", "shaderFloat64"])
def compute(any_device, request):
    """A device that traces by compute shaders, with and without doubles."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOLARI_VK_HIDDEN_FEATURES", request.param)
        with sv.Device(validation=True, rays="compute") as opened:
            yield opened


@pytest.mark.parametrize("name", FILES)
def test_files_are_hit_where_embree_hits_them(compute, asset, name):
    with ShaderRunner(compute) as shaders:
        assert not failing(embree_checks.measure_exactly(shaders, sv.load(asset(name)), RAYS, name))


TRACE = "scene/trace_compute.glsl"
MISSES_EDGES = Bug(
    TRACE,
    "meets_triangle",
    "return correct(ray, triangle, found, front_face) && min(min(found.y, found.z), 1.0 - found.y - found.z) > 1e-6;",
)
BUGS = {
    "at edges": MISSES_EDGES,
    "at vertices": MISSES_EDGES,
    "anywhere": Bug(TRACE, "meets_box", "return correct(ray, low, high, t_min, t_max, near) && near > 0.1;"),
    "lie in their": Bug(
        TRACE, "meets_triangle", "bool met = correct(ray, triangle, found, front_face); found.x *= 1.00001; return met;"
    ),
    "closed surface: edges": MISSES_EDGES,
    "fan: vertex": MISSES_EDGES,
    "index of each": Bug(
        TRACE,
        "hit_in_object_space",
        "Hit hit = correct(flat_hit, slots, origin, direction); hit.instance -= uint(hit.instance > 2u); return hit;",
    ),
}


def measured(shaders):
    """A part of the group."""
    yield from embree_checks.measure_exactly(shaders, "rooms", 10_000)
    yield from bulk_checks.measure_watertight(shaders)
    yield from bulk_checks.measure_many_instances(shaders, 300)
    yield from structure_checks.measure_inactive_instances(shaders)


@pytest.mark.parametrize("rule", BUGS)
def test_bugs_are_noticed(compute, patched, rule):
    tree._kernels.clear()  # which know shaders without the bug
    try:
        with patched(BUGS[rule], device=compute) as shaders:
            expect_red(measured(shaders), rule)
    finally:
        tree._kernels.clear()
