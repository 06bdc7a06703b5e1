"""Checks of rays and of structures that need a feature, a package or a limit of the device, which not all have."""

from __future__ import annotations

from collections.abc import Iterable

from solari_vk.gpu.frame.raster import NEEDED
from solari_vk.lab.conformance import embree_checks, position_checks, probe_checks, ray_probe_checks, structure_checks
from solari_vk.lab.conformance.cases import Run, by
from solari_vk.lab.conformance.outcomes import ERROR, NOT_RUN, UNSUPPORTED, Check
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import INSTANCES, SHAPES, Probe, call_rule
from solari_vk.lab.conformance.rules import Measurement
from solari_vk.lab.embree import available
from solari_vk.lab.structures import Structures


def probes(run: Run, build_mode: str, stage: str = probe_checks.STAGES[0]) -> Iterable[Measurement]:
    """Single rays by ray queries, in a shader stage, over structures that were built in one of BUILD_MODES."""
    missing = [feature for feature in NEEDED if feature not in run.device.features]
    if stage == "fragment" and missing:
        run.rule.unmeasured(call_rule("ray queries in fragment shaders"), UNSUPPORTED, missing[0])
        return ()

    def measure(run: Run) -> Iterable[Measurement]:
        with Structures(run.device, SHAPES, list(INSTANCES.values()), build_mode) as structures:
            yield from probe_checks.measure_probes(run.shaders, structures, stage, _chosen(PROBES, run.part))

    return by("query", probe_checks.rules(), measure)(run)


def ray_probes(run: Run, build_mode: str) -> Iterable[Measurement]:
    """Single rays by pipelines, over structures that were built in one of BUILD_MODES."""
    culling = ray_probe_checks.CULLING in run.device.features
    asked = [probe for probe in ray_probe_checks.ASKED if culling or not ray_probe_checks.culls(probe)]

    def measure(run: Run) -> Iterable[Measurement]:
        if not culling:
            culling_rules = {ray_probe_checks.rule_of(probe) for probe in ray_probe_checks.ASKED if probe not in asked}
            run.rule.unmeasured(culling_rules, UNSUPPORTED, ray_probe_checks.CULLING)
        chosen = _chosen(asked, run.part)
        with Structures(run.device, SHAPES, list(INSTANCES.values()), build_mode) as structures:
            yield from ray_probe_checks.measure_probes(run.shaders, structures, chosen, culling=culling)

    return by("pipeline", ray_probe_checks.rules(), measure)(run)


def _chosen(probes: Iterable[Probe], part: str) -> list[Probe]:
    return [probe for probe in probes if part in ("", probe.label)]


def parts(check: Check) -> list[str]:
    """The parts by which a check is measured again when the driver didn't survive it: single probes."""
    probing = {
        ("ray_queries", "probes"): PROBES,
        ("ray_queries", "vertex_return"): position_checks.HITTING,
        ("ray_pipelines", "probes"): ray_probe_checks.ASKED,
    }
    return [probe.label for probe in probing.get((check.group, check.case.split("-")[0]), ())]


def embree(run: Run, scene: str) -> Iterable[Measurement]:
    """Random rays against Embree."""
    if available():
        return embree_checks.measure(run.shaders, scene, 10_000_000 if run.full else 100_000)
    run.rule.unmeasured(embree_checks.rules(scene), ERROR, "needs embreex: pip install solari-vk[test]")
    return ()


def vertex_return(run: Run) -> Iterable[Measurement]:
    """The corners of triangles that rays hit."""
    if run.device.has_position_fetch:
        return position_checks.measure_positions(run.shaders, _chosen(position_checks.HITTING, run.part))
    layer = " (hidden by the validation layer)" if run.device.validation else ""
    run.rule.unmeasured(position_checks.RULES.values(), UNSUPPORTED, "rayTracingPositionFetch" + layer)
    return ()


def large_tlas(run: Run, count: int) -> Iterable[Measurement]:
    """A structure of so many instances."""
    limit = int(run.device.properties.acceleration.maxInstanceCount)
    if count > limit:
        run.rule.unmeasured(structure_checks.large_tlas_rule(count), UNSUPPORTED, f"maxInstanceCount is {limit:,}")
    elif count > 100_000 and not run.full:
        run.rule.unmeasured(structure_checks.large_tlas_rule(count), NOT_RUN, "--full measures it")
    else:
        return structure_checks.measure_large_tlas(run.shaders, count)
    return ()
