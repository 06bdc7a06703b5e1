"""The conformance suite: each rule can fail, verdicts and reports say what was measured, and both ways in run it."""

from __future__ import annotations

import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from solari_vk import rt
from solari_vk.cli import main
from solari_vk.conformance import (
    api_checks,
    brdf_checks,
    bulk_checks,
    embree_checks,
    light_checks,
    path_checks,
    probe_checks,
    structure_checks,
    worlds,
)
from solari_vk.conformance import probes as told
from solari_vk.conformance.kernels import Kernels
from solari_vk.conformance.probe_table import PROBES
from solari_vk.conformance.probes import INSTANCES, SHAPES
from solari_vk.conformance.report import Report
from solari_vk.conformance.rules import Measurement, Outcome, Rule, rows
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Fault, Recorder
from solari_vk.conformance.worlds import World
from solari_vk.gpu import compiler, instances


@pytest.fixture(scope="module")
def kernels(device):
    with Kernels(device) as made:
        yield made


def patched_root(tmp_path, *patches):
    """A copy of the shaders with seeded bugs: (file, text that it holds once, text put in its place)."""
    root = tmp_path / "glsl"
    shutil.copytree(compiler.glsl_root(), root, ignore=shutil.ignore_patterns("*.spv", "*.json"))
    for file, old, new in patches:
        path = root / file
        text = path.read_text()
        assert text.count(old) == 1, f"{file} has changed: '{old}' must be found once"
        path.write_text(text.replace(old, new))
    return root


@pytest.fixture
def patched(device, tmp_path):
    """patched((file, old, new), ...) -> Kernels over shaders with these seeded bugs."""

    @contextmanager
    def make(*patches):
        with Kernels(device, patched_root(tmp_path, *patches)) as made:
            yield made

    return make


def failing(measurements):
    """The names of the rules that don't hold."""
    return {measured.rule.name for measured in measurements if not measured.holds}


def expect_red(measurements, *parts):
    """Each part is in the name of a rule that fails."""
    names = failing(measurements)
    for part in parts:
        assert any(part in name for name in names), f"{part} must fail; what fails is {sorted(names)}"


def probe(kernels, *, rays=None, records=None, shapes=SHAPES):
    """All measurements of the probes with damaged rays, instance records or shapes."""
    with World(kernels.device, shapes, list(INSTANCES.values()), damage=records) as world:
        return list(probe_checks.measure(*probe_checks.run_probes(kernels, world, damage=rays)))


# ---- the probes can fail ----------------------------------------------------------------------------


def test_there_are_enough_probes_and_they_pass(kernels):
    assert len(PROBES) >= 40
    assert len({item.label for item in PROBES}) == len(PROBES)
    assert not failing(probe(kernels))


def without_flag(flag):
    def damage(rays):
        rays["flags"] &= ~np.uint32(flag)

    return damage


FLAGS = ["FORCE_OPAQUE", "FORCE_NO_OPAQUE", "TERMINATE_ON_FIRST_HIT", "CULL_BACK_FACING", "CULL_FRONT_FACING",
         "CULL_OPAQUE", "CULL_NO_OPAQUE", "SKIP_TRIANGLES", "SKIP_AABBS"]  # fmt: skip


@pytest.mark.parametrize("name", FLAGS)
def test_ignored_flag_is_noticed(kernels, name):
    expect_red(probe(kernels, rays=without_flag(getattr(told, name))), name)


def test_wrong_flag_values_are_noticed(kernels):
    def shift(rays):
        rays["flags"] <<= 1

    expect_red(probe(kernels, rays=shift), "SKIP_CLOSEST_HIT_SHADER", *(name for name in FLAGS if name != "SKIP_AABBS"))


def set_field(**values):
    def damage(rays):
        for field, value in values.items():
            rays[field] = value

    return damage


def normalized(rays):
    rays["direction"] /= np.linalg.norm(rays["direction"], axis=1, keepdims=True)


def without_action(bit):
    def damage(rays):
        rays["action"] &= ~np.uint32(bit)

    return damage


def inclusive(rays):
    rays["t_min"] = np.nextafter(rays["t_min"], np.float32(-1))
    rays["t_max"] = np.nextafter(rays["t_max"], np.float32(np.inf))


RAY_BUGS = {
    "mask dropped": (set_field(cull_mask=0xFF), ["cull_mask"]),
    "t_min dropped": (set_field(t_min=0.0), ["t_min"]),
    "t_max dropped": (set_field(t_max=np.inf), ["t_max"]),
    "range inclusive": (inclusive, ["t_min: only", "t_max: only"]),
    "direction normalized": (normalized, ["dir: t counts", "RayIntersection.t, committed"]),
    "nothing confirmed": (without_action(told.CONFIRM), ["rayQueryConfirmIntersection"]),
    "nothing generated": (
        without_action(told.GENERATE_AT | told.GENERATE_SPHERE),
        ["rayQueryGenerateIntersection"],
    ),
    "nothing terminated": (without_action(told.TERMINATE), ["rayQueryTerminate"]),
    "all confirmed": (lambda rays: np.bitwise_or(rays["action"], told.CONFIRM, out=rays["action"]),
                      ["rayQueryConfirmIntersection", "no flag"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RAY_BUGS)
def test_damaged_ray_is_noticed(kernels, name):
    damage, rules = RAY_BUGS[name]
    expect_red(probe(kernels, rays=damage), *rules)


def masked(field, mask):
    def damage(records):
        records[field] &= np.uint32(mask)

    return damage


def transposed(records):
    records["transform"][:, :, :3] = records["transform"][:, :, :3].transpose(0, 2, 1).copy()


def shifted_by_one(records):
    records[:] = np.roll(records, 1)


def all_active(records):
    records["blas_address"][records["blas_address"] == 0] = records["blas_address"][0]


RECORD_BUGS = {
    "mask dropped": (lambda r: np.bitwise_or(r["custom_index_and_mask"], 0xFF000000, out=r["custom_index_and_mask"]),
                     ["cull_mask"]),
    "custom data of 23 bits": (masked("custom_index_and_mask", 0xFF7FFFFF), ["instance_custom_data, committed"]),
    "no record offset": (masked("sbt_offset_and_flags", 0xFF000000), ["sbt_record_offset, committed"]),
    "no instance flags": (
        masked("sbt_offset_and_flags", 0xFFFFFF),
        ["FLIP_FACING", "FACING_CULL_DISABLE", "FORCE_OPAQUE and FORCE_NO_OPAQUE of instances"],
    ),
    "matrix transposed": (transposed, ["object_to_world, world_to_object"]),
    "one place off": (shifted_by_one, ["instance_index"]),
    "inactive hit": (all_active, ["without a structure"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RECORD_BUGS)
def test_damaged_instance_record_is_noticed(kernels, name):
    damage, rules = RECORD_BUGS[name]
    expect_red(probe(kernels, records=damage), *rules)


def test_damaged_geometry_is_noticed(kernels):
    """Opacity swapped, geometries and primitives in another order."""
    swapped = {name: [replace(part, opaque=not part.opaque) for part in parts] for name, parts in SHAPES.items()}
    expect_red(probe(kernels, shapes=swapped), "no flag", "CULL_OPAQUE", "CandidateAABBOpaque")
    reordered = SHAPES | {"many": SHAPES["many"][::-1], "two lists of boxes": SHAPES["two lists of boxes"][::-1]}
    expect_red(probe(kernels, shapes=reordered), "geometry_index", "geometry_index, committed")


QUERY = "scene/ray_query.glsl"


def test_bugs_in_the_getters_are_noticed(patched):
    """Each bug is in a getter of its own, so that one shader holds them all."""
    bugs = [
        (QUERY, "rayQueryGetIntersectionInstanceCustomIndexEXT(query, COMMITTED))",
         "rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED) + 7)"),
        (QUERY, "found.instance_index = uint(rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED))",
         "found.instance_index = 1u + uint(rayQueryGetIntersectionInstanceIdEXT(query, COMMITTED))"),
        (QUERY, "rayQueryGetIntersectionGeometryIndexEXT(query, COMMITTED)", "0"),
        (QUERY, "= rayQueryGetIntersectionObjectToWorldEXT(query, COMMITTED)",
         "= rayQueryGetIntersectionWorldToObjectEXT(query, COMMITTED)"),
        (QUERY, "rayQueryGetIntersectionBarycentricsEXT(query, COMMITTED)",
         "rayQueryGetIntersectionBarycentricsEXT(query, COMMITTED).yx"),
        (QUERY, "rayQueryGetIntersectionFrontFaceEXT(query, COMMITTED)",
         "!rayQueryGetIntersectionFrontFaceEXT(query, COMMITTED)"),
        ("conformance/probe.glsl", "rayQueryGetIntersectionObjectRayOriginEXT(query, true)",
         "rayQueryGetWorldRayOriginEXT(query)"),
    ]  # fmt: skip
    names = ("instance_custom_data", "instance_index", "geometry_index", "object_to_world", "barycentrics",
             "front_face")  # fmt: skip
    with patched(*bugs) as kernels:
        expect_red(probe(kernels), *(f"RayIntersection.{name}, committed" for name in names), "ObjectRayOrigin")


def test_bugs_in_the_functions_are_noticed(patched):
    """Wrong kinds, the ray mistold, t of the wrong end, and an inverse that isn't one."""
    bugs = [
        (QUERY, "RAY_QUERY_INTERSECTION_GENERATED = 2u", "RAY_QUERY_INTERSECTION_GENERATED = 4u"),
        (QUERY, "RAY_QUERY_INTERSECTION_AABB = 3u", "RAY_QUERY_INTERSECTION_AABB = 2u"),
        (QUERY, "found.t = rayQueryGetIntersectionTEXT(query, COMMITTED)",
         "found.t = 1.00001 * rayQueryGetIntersectionTEXT(query, COMMITTED)"),
        (QUERY, "= rayQueryGetIntersectionWorldToObjectEXT(query, COMMITTED)",
         "= mat4x3(transpose(mat3(rayQueryGetIntersectionObjectToWorldEXT(query, COMMITTED))))"),
        (QUERY, "uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, COMMITTED))",
         "uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, COMMITTED) + 1)"),
        ("conformance/probe.glsl", "answer.t_min = rayQueryGetRayTMinEXT(query)", "answer.t_min = probe.t_max"),
    ]  # fmt: skip
    with patched(*bugs) as kernels:
        expect_red(
            probe(kernels), "a box is a candidate", "RayIntersection.t, committed", "world_to_object, committed",
            "RayIntersection.primitive_index, committed", "OpRayQueryGetRayTMin",
        )  # fmt: skip


# ---- bulk checks can fail ---------------------------------------------------------------------------


def test_bugs_in_tracing_are_noticed(patched, monkeypatch):
    """Off by one against Embree and many instances, t against float64, and rays that are none made whole."""
    bugs = [
        ("conformance/trace.comp", "hit.primitive_index)", "hit.primitive_index + 1u)"),
        ("conformance/trace.comp", "-1.0 : hit.t", "-1.0 : hit.t * 1.001"),
        ("conformance/trace.comp", "Hit(t, hit.instance_custom_data", "Hit(t, hit.instance_custom_data & 0xFFFu"),
        ("conformance/trace.comp", "Ray ray = rays.at[index];", "Ray ray = rays.at[index];\n"
         "    ray.direction = mix(ray.direction, vec3(0.0, 0.0, -1.0), isnan(ray.direction));"),
    ]  # fmt: skip
    with patched(*bugs) as kernels:
        expect_red(bulk_checks.measure_many_instances(kernels, 300), "tell many instances apart")
        expect_red(bulk_checks.measure_extreme_transforms(kernels), "places up to 1e6: t")
        expect_red(bulk_checks.measure_not_finite(kernels), "end and hit nothing")
        if embree_checks.available():
            expect_red(embree_checks.measure(kernels, "instanced", 5000), "is Embree's")


def test_holes_are_noticed(kernels, monkeypatch):
    """A closed surface and a fan without one triangle let rays through."""
    whole = worlds.Triangles
    monkeypatch.setattr(bulk_checks, "Triangles", lambda corners: whole(corners[1:]))
    expect_red(bulk_checks.measure_watertight(kernels), "closed surface: edges", "fan: edges")


def test_bugs_in_structures_are_noticed(kernels, monkeypatch):
    def moved(records):
        records["transform"][3, 0, 3] += 0.01

    expect_red(structure_checks.measure_ways(kernels, moved), *(f"fresh: {way}" for way in worlds.WAYS[1:]))
    half = masked("custom_index_and_mask", 0x0F7FFFFF)
    expect_red(structure_checks.measure_indices(kernels, half), "custom data of 24 bits", "mask of 8 bits")

    def drop_last(records):
        records["custom_index_and_mask"][-1] = 0

    expect_red(structure_checks.measure_tlas_rebuilds(kernels, drop_last), "last built with")
    made = worlds.TriangleGeometry
    for seeded in ({"indices": 0}, {"position_stride": 12}, {"transform": 0}):
        with monkeypatch.context() as patch:
            patch.setattr(worlds, "TriangleGeometry", lambda *a, seeded=seeded, **k: made(*a, **{**k, **seeded}))
            expect_red(structure_checks.measure_formats(kernels), "index formats")
    records_of = worlds.instance_records
    with monkeypatch.context() as patch:
        patch.setattr(worlds, "instance_records", lambda placed, addresses: records_of(
            [replace(item, active=True) for item in placed], addresses))  # fmt: skip
        expect_red(structure_checks.measure_nothing(kernels), "never hit")
    with monkeypatch.context() as patch:
        def swapped(placed, addresses):
            return records_of(placed, dict(zip(addresses, [*list(addresses.values())[1:], 0], strict=True)))

        patch.setattr(worlds, "instance_records", swapped)
        patch.setattr(structure_checks, "instance_records", swapped)
        expect_red(structure_checks.measure_many_blases(kernels, 20), "one batch", "many batches", "compacted")


def test_bugs_in_the_order_rules_are_noticed(kernels, monkeypatch):
    """A rebuilt Blas not seen, custom data of 25 bits, a preparation that a rebuild doesn't end."""
    usable = rt.Tlas.check_usable

    def lenient(tlas):
        if not tlas.built or tlas.destroyed or any(blas.destroyed for blas in tlas.blases):
            usable(tlas)

    monkeypatch.setattr(rt.Tlas, "check_usable", lenient)
    monkeypatch.setattr(instances, "CUSTOM_DATA_BITS", 25)
    monkeypatch.setattr(rt.Blas, "_drop_preparation", lambda blas: None)
    expect_red(api_checks.measure_order(kernels), "else refused", "first 24 bits")
    expect_red(api_checks.measure_compaction(kernels), "prepare_compaction")


# ---- light can fail ---------------------------------------------------------------------------------


def test_bugs_in_the_brdf_are_noticed(device, tmp_path):
    """Energy lost, a density without its Jacobian, a value that isn't reciprocal: one shader holds them all."""
    bugs = [
        ("scene/brdf.glsl", "brdf.multiscatter = 1.0 / (ab.x + ab.y) - 1.0", "brdf.multiscatter = 0.0"),
        ("scene/microfacet.glsl", "return 0.5 / (k", "return 1.0 / (k"),
        ("scene/brdf.glsl", "(1.0 - specular_albedo(brdf.dielectric_f0, ab))", "1.0"),
    ]
    with ShaderRunner(device, patched_root(tmp_path, *bugs)) as shaders:
        expect_red(brdf_checks.measure_furnace(shaders, 1.0), "white furnace")
        expect_red(brdf_checks.measure_draws(shaders, [(0.5, 1.0, 60.0)], 50_000), "draws follow")
        expect_red(brdf_checks.measure_numbers(shaders, 20_000), "diffuse is reciprocal")


def test_bugs_in_lights_are_noticed(device, tmp_path, monkeypatch):
    """A light's chance mistold."""
    bug = ("scene/sampling.glsl", "float inverse_light_pdf = float(", "float inverse_light_pdf = 1.0 + float(")
    root = patched_root(tmp_path, bug)
    monkeypatch.setattr(compiler, "glsl_root", lambda: root)
    expect_red(light_checks.measure_lamp(device, "nee"), "floor, nee: mean", "floor, nee: tiles")
    expect_red(light_checks.measure_sun(device, 0.0093, "nee"), "nee: mean")
    expect_red(light_checks.measure_invariance(device), "in two parts")


def test_bugs_in_the_path_tracer_are_noticed(device, tmp_path, monkeypatch):
    """Survivors' energy kept down, and rays that start where they are."""
    bugs = [
        ("passes/pathtracer/trace.comp", "throughput /= survival;", ""),
        ("scene/surface.glsl", "16.0 * ROUNDING_UNIT * dot(world_reach", "0.0 * dot(world_reach"),
    ]
    root = patched_root(tmp_path, *bugs)
    monkeypatch.setattr(compiler, "glsl_root", lambda: root)
    expect_red(path_checks.measure_series(device, 5, ["mis"]), "after 5 bounces, mis")
    expect_red(path_checks.measure_light_tight(device, ["far"]), "light-tight, far")


def test_seeds_without_effect_are_noticed(device, monkeypatch):
    take = path_checks.take_picture
    monkeypatch.setattr(path_checks, "take_picture", lambda *a, seed, **options: take(*a, seed=0, **options))
    expect_red(path_checks.measure_seeds(device), "another seed")


# ---- verdicts and reports ---------------------------------------------------------------------------

RULE, OTHER = Rule("a rule", "a document", "a section"), Rule("another | rule", "a document", "a section")
GOOD, BAD = Measurement(RULE, 0.5, 1.0, "of it"), Measurement(RULE, 2.0, 1.0, "of it", "here")
FAULT = Fault("llvmpipe", "a r*", "seen with this and that")


def verdict(recorder):
    """What `conclude` raises, by its kind."""
    try:
        recorder.conclude()
    except (pytest.fail.Exception, pytest.skip.Exception, pytest.xfail.Exception) as raised:
        return type(raised).__name__, str(raised)
    return "pass", ""


def test_verdicts():
    for faults, measured, expected in (
        ([], GOOD, "pass"), ([], BAD, "Failed"), ([FAULT], BAD, "XFailed"), ([FAULT], GOOD, "Failed"),
        ([], Measurement(RULE, float("nan"), 1.0), "Failed"),
    ):  # fmt: skip
        recorder = Recorder("group", "case", faults)
        recorder(measured)
        assert verdict(recorder)[0] == expected, (faults, measured)
    missing = Recorder("group", "", [])
    missing.unsupported(RULE, "someFeature")
    assert verdict(missing) == ("Skipped", "a rule (someFeature)")


def test_report_tells_the_worst_case(device):
    outcomes = [
        Outcome("group", RULE, "pass", "one", GOOD), Outcome("group", RULE, "FAIL", "two", BAD),
        Outcome("group", OTHER, "unsupported", reason="<feature>"),
        Outcome("late", OTHER, "known fault", "", BAD, "why"),
    ]  # fmt: skip
    made = Report(device, rows(outcomes), False, 1.0)
    assert made.verdict() == "3 rules: 1 unsupported, 1 known fault, 1 FAIL"
    text, page, markdown = made.text(), made.html(), made.markdown()
    assert "here [two]" in text
    assert "2 of it" in text
    assert "&lt;feature&gt;" in page
    assert "another \\| rule" in markdown
    assert all(part in markdown for part in (device.name, device.properties.driver, "a document, a section", "why"))


def test_command_runs_a_group_and_writes_its_reports(any_device, tmp_path):
    junit, markdown, html = (tmp_path / f"report.{suffix}" for suffix in ("xml", "md", "html"))
    command = [sys.executable, "-m", "solari_vk", "conformance", "--only", "acceleration_structures"]
    command += ["--junit", junit, "--markdown", markdown, "--html", html]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TlasInstance: mask of 8 bits" in done.stdout
    assert "| TlasInstance: mask of 8 bits | wgpu ray tracing" in markdown.read_text()
    assert html.read_text().startswith("<!doctype html>")
    properties = ElementTree.parse(junit).getroot().iter("property")
    assert {"pass: 0 wrong, bar 0"} <= {item.get("value") for item in properties}


def test_pytest_runs_the_same(any_device, tmp_path):
    command = [sys.executable, "-m", "pytest", "--pyargs", "solari_vk.conformance", "-k", "indices"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "TlasInstance: custom data of 24 bits" in done.stdout


def test_wrong_use_is_told(any_device, tmp_path, capsys, monkeypatch):
    assert main(["conformance", "--only", "nonsense"]) == 2
    assert "ray_queries" in capsys.readouterr().err
    assert main(["conformance", "--html", str(tmp_path / "none" / "report.html")]) == 2
    assert main(["conformance", "--device", "no such device"]) == 3
    monkeypatch.setitem(sys.modules, "pytest", None)
    assert main(["conformance"]) == 2
    assert "pip install solari-vk[test]" in capsys.readouterr().err
