"""Vertex return: the vertex positions of hit triangles, on devices that have them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from solari_vk import rt
from solari_vk.lab.conformance.outcomes import Measurement
from solari_vk.lab.conformance.probe_actions import CONFIRM
from solari_vk.lab.conformance.probe_checks import probe_rays
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import INSTANCES, SHAPES, TRIANGLE, Probe, call_rule
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Structures, Triangles

RULES = {
    ("committed", False): call_rule("getCommittedHitVertexPositions, one geometry"),
    ("committed", True): call_rule("getCommittedHitVertexPositions, several geometries"),
    ("candidate", False): call_rule("getCandidateHitVertexPositions, one geometry"),
    ("candidate", True): call_rule("getCandidateHitVertexPositions, several geometries"),
}


def measure_positions(shaders: ShaderRunner, probes: Sequence[Probe], header: str = "") -> Iterator[Measurement]:
    """Compare returned positions with the geometry, after its transform, for each triangle that a probe must hit."""
    rays = probe_rays(shaders.element("conformance/positions", "probes"), probes)
    # All shapes, so that geometries with transforms and indices are among them.
    with Structures(shaders.device, SHAPES, list(INSTANCES.values())) as structures:
        inputs = {"tlas": structures.tlas, "probes": rays}
        outputs = {"corners": len(rays), **(rt.FAULT_BUFFERS if header else {})}
        found = shaders.run("conformance/positions", len(rays), inputs, outputs, header=header)["corners"]
    for (which, several), rule in RULES.items():
        errors = {}
        for probe, got in zip(probes, found, strict=True):
            expected = _corners(probe, which)
            if expected is not None and _has_several_geometries(probe) == several:
                errors[probe.label] = _error(got, which, expected)
        if errors:
            worst = max(errors, key=errors.__getitem__)
            yield Measurement(rule, errors[worst], 1e-6, "absolute error", worst)


def _has_several_geometries(probe: Probe) -> bool:
    return len(SHAPES[INSTANCES[probe.on].shape]) > 1


def _error(got: np.void, which: str, expected: np.ndarray) -> float:
    difference = np.nan_to_num(np.abs(got[which] - expected), nan=np.inf)
    return float(difference.max()) if got["kind"] == TRIANGLE else np.inf


def _corners(probe: Probe, which: str) -> np.ndarray | None:
    """The vertices (3, 3) that a probe must get. None for probes without a hit, or with several possible hits."""
    hit = probe.committed
    if hit is None or hit.kind != TRIANGLE or hit.primitive is None or probe.action != CONFIRM:
        return None
    # The shader keeps the last candidate, so only a single one is known.
    if which == "candidate" and probe.candidates != 1:
        return None
    part = SHAPES[INSTANCES[probe.on].shape][hit.geometry]
    assert isinstance(part, Triangles)
    corners: np.ndarray = part.placed[hit.primitive]
    return corners


HITTING = [probe for probe in PROBES if _corners(probe, "committed") is not None]
"""The probes that must hit a certain triangle."""
