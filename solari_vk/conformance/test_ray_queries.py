"""Ray queries: the labelled probes, many rays against Embree, watertightness, and rays that are none."""

from __future__ import annotations

import pytest

from solari_vk.conformance import bulk_checks, embree_checks, position_checks, probe_checks
from solari_vk.conformance.kernels import Kernels
from solari_vk.conformance.probes import INSTANCES, SHAPES, call_rule
from solari_vk.conformance.suite import Recorder
from solari_vk.conformance.worlds import WAYS, World


@pytest.mark.parametrize("way", WAYS)
def test_probes(rule: Recorder, kernels: Kernels, way: str) -> None:
    """All probes from compute."""
    with World(kernels.device, SHAPES, list(INSTANCES.values()), way) as world:
        rule(probe_checks.measure(*probe_checks.run_probes(kernels, world)))


@pytest.mark.parametrize("stage", ["fragment"])
def test_probes_from_other_stages(rule: Recorder, kernels: Kernels, stage: str) -> None:
    """All probes once more from a fragment shader."""
    if "fragmentStoresAndAtomics" not in kernels.device.features:
        rule.unsupported(call_rule("ray queries in fragment shaders"), "fragmentStoresAndAtomics")
        return
    with World(kernels.device, SHAPES, list(INSTANCES.values())) as world:
        rule(probe_checks.measure(*probe_checks.run_probes(kernels, world, stage)))


@pytest.mark.parametrize("scene", embree_checks.SCENES)
def test_embree(rule: Recorder, kernels: Kernels, full: bool, scene: str) -> None:
    """The closest hit of random rays is Embree's."""
    if not embree_checks.available():
        rule.missing(embree_checks.rules(scene), "needs embreex: pip install solari-vk[test]")
    else:
        rule(embree_checks.measure(kernels, scene, 10_000_000 if full else 1_000_000))


def test_watertight(rule: Recorder, kernels: Kernels) -> None:
    """No ray gets through a shared edge or vertex."""
    rule(bulk_checks.measure_watertight(kernels))


def test_many_instances(rule: Recorder, kernels: Kernels) -> None:
    """Each of many instances is hit, and is told from the others."""
    rule(bulk_checks.measure_many_instances(kernels, 100_000))


def test_extreme_transforms(rule: Recorder, kernels: Kernels) -> None:
    """Sizes and places of many magnitudes."""
    rule(bulk_checks.measure_extreme_transforms(kernels))


def test_not_finite(rule: Recorder, kernels: Kernels) -> None:
    """NaN and infinite rays end and hit nothing."""
    rule(bulk_checks.measure_not_finite(kernels))


def test_vertex_return(rule: Recorder, kernels: Kernels) -> None:
    """Vertex positions of hits, where the device returns them."""
    if kernels.device.has_position_fetch:
        rule(position_checks.measure_positions(kernels))
    else:
        layer = " (hidden by the validation layer)" if kernels.device.validation else ""
        rule.unsupported(position_checks.RULES.values(), "rayTracingPositionFetch" + layer)
