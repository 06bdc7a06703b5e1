"""Runs the probes and compares the answers with the table and with float64 closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk import rt
from solari_vk.gpu.frame.frame import Draw, DrawList, Pass
from solari_vk.lab.conformance.outcomes import SUITE, VULKAN, Measurement, Rule, count_wrong
from solari_vk.lab.conformance.probe_actions import STEP_LIMIT
from solari_vk.lab.conformance.probe_table import PROBES
from solari_vk.lab.conformance.probes import AABB, INSTANCES, SHAPES, TRIANGLE, Expected, Probe, call_rule, hit_rule
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Placement, Structures, Triangles
from solari_vk.scene.matrices import by_columns

_ORDER = list(INSTANCES)
_GETTERS = Rule("OpRayQueryGetRayTMin, RayFlags, WorldRayOrigin, WorldRayDirection", VULKAN, "Ray Query")
_OBJECT_RAY = Rule("OpRayQueryGetIntersectionObjectRayOrigin, Direction", VULKAN, "Ray Query")
_NO_FAULTS = Rule("the debug build reports no fault for valid queries", SUITE, "ray_query_state.glsl")
_PROCEED = call_rule("rayQueryProceed returns false in the end, and again when called again")
_OPAQUE_BOX = Rule("OpRayQueryGetIntersectionCandidateAABBOpaque", VULKAN, "Ray Query")


CheckedProbe = TypeVar("CheckedProbe", bound="Checked")


def probe_rays(dtype: np.dtype[Any], probes: Sequence[Probe] = PROBES) -> np.ndarray:
    """Probes as the shader takes them: rays in world space, rounded to float32."""
    records = np.zeros(len(probes), dtype)
    for record, probe in zip(records, probes, strict=True):
        matrix = INSTANCES[probe.on].matrix
        record["origin"] = matrix[:, :3] @ probe.origin + matrix[:, 3]
        record["direction"] = matrix[:, :3] @ probe.direction
        record["t_min"], record["t_max"] = probe.t_min, probe.t_max
        record["flags"] = probe.flags
        record["cull_mask"] = probe.mask
        record["action"] = probe.action
        record["parameter"] = probe.parameter
    return records


STAGES = ("compute", "debug build", "fragment")


def run_rays(
    shaders: ShaderRunner, structures: Structures, rays: np.ndarray, stage: str = STAGES[0]
) -> tuple[np.ndarray, np.ndarray]:
    """The answer of each ray in one of STAGES, and how often the debug build found each of rt.RULES broken."""
    # The layout of glsl/scene/ray_query_state.glsl: a count, and the first invocation.
    faults = np.zeros(len(rt.RULES), [("count", "<u4"), ("invocation", "<u4", 3)])
    inputs = {"tlas": structures.tlas, "probes": rays}
    outputs: dict[str, int | np.ndarray] = {"answers": len(rays)}
    if stage == "compute":
        return shaders.run("conformance/probe", len(rays), inputs, outputs)["answers"], faults["count"]
    if stage == "debug build":
        outputs["ray_query_faults"] = faults
        found = shaders.run("conformance/probe_debug", len(rays), inputs, outputs)
        return found["answers"], found["ray_query_faults"]["count"]
    # One triangle that covers the picture, one pixel a ray: fragment shaders then ask the same rays.
    one_triangle = {"probe_draws": np.array([3, 1, 0, 0], np.uint32), "probe_draw_count": np.ones(1, np.uint32)}
    row = (len(rays), 1)
    found = shaders.run_steps(
        [
            Draw(
                "conformance/probe",
                [DrawList("probe_draws", "probe_draw_count", 1, culls_backs=False)],
                colors=["probe_kinds"],
                depth="probe_depth",
            ),
            Pass("conformance/probe_kinds", threads=len(rays)),
        ],
        {**inputs, **one_triangle},
        {**outputs, "kinds_seen": len(rays)},
        images={"probe_kinds": row, "probe_depth": row},
    )
    answers = found["answers"]
    assert (found["kinds_seen"] == answers["committed"]["kind"] + 1).all(), "the image differs from the fragments'"
    return answers, faults["count"]


def rules() -> list[Rule]:
    """The rules of ray queries that probes prove, without those of members."""
    return list(dict.fromkeys([*(probe.rule for probe in PROBES), _PROCEED, _GETTERS, _OPAQUE_BOX, _NO_FAULTS]))


def measure_probes(
    shaders: ShaderRunner,
    structures: Structures,
    stage: str = STAGES[0],
    probes: Sequence[Probe] = PROBES,
    damage: Callable[[np.ndarray], None] | None = None,
) -> Iterator[Measurement]:
    """Measure all rules that the probes prove. `damage` changes the rays before they are sent, to seed bugs."""
    rays = probe_rays(shaders.element("conformance/probe", "probes"), probes)
    # Answers are held against the undamaged rays.
    sent = rays.copy()
    if damage is not None:
        damage(sent)
    answers, faults = run_rays(shaders, structures, sent, stage)
    yield from _measure([Checked(*item) for item in zip(probes, rays, answers, strict=True)])
    if stage == "debug build":
        yield count_wrong(_NO_FAULTS, [rule for rule, count in zip(rt.RULES, faults, strict=True) if count])


def _measure(checked: list[Checked]) -> Iterator[Measurement]:
    """Compare answers with what the probes must find."""
    yield from measure_tables(checked, lambda probe: probe.rule)
    yield count_wrong(
        _PROCEED, labels(checked, lambda item: item.answer["proceeds_after_end"] or item.steps >= STEP_LIMIT)
    )
    for which in ("committed", "candidate"):
        yield from measure_getters(checked, which, _getter_rule)
    yield count_wrong(_GETTERS, labels(checked, lambda item: not item.tells_its_ray()))
    boxes = [item for item in checked if item.answer["box_candidates"]]
    if boxes:
        yield count_wrong(_OPAQUE_BOX, labels(boxes, lambda item: not item.tells_opaque_boxes()))


def measure_tables(checked: Sequence[CheckedProbe], rule_of: Callable[[Probe], Rule]) -> Iterator[Measurement]:
    """Count the probes whose hits aren't those of the table, for each rule of the probes."""
    by_rule: dict[Rule, list[CheckedProbe]] = {}
    for item in checked:
        by_rule.setdefault(rule_of(item.probe), []).append(item)
    for rule, items in by_rule.items():
        reasons = {item.probe.label: item.wrong() for item in items}
        yield count_wrong(rule, [f"{label} ({reason})" for label, reason in reasons.items() if reason])


def labels(checked: Iterable[CheckedProbe], is_wrong: Callable[[CheckedProbe], Any]) -> list[str]:
    """The labels of the probes of which this is true."""
    return [item.probe.label for item in checked if is_wrong(item)]


def _getter_rule(name: str, which: str) -> Rule:
    if name != "object_ray":
        return hit_rule(f"{name}, {which}")
    return Rule(f"{_OBJECT_RAY.name}, {which}", _OBJECT_RAY.document, _OBJECT_RAY.section)


def measure_getters(
    checked: Iterable[Checked], which: str, rule_of: Callable[[str, str], Rule | None]
) -> Iterator[Measurement]:
    """Compare the members of committed hits or candidates (which), whose rules `rule_of` tells by their names."""
    items = [(item, item.expected(which)) for item in checked]
    expecting = [(item, expected) for item, expected in items if expected is not None]
    if not expecting:
        return
    # Where the kind of hit is wrong, its members mean something else: the rules of the table count that.
    exact = [item for item, expected in expecting if item.answer[which]["kind"] == expected.kind]
    wrong = {name: [item.probe.label for item in exact if name in item.discrete(which)] for name in _DISCRETE}
    for name, wrong_labels in wrong.items():
        rule = rule_of(name, which)
        if rule is not None:
            yield count_wrong(rule, wrong_labels)
    for name, (error, label) in _worst_errors(exact, which).items():
        rule = rule_of(name, which)
        if rule is not None:
            yield Measurement(rule, error, _BARS[name], "relative error", label)


def _worst_errors(checked: Iterable[Checked], which: str) -> dict[str, tuple[float, str]]:
    """By floating-point member, the largest relative error, and the label of its probe."""
    worst: dict[str, tuple[float, str]] = dict.fromkeys(_BARS, (0.0, ""))
    for item in checked:
        for name, error in item.errors(which).items():
            if not error <= worst[name][0]:  # also NaN is worse
                worst[name] = (error, item.probe.label)
    return worst


# A few roundings of float32 (6e-8 each); the device inverts matrices, which magnifies them.
_BARS = {"t": 2e-6, "barycentrics": 4e-6, "object_to_world": 1e-6, "world_to_object": 1e-5, "object_ray": 1e-6}
_DISCRETE = (
    "instance_custom_data",
    "instance_index",
    "sbt_record_offset",
    "geometry_index",
    "primitive_index",
    "front_face",
)


class Checked:
    """A probe with its ray, its answer, and the float64 matrices of its instance."""

    def __init__(self, probe: Probe, ray: np.void, answer: np.void) -> None:
        self.probe = probe
        self.ray = ray
        self.answer = answer
        self.steps = int(answer["steps"])
        self.placed: Placement = INSTANCES[probe.on]
        matrix = self.placed.matrix
        # In float64 from the matrix that the device gets, so that errors are the device's alone.
        self.inverse = np.linalg.inv(matrix[:, :3])
        self.origin = self.inverse @ (ray["origin"].astype(np.float64) - matrix[:, 3])
        self.direction = self.inverse @ ray["direction"].astype(np.float64)

    def expected(self, which: str) -> Expected | None:
        """The expected committed hit, or the expected single candidate, from the table."""
        return self.probe.committed if which == "committed" else self.probe.candidate

    def wrong(self) -> str:
        """What is wrong with the answer, in words; empty when nothing is."""
        if self.steps == 0xFFFFFFFF:  # what `run_rays` fills the answers with
            return "not run"
        found = [*self._wrong_hit("committed"), *self._wrong_hit("candidate")]
        if self.probe.candidates is not None and self.steps != self.probe.candidates:
            found.append(f"{self.steps} candidates")
        return ", ".join(found)

    def _wrong_hit(self, which: str) -> list[str]:
        """What is wrong with the committed hit or with the candidate."""
        expected = self.expected(which)
        got = self.answer[which]
        if expected is None:
            unexpected = which == "committed" and got["kind"]
            return [f"hit at t = {got['t']:g}"] if unexpected else []
        if got["kind"] != expected.kind:
            return [f"{which} kind {got['kind']}"]
        found = [f"{which} {name}" for name in self.discrete(which)]
        allowed = self.probe.among if expected.t is None else (expected.t,)
        # Rounding of world-space rays moves t on a tiny instance, which `errors` allows for; so this bar is wide.
        if allowed and not any(abs(got["t"] - t) <= 1e-3 * t for t in allowed):
            found.append(f"{which} t = {got['t']:g}")
        return found

    def _primitive(self, which: str, got: np.void) -> int:
        expected = self.expected(which)
        assert expected is not None
        return int(got["primitive"]) if expected.primitive is None else expected.primitive

    def discrete(self, which: str) -> list[str]:
        """The names of integer members that are wrong."""
        expected, got = self.expected(which), self.answer[which]
        assert expected is not None
        pairs = {
            "instance_custom_data": (got["custom_data"], self.placed.custom),
            "instance_index": (got["instance"], _ORDER.index(self.probe.on)),
            "sbt_record_offset": (got["sbt_offset"], self.placed.sbt_offset),
            "geometry_index": (got["geometry"], expected.geometry),
            "primitive_index": (got["primitive"], self._primitive(which, got)),
        }
        if expected.kind == TRIANGLE:
            pairs["front_face"] = (got["front_face"], int(expected.front))
        return [name for name, (value, right) in pairs.items() if value != right]

    def errors(self, which: str) -> dict[str, float]:
        """The relative error of each floating-point member."""
        expected, got = self.expected(which), self.answer[which]
        assert expected is not None
        matrix = self.placed.matrix
        back = np.concatenate([self.inverse, -(self.inverse @ matrix[:, 3:])], axis=1)
        found = {
            "object_to_world": _error(by_columns(got["object_to_world"]), matrix),
            "world_to_object": _error(by_columns(got["world_to_object"]), back),
            "object_ray": max(
                _error(got["object_origin"], self.origin, self._coarseness()),
                _error(got["object_direction"], self.direction),
            ),
        }
        if expected.kind == TRIANGLE:
            t, barycentrics = self._intersect(expected.geometry, self._primitive(which, got))
            found["barycentrics"] = _error(got["barycentrics"], barycentrics, max(self._coarseness(), t))
            # Rounding of the ray moves t by an absolute amount: for near hits the error is relative to that.
            found["t"] = _error(got["t"], t, max(self._coarseness(), t))
        elif expected.kind != AABB and expected.t is not None:
            found["t"] = _error(got["t"], expected.t, max(self._coarseness(), expected.t))
        return found

    def _coarseness(self) -> float:
        """The size of the largest numbers that cancel when a ray is moved to object space; their rounding moves it."""
        return float(np.abs(self.inverse).max() * np.abs(self.placed.matrix).max())

    def _intersect(self, geometry: int, primitive: int) -> tuple[float, NDArray[np.float64]]:
        """t and barycentrics where the object-space ray meets the plane of the triangle."""
        part = SHAPES[self.placed.shape][geometry]
        assert isinstance(part, Triangles)
        a, b, c = part.placed[primitive]
        # origin + t * direction = a + u * (b - a) + v * (c - a)
        u, v, t = np.linalg.solve(np.stack([b - a, c - a, -self.direction], axis=1), self.origin - a)
        return float(t), np.array([u, v])

    def tells_its_ray(self) -> bool:
        """Whether the getters of the ray return the ray that was sent."""
        got = self.answer
        ray = self.ray
        same = [
            got["t_min"] == ray["t_min"],
            got["flags"] == ray["flags"],
            (got["world_origin"] == ray["origin"]).all(),
            (got["world_direction"] == ray["direction"]).all(),
        ]
        return all(map(bool, same))

    def tells_opaque_boxes(self) -> bool:
        """Whether AABB candidates had the opacity that geometry and flags give them."""
        # Bit 0 of the ray's flags makes all geometry opaque.
        opaque = self.placed.shape == "opaque boxes" or self.probe.flags & 1
        return int(self.answer["opaque_boxes"]) == (int(self.answer["box_candidates"]) if opaque else 0)


def _error(got: Any, right: Any, scale: float | None = None) -> float:
    # Relative to the largest component, since the smaller ones share its rounding.
    difference = np.abs(np.asarray(got, np.float64) - right).max()
    return float(difference / (scale if scale else max(np.abs(right).max(), 1e-30)))
