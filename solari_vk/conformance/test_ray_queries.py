"""Ray queries: probes, random rays against Embree, watertightness, extreme sizes and invalid rays."""

from __future__ import annotations

import pytest

from solari_vk.conformance import bulk_checks, embree_checks, position_checks, probe_checks
from solari_vk.conformance.probes import INSTANCES, SHAPES, call_rule
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.conformance.suite import Recorder
from solari_vk.conformance.worlds import WAYS, World
from solari_vk.gpu.frame.raster import NEEDED


@pytest.mark.parametrize("way", WAYS)
def test_probes(rule: Recorder, shaders: ShaderRunner, way: str) -> None:
    """All probes from compute."""
    with World(shaders.device, SHAPES, list(INSTANCES.values()), way) as world:
        rule(probe_checks.measure_probes(shaders, world))


@pytest.mark.parametrize("stage", probe_checks.STAGES[1:])
def test_probes_from_other_stages(rule: Recorder, shaders: ShaderRunner, stage: str) -> None:
    """All probes in the debug build and from a fragment shader."""
    missing = [feature for feature in NEEDED if feature not in shaders.device.features]
    if stage == "fragment" and missing:
        rule.unsupported(call_rule("ray queries in fragment shaders"), missing[0])
        return
    with World(shaders.device, SHAPES, list(INSTANCES.values())) as world:
        rule(probe_checks.measure_probes(shaders, world, stage))


@pytest.mark.parametrize("scene", embree_checks.SCENES)
def test_embree(rule: Recorder, shaders: ShaderRunner, full: bool, scene: str) -> None:
    """The closest hit of random rays is Embree's."""
    if not embree_checks.available():
        rule.missing(embree_checks.rules(scene), "needs embreex: pip install solari-vk[test]")
    else:
        rule(embree_checks.measure(shaders, scene, 10_000_000 if full else 100_000))


def test_watertight(rule: Recorder, shaders: ShaderRunner) -> None:
    """No ray passes between triangles that share an edge or a vertex."""
    rule(bulk_checks.measure_watertight(shaders))


def test_many_instances(rule: Recorder, shaders: ShaderRunner, full: bool) -> None:
    """Each of many instances is hit, and told apart from the others."""
    rule(bulk_checks.measure_many_instances(shaders, 100_000 if full else 20_000))


def test_extreme_transforms(rule: Recorder, shaders: ShaderRunner) -> None:
    """Sizes and distances of many magnitudes."""
    rule(bulk_checks.measure_extreme_transforms(shaders))


def test_not_finite(rule: Recorder, shaders: ShaderRunner) -> None:
    """NaN and infinite rays end and hit nothing."""
    rule(bulk_checks.measure_not_finite(shaders))


def test_vertex_return(rule: Recorder, shaders: ShaderRunner) -> None:
    """Vertex positions of hit triangles, if the device returns them."""
    if shaders.device.has_position_fetch:
        rule(position_checks.measure_positions(shaders))
    else:
        layer = " (hidden by the validation layer)" if shaders.device.validation else ""
        rule.unsupported(position_checks.RULES.values(), "rayTracingPositionFetch" + layer)
