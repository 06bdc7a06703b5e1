"""The rules of bulk rays, vertex return, acceleration structures and pipelines' records fail with seeded bugs."""

from __future__ import annotations

from dataclasses import replace

import pytest
from red_rules import changed, expect_red, failing, masked
from support.seeded_bugs import Bug

from solari_vk import rt
from solari_vk.gpu.device.device import Device
from solari_vk.lab import structures
from solari_vk.lab.conformance import bulk_checks, embree_checks, position_checks, ray_pipeline_checks, structure_checks
from solari_vk.lab.conformance.faults import known_faults
from solari_vk.lab.conformance.outcomes import FAIL, Check
from solari_vk.lab.conformance.position_checks import HITTING
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.embree import available
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import BUILD_MODES, Triangles

TRACE = ("passes/conformance/trace.comp", "trace_ray")
WRONG_HITS = Bug(
    *TRACE,
    "ray.direction = mix(ray.direction, vec3(0.0, 0.0, -1.0), isnan(ray.direction)); Hit hit = correct(ray); "
    "hit.t *= hit.t < 0.0 ? 1.0 : 1.001; hit.primitive++; hit.custom_data &= 0xFFFu; return hit;",
)
SHORT_DIRECTIONS_MISS = Bug(*TRACE, "if (length(ray.direction) < 1e-3) { ray.t_max = 0.0; } return correct(ray);")
FEW_MISS = Bug(*TRACE, "if (gl_GlobalInvocationID.x % 500u == 3u) { ray.t_max = 0.0; } return correct(ray);")
T_A_LITTLE_OFF = Bug(*TRACE, "Hit hit = correct(ray); hit.t *= hit.t < 0.0 ? 1.0 : 1.00001; return hit;")
BY_PIPELINE = Bug("passes/conformance/trace.rchit", "main", "correct(); hit.t *= 1.001; hit.instance++;")


@pytest.mark.slow
def test_bugs_in_tracing_are_noticed(patched, ray_shaders):
    """Wrong primitives, t and custom data; rays with short directions that hit nothing."""
    with patched(WRONG_HITS) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        sizes = (f"size {size} at all" for size in ("1e-06", "1", "1e+06"))
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t", *sizes)
        expect_red(bulk_checks.measure_thin_triangles(shaders), "rays at the middle of such triangles")
        if available():
            expect_red(embree_checks.measure(shaders, "instanced", 5000, small=True), "is Embree's")
    with patched(SHORT_DIRECTIONS_MISS) as shaders:
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin")
    assert not failing(bulk_checks.measure_many_instances(ray_shaders, 300))
    with patched(BY_PIPELINE, device=ray_shaders.device) as shaders:
        expect_red(bulk_checks.measure_many_instances(shaders, 300), "custom data and index of each")
        cut = masked("custom_index_and_mask", 0xFF00FFFF)
        expect_red(structure_checks.measure_indices(shaders, cut), "custom_data keeps its 24 bits")
        expect_red(bulk_checks.measure_extreme_transforms(shaders), "from the origin: t")


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
    whole = Triangles
    monkeypatch.setattr(bulk_checks, "Triangles", lambda corners: whole(corners[1:]))
    expect_red(bulk_checks.measure_watertight(shaders), "closed surface: edges", "fan: edges")


def changed_vertices(new):
    """A seeded bug: vertex i of `found`, the vertices of a candidate and of the committed hit, is `new`."""
    parts = (
        f"found = vertices.{part}; for (int i = 0; i < 3; i++) {{ vertices.{part}[i] = {new}; }}"
        for part in ("candidate", "committed")
    )
    text = f"Vertices vertices = correct(probe); vec3[3] {' '.join(parts)} return vertices;"
    return Bug("passes/conformance/positions.comp", "find_vertices", text)


POSITION_BUGS = {"another order": changed_vertices("found[2 - i]"), "elsewhere": changed_vertices("found[i] + 7.0")}


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


def test_debug_builds_and_unplaced_vertices(fetching, monkeypatch):
    """Debug builds return the same vertices. A driver that returns vertices without their geometry's transform fails;
    the table is changed to simulate it."""
    known = {rule.name for (_, several), rule in position_checks.RULES.items() if several}
    whole = position_checks.SHAPES
    build = position_checks.Structures
    unplaced = {
        name: [replace(p, transform=None) if isinstance(p, Triangles) else p for p in parts]
        for name, parts in whole.items()
    }
    with ShaderRunner(fetching) as shaders:
        measured = list(position_checks.measure_positions(shaders, HITTING))
        assert not failing(measured) - known
        assert list(position_checks.measure_positions(shaders, HITTING, rt.RAY_QUERY_DEBUG)) == measured
        monkeypatch.setattr(position_checks, "Structures", lambda device, _, placed: build(device, whole, placed))
        monkeypatch.setattr(position_checks, "SHAPES", unplaced)
        expect_red(position_checks.measure_positions(shaders, HITTING), "Committed", "one geometry")


# ---- structures -------------------------------------------------------------------------------------


def moved(records):
    records["transform"][3, 0, 3] += 0.01


def drop_last(records):
    records["custom_index_and_mask"][-1] = 0


def test_bugs_in_structures_are_noticed(shaders, monkeypatch):
    beyond_16_bits, half = (masked("custom_index_and_mask", mask) for mask in (0xFF00FFFF, 0x0F7FFFFF))
    expect_red(structure_checks.measure_large_tlas(shaders, 70_000, beyond_16_bits), "a Tlas of 70,000")
    expect_red(structure_checks.measure_build_modes(shaders, moved), *(f"structure: {way}" for way in BUILD_MODES[1:]))
    expect_red(structure_checks.measure_indices(shaders, half), "custom_data keeps", "mask keeps")
    expect_red(structure_checks.measure_tlas_rebuilds(shaders, drop_last), "last built with")
    with Device() as fresh, ShaderRunner(fresh) as runner:  # in used memory Mesa 26.2 crashes
        expect_red(structure_checks.measure_inactive_instances(runner, drop_last), "hides no other instance")
    made, records_of = structures.TriangleGeometry, structures.instance_records
    for seeded in ({"indices": 0}, {"position_stride": 12}, {"transform": 0}):
        with monkeypatch.context() as patch:
            patch.setattr(structures, "TriangleGeometry", lambda *a, seeded=seeded, **k: made(*a, **{**k, **seeded}))
            expect_red(structure_checks.measure_formats(shaders), "index formats")

    def all_active(placed, addresses):
        return records_of([replace(item, active=True) for item in placed], addresses)

    def swapped(placed, addresses):
        return records_of(placed, dict(zip(addresses, [*list(addresses.values())[1:], 0], strict=True)))

    monkeypatch.setattr(structures, "instance_records", all_active)
    expect_red(structure_checks.measure_nothing(shaders), "never hit")
    for module in (structures, structure_checks):
        monkeypatch.setattr(module, "instance_records", swapped)
    expect_red(structure_checks.measure_many_blases(shaders, 20), "one batch", "many batches", "compacted")


# ---- ray pipelines ----------------------------------------------------------------------------------


def lowered(field):
    """Damage: values of a field that need more than four bits are one more."""

    def damage(sent):
        sent[field] += sent[field] > 15

    return damage


def test_wrong_records_are_noticed(ray_shaders):
    assert not failing(ray_pipeline_checks.measure_records(ray_shaders))
    for damage, rule in (
        (changed(offset=0), "hit records"),
        (changed(stride=0), "hit records"),
        (changed(miss=0), "miss records"),
        (lowered("offset"), "have four bits"),
        (lowered("stride"), "have four bits"),
    ):
        expect_red(ray_pipeline_checks.measure_records(ray_shaders, damage), rule)


WRONG_LAUNCH = Bug("passes/conformance/launch.rmiss", "main", "told = Told(gl_LaunchIDEXT.yxz, gl_LaunchSizeEXT);")
REPORT_HIT = ("passes/conformance/report.rchit", "main")
REPORT_BUGS = {
    "get the attributes": Bug(*REPORT_HIT, "correct(); found.attributes = attributes.yxzw;"),
    "nearest accepted one is hit": Bug(*REPORT_HIT, "correct(); found.t += 1.0;"),
    "reportIntersectionEXT accepts": Bug(
        "passes/conformance/report.rint", "main", "correct(); reported.at[gl_LaunchIDEXT.x].accepted = 7u;"
    ),
}


@pytest.mark.slow
def test_wrong_launches_and_reports_are_noticed(ray_shaders, patched):
    assert not failing(ray_pipeline_checks.measure_launches(ray_shaders))
    with patched(WRONG_LAUNCH, device=ray_shaders.device) as shaders:
        expect_red(ray_pipeline_checks.measure_launches(shaders), "gl_LaunchIDEXT", "TraceRaysIndirect")
    red = failing(ray_pipeline_checks.measure_reports(ray_shaders))
    assert not {rule for rule in red if "keeps its" not in rule}
    for rule, bug in REPORT_BUGS.items():
        with patched(bug, device=ray_shaders.device) as shaders:
            expect_red(ray_pipeline_checks.measure_reports(shaders), rule)
