"""The rules of bulk rays, vertex return and acceleration structures fail with seeded bugs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from red_rules import expect_red, failing, masked
from support.seeded_bugs import Bug

from solari_vk import rt
from solari_vk.conformance import bulk_checks, embree_checks, position_checks, structure_checks, worlds
from solari_vk.conformance.faults import known_faults
from solari_vk.conformance.position_checks import HITTING
from solari_vk.conformance.recorder import Recorder
from solari_vk.conformance.rules import FAIL, Check
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device

TRACE = ("passes/conformance/trace.comp", "trace_ray")
WRONG_HITS = Bug(
    *TRACE, "ray.direction = mix(ray.direction, vec3(0.0, 0.0, -1.0), isnan(ray.direction)); Hit hit = correct(ray); "
    "hit.t *= hit.t < 0.0 ? 1.0 : 1.001; hit.primitive++; hit.custom_data &= 0xFFFu; return hit;",
)  # fmt: skip
SHORT_DIRECTIONS_MISS = Bug(*TRACE, "if (length(ray.direction) < 1e-3) { ray.t_max = 0.0; } return correct(ray);")
FEW_MISS = Bug(*TRACE, "if (gl_GlobalInvocationID.x % 500u == 3u) { ray.t_max = 0.0; } return correct(ray);")
T_A_LITTLE_OFF = Bug(*TRACE, "Hit hit = correct(ray); hit.t *= hit.t < 0.0 ? 1.0 : 1.00001; return hit;")


@pytest.mark.slow
def test_bugs_in_tracing_are_noticed(patched):
    """Wrong primitives, t and custom data."""
    with patched(WRONG_HITS) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        sizes = (f"size {size} at all" for size in ("1e-06", "1", "1e+06"))
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t", *sizes)
        expect_red(bulk_checks.measure_thin_triangles(shaders), "rays at the middle of such triangles")
        if embree_checks.available():
            expect_red(embree_checks.measure(shaders, "instanced", 5000, small=True), "is Embree's")


@pytest.mark.slow
def test_missed_extremes_are_noticed(patched):
    with patched(SHORT_DIRECTIONS_MISS) as shaders:
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin")


@pytest.mark.slow
def test_missed_thin_triangles_are_noticed(patched):
    """One ray in 500 hits nothing, and t is wrong by a hundred thousandth."""
    with patched(FEW_MISS) as shaders:
        hit, t = bulk_checks.measure_thin_triangles(shaders)
    assert (hit.measured, t.holds) == (4, True)
    with patched(T_A_LITTLE_OFF) as shaders:
        hit, t = bulk_checks.measure_thin_triangles(shaders)
    assert (hit.holds, t.holds) == (True, False)


def test_holes_are_noticed(shaders, monkeypatch):
    """Rays pass through a closed surface and a fan that lack one triangle."""
    whole = worlds.Triangles
    monkeypatch.setattr(bulk_checks, "Triangles", lambda corners: whole(corners[1:]))
    expect_red(bulk_checks.measure_watertight(shaders), "closed surface: edges", "fan: edges")


def changed_vertices(changed):
    """A seeded bug: vertex i of `found`, the vertices of a candidate and of the committed hit, is `changed`."""
    return Bug(
        "passes/conformance/positions.comp", "find_vertices",
        "Vertices vertices = correct(probe); vec3[3] found = vertices.candidate; "
        f"for (int i = 0; i < 3; i++) {{ vertices.candidate[i] = {changed}; }} found = vertices.committed; "
        f"for (int i = 0; i < 3; i++) {{ vertices.committed[i] = {changed}; }} return vertices;",
    )  # fmt: skip


POSITION_BUGS = {
    "none": changed_vertices("vec3(0.0)"), "another order": changed_vertices("found[2 - i]"),
    "elsewhere": changed_vertices("found[i] + 7.0"),
}  # fmt: skip


@pytest.fixture
def fetching(plain_device):
    """A device that returns vertices. It has no validation: Debian 12's layer is older than the extension."""
    if not plain_device.has_position_fetch:
        pytest.skip("the device returns no vertices (rayTracingPositionFetch)")
    return plain_device


@pytest.mark.slow
@pytest.mark.parametrize("name", POSITION_BUGS)
def test_bugs_in_vertex_return_are_noticed(patched, fetching, name):
    with patched(POSITION_BUGS[name], device=fetching) as shaders:
        measured = list(position_checks.measure_positions(shaders, HITTING))
    expect_red(measured, *(rule.name for rule in position_checks.RULES.values()))
    if name == "elsewhere":  # an error larger than the known fault's is a failure
        outcomes = []
        Recorder(Check("ray_queries", ""), known_faults("llvmpipe Mesa 25.0"), outcomes.append)(measured)
        assert {outcome.status for outcome in outcomes} == {FAIL}


def test_debug_build_returns_the_same_vertices(fetching):
    with ShaderRunner(fetching) as shaders:
        release, debug = (
            list(position_checks.measure_positions(shaders, HITTING, header)) for header in ("", rt.RAY_QUERY_DEBUG)
        )
    assert release == debug


def test_unplaced_vertices_are_noticed(fetching, monkeypatch):
    """A driver that returns vertices without their geometry's transform fails; the table is changed to simulate it."""
    with ShaderRunner(fetching) as shaders:
        assert not failing(position_checks.measure_positions(shaders, HITTING)) - {
            rule.name for (_, several), rule in position_checks.RULES.items() if several
        }
        unplaced = {
            name: [replace(p, transform=None) if isinstance(p, worlds.Triangles) else p for p in parts]
            for name, parts in position_checks.SHAPES.items()
        }
        of_world = position_checks.SHAPES
        world = position_checks.World
        monkeypatch.setattr(position_checks, "World", lambda device, _, placed: world(device, of_world, placed))
        monkeypatch.setattr(position_checks, "SHAPES", unplaced)
        expect_red(position_checks.measure_positions(shaders, HITTING), "Committed", "one geometry")


def test_bugs_in_large_tlas_are_noticed(shaders):
    def beyond_16_bits(records):
        records["custom_index_and_mask"] &= np.uint32(0xFF00FFFF)

    expect_red(structure_checks.measure_large_tlas(shaders, 70_000, beyond_16_bits), "a Tlas of 70,000")


def test_bugs_in_structures_are_noticed(shaders, monkeypatch):
    def moved(records):
        records["transform"][3, 0, 3] += 0.01

    expect_red(structure_checks.measure_ways(shaders, moved), *(f"structure: {way}" for way in worlds.WAYS[1:]))
    half = masked("custom_index_and_mask", 0x0F7FFFFF)
    expect_red(structure_checks.measure_indices(shaders, half), "custom_data keeps", "mask keeps")

    def drop_last(records):
        records["custom_index_and_mask"][-1] = 0

    expect_red(structure_checks.measure_tlas_rebuilds(shaders, drop_last), "last built with")
    with Device() as fresh, ShaderRunner(fresh) as runner:  # in used memory Mesa 26.2 crashes
        expect_red(structure_checks.measure_inactive_instances(runner, drop_last), "hides no other instance")
    made = worlds.TriangleGeometry
    for seeded in ({"indices": 0}, {"position_stride": 12}, {"transform": 0}):
        with monkeypatch.context() as patch:
            patch.setattr(worlds, "TriangleGeometry", lambda *a, seeded=seeded, **k: made(*a, **{**k, **seeded}))
            expect_red(structure_checks.measure_formats(shaders), "index formats")
    records_of = worlds.instance_records
    with monkeypatch.context() as patch:
        patch.setattr(worlds, "instance_records", lambda placed, addresses: records_of(
            [replace(item, active=True) for item in placed], addresses))  # fmt: skip
        expect_red(structure_checks.measure_nothing(shaders), "never hit")
    with monkeypatch.context() as patch:

        def swapped(placed, addresses):
            return records_of(placed, dict(zip(addresses, [*list(addresses.values())[1:], 0], strict=True)))

        patch.setattr(worlds, "instance_records", swapped)
        patch.setattr(structure_checks, "instance_records", swapped)
        expect_red(structure_checks.measure_many_blases(shaders, 20), "one batch", "many batches", "compacted")
