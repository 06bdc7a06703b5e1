"""The rules of bulk rays, vertex return and acceleration structures fail with seeded bugs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from seeded_bugs import expect_red, failing, masked

from solari_vk import rt
from solari_vk.conformance import bulk_checks, embree_checks, position_checks, structure_checks, worlds
from solari_vk.conformance.faults import known_faults
from solari_vk.conformance.position_checks import HITTING
from solari_vk.conformance.recorder import Recorder
from solari_vk.conformance.rules import FAIL, Check
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device

TRACE = "passes/conformance/trace.comp"


def test_bugs_in_tracing_are_noticed(patched, monkeypatch):
    """Wrong primitives, t and custom data, and NaN in directions replaced by numbers."""
    bugs = [
        (TRACE, "hit.primitive_index)", "hit.primitive_index + 1u)"),
        (TRACE, "-1.0 : hit.t", "-1.0 : hit.t * 1.001"),
        (TRACE, "Hit(t, hit.instance_custom_data", "Hit(t, hit.instance_custom_data & 0xFFFu"),
        ("passes/conformance/probe.glsl", "Probe probe = probes.at[index];", "Probe probe = probes.at[index];\n"
         "    probe.direction = mix(probe.direction, vec3(0.0, 0.0, -1.0), isnan(probe.direction));"),
    ]  # fmt: skip
    with patched(*bugs) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        sizes = (f"size {size} at all" for size in ("1e-06", "1", "1e+06"))
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t", *sizes)
        expect_red(bulk_checks.measure_thin_triangles(shaders), "rays at the middle of such triangles")
        expect_red(bulk_checks.measure_not_finite(shaders), "empty range) hit nothing")
        if embree_checks.available():
            expect_red(embree_checks.measure(shaders, "instanced", 5000, small=True), "is Embree's")


def test_missed_extremes_are_noticed(patched):
    """Rays with directions shorter than 0.001 hit nothing."""
    bug = (TRACE, "Ray ray = rays.at[index];", "Ray ray = rays.at[index];\n"
           "    ray.t_max = length(ray.direction) < 1e-3 ? 0.0 : ray.t_max;")  # fmt: skip
    with patched(bug) as shaders:
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin")


def test_missed_thin_triangles_are_noticed(patched):
    """One ray in 500 hits nothing, and t is wrong by a hundred thousandth."""
    bug = (TRACE, "Ray ray = rays.at[index];", "Ray ray = rays.at[index];\n"
           "    ray.t_max = index % 500u == 3u ? 0.0 : ray.t_max;")  # fmt: skip
    with patched(bug) as shaders:
        hit, t = bulk_checks.measure_thin_triangles(shaders)
    assert (hit.measured, t.holds) == (4, True)
    with patched((TRACE, "-1.0 : hit.t", "-1.0 : hit.t * 1.00001")) as shaders:
        hit, t = bulk_checks.measure_thin_triangles(shaders)
    assert (hit.holds, t.holds) == (True, False)


def test_holes_are_noticed(shaders, monkeypatch):
    """Rays pass through a closed surface and a fan that lack one triangle."""
    whole = worlds.Triangles
    monkeypatch.setattr(bulk_checks, "Triangles", lambda corners: whole(corners[1:]))
    expect_red(bulk_checks.measure_watertight(shaders), "closed surface: edges", "fan: edges")


POSITIONS = "passes/conformance/positions.comp"


def changed_vertices(which, expression):
    """A seeded bug: returned vertex i is this expression of the found vertices and i."""
    getter, field = f"get{which}HitVertexPositions(query)", f"vertices.{which.lower()}"
    changed = f"for (int i = 0; i < 3; i++) {field}[i] = {expression}"
    return POSITIONS, f"{field} = {getter};", f"{{ vec3 found[3] = {getter}; {changed}; }}"


def on_both(expression):
    return [changed_vertices(which, expression.format(which)) for which in ("Committed", "Candidate")]


POSITION_BUGS = {
    "none": on_both("vec3(0.0)"),
    "another order": on_both("found[2 - i]"),
    "in world space": on_both("rayQueryGet{}Intersection(query).object_to_world * vec4(found[i], 1.0)"),
}


@pytest.fixture
def fetching(plain_device):
    """A device that returns vertices. It has no validation: Debian 12's layer is older than the extension."""
    if not plain_device.has_position_fetch:
        pytest.skip("the device returns no vertices (rayTracingPositionFetch)")
    return plain_device


@pytest.mark.parametrize("name", POSITION_BUGS)
def test_bugs_in_vertex_return_are_noticed(patched, fetching, name):
    with patched(*POSITION_BUGS[name], device=fetching) as shaders:
        measured = list(position_checks.measure_positions(shaders, HITTING))
    expect_red(measured, *(rule.name for rule in position_checks.RULES.values()))
    if name == "in world space":  # an error larger than the known fault's is a failure
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
