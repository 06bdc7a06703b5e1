"""Checks of rays and of structures that depend on the profile, or on a feature, a package or a limit."""

from __future__ import annotations

from collections.abc import Iterable

from solari_vk.gpu.frame.raster import NEEDED
from solari_vk.lab.conformance import (
    bulk_checks,
    embree_checks,
    position_checks,
    probe_checks,
    ray_probe_checks,
    structure_checks,
)
from solari_vk.lab.conformance.cases import CheckContext, by
from solari_vk.lab.conformance.outcomes import ERROR, NOT_RUN, UNSUPPORTED, Check, Measurement
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import INSTANCES, SHAPES, Probe, call_rule
from solari_vk.lab.embree import available
from solari_vk.lab.structures import Structures


def probes(context: CheckContext, build_mode: str, stage: str = probe_checks.STAGES[0]) -> Iterable[Measurement]:
    """Single rays by ray queries, in a shader stage, over structures that were built in one of BUILD_MODES."""
    # A device may trace rays and yet lack what a raster pass needs.
    missing = [feature for feature in NEEDED if feature not in context.device.features]
    if stage == "fragment" and missing:
        context.recorder.unmeasured(call_rule("ray queries in fragment shaders"), UNSUPPORTED, missing[0])
        return ()

    def measure(context: CheckContext) -> Iterable[Measurement]:
        with Structures(context.device, SHAPES, list(INSTANCES.values()), build_mode) as structures:
            yield from probe_checks.measure_probes(context.shaders, structures, stage, _chosen(PROBES, context.part))

    return by("query", probe_checks.rules(), measure)(context)


def ray_probes(context: CheckContext, build_mode: str) -> Iterable[Measurement]:
    """Single rays by pipelines, over structures that were built in one of BUILD_MODES."""
    culling = ray_probe_checks.CULLING in context.device.features
    # Without the feature these flags of rays are invalid, so such probes must not be sent.
    asked = [probe for probe in ray_probe_checks.ASKED if culling or not ray_probe_checks.culls(probe)]

    def measure(context: CheckContext) -> Iterable[Measurement]:
        if not culling:
            culling_rules = {ray_probe_checks.rule_of(probe) for probe in ray_probe_checks.ASKED if probe not in asked}
            context.recorder.unmeasured(culling_rules, UNSUPPORTED, ray_probe_checks.CULLING)
        chosen = _chosen(asked, context.part)
        with Structures(context.device, SHAPES, list(INSTANCES.values()), build_mode) as structures:
            yield from ray_probe_checks.measure_probes(context.shaders, structures, chosen, culling=culling)

    return by("pipeline", ray_probe_checks.rules(), measure)(context)


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


def embree(context: CheckContext, scene: str) -> Iterable[Measurement]:
    """Random rays against Embree."""
    if available():
        return embree_checks.measure(context.shaders, scene, 10_000_000 if context.full else 100_000)
    context.recorder.unmeasured(embree_checks.rules(scene), ERROR, "needs embreex: pip install solari-vk[test]")
    return ()


def embree_exactly(context: CheckContext, scene: str) -> Iterable[Measurement]:
    """Rays by compute shaders, also at edges and vertices, against Embree."""
    rules = embree_checks.exact_rules(scene)
    if not available():
        context.recorder.unmeasured(rules, ERROR, "needs embreex: pip install solari-vk[test]")
    elif scene == embree_checks.SCENES[-1] and not context.full:
        context.recorder.unmeasured(rules, NOT_RUN, "--full measures it")
    else:
        return embree_checks.measure_exactly(context.shaders, scene, 500_000 if context.full else 20_000)
    return ()


def vertex_return(context: CheckContext) -> Iterable[Measurement]:
    """The corners of triangles that rays hit."""
    if context.device.has_position_fetch:
        return position_checks.measure_positions(context.shaders, _chosen(position_checks.HITTING, context.part))
    # An old validation layer does not know the extension and hides it.
    layer = " (hidden by the validation layer)" if context.device.validation else ""
    context.recorder.unmeasured(position_checks.RULES.values(), UNSUPPORTED, "rayTracingPositionFetch" + layer)
    return ()


def large_tlas(context: CheckContext, count: int) -> Iterable[Measurement]:
    """A structure of so many instances."""
    limit = int(context.device.properties.acceleration.maxInstanceCount)
    if count > limit:
        context.recorder.unmeasured(
            structure_checks.large_tlas_rule(count), UNSUPPORTED, f"maxInstanceCount is {limit:,}"
        )
    elif count > 100_000 and not context.full:
        context.recorder.unmeasured(structure_checks.large_tlas_rule(count), NOT_RUN, "--full measures it")
    else:
        return structure_checks.measure_large_tlas(context.shaders, count)
    return ()


def inactive(context: CheckContext, kind: str) -> Iterable[Measurement]:
    """Triangles or boxes of NaN."""
    return structure_checks.measure_inactive_primitives(context.shaders, kind)


def many_blases(context: CheckContext) -> Iterable[Measurement]:
    """Many bottom-level structures of one build."""
    return structure_checks.measure_many_blases(context.shaders, 2000 if context.full else 500)


def many_instances(context: CheckContext) -> Iterable[Measurement]:
    """More instances than 16 bits can number, also in the fast profile."""
    return bulk_checks.measure_many_instances(context.shaders, 100_000 if context.full else 70_000)
