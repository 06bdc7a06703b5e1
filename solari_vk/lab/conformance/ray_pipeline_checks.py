"""What ray pipelines have that ray queries don't: records of the shader binding table, launches, reported hits."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from solari_vk.gpu.frame.frame import HitGroup, RayPass
from solari_vk.lab.conformance.outcomes import VULKAN, Measurement, Rule, count_wrong
from solari_vk.lab.conformance.probes import triangle
from solari_vk.lab.conformance.ray_probe_checks import GLSL
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import Boxes, Placement, Structures, Triangles, translation

_FOLDER = "passes/conformance"
Damage = Callable[[np.ndarray], None]

# ---- records ----------------------------------------------------------------------------------------

_INDEXING = "Shader Binding Table"
_HIT_RECORD = Rule(
    "hit records: the instance's offset + sbtRecordOffset + sbtRecordStride * gl_GeometryIndexEXT", VULKAN, _INDEXING
)
_FOUR_BITS = Rule("sbtRecordOffset and sbtRecordStride have four bits", "SPV_KHR_ray_tracing", "OpTraceRayKHR")
_MISS_RECORD = Rule("miss records: missIndex, which has 16 bits", VULKAN, _INDEXING)
# The numbers of the shaders of each record. A wrong index finds another shader in two of three cases.
_NUMBERS = np.random.default_rng(30).integers(1, 4, 96)
_GEOMETRIES = 4
_OFFSETS = (0, 1, 13, 32)  # of the instances
_MISSES = 8


def measure_records(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """Trace rays at four geometries in each of four instances. `damage` changes the rays, to seed bugs."""
    parts = [Triangles(triangle(3 * i)[None]) for i in range(_GEOMETRIES)]
    placed = [Placement("row", translation(0, 5 * i), sbt_offset=offset) for i, offset in enumerate(_OFFSETS)]
    choices = (0, 1, 2, 7, 15)  # of four bits; 17 and 18 have a fifth one, which must be ignored
    cases = list(itertools.product(range(len(_OFFSETS)), range(_GEOMETRIES), (*choices, 17), (*choices, 18)))
    rays = np.zeros(len(cases) + 2 * _MISSES, shaders.element("conformance/records.rgen", "record_rays"))
    instance, geometry, offset, stride = np.array(cases).T
    rays["origin"][: len(cases)] = np.stack([3 * geometry + 0.5, 5 * instance + 0.5, np.ones(len(cases))], 1)
    rays["offset"][: len(cases)] = offset
    rays["stride"][: len(cases)] = stride
    rays["origin"][len(cases) :] = (-9, -9, 1)  # beside all geometries
    # The second half of the misses has a bit beyond the 16 that count.
    misses = np.arange(2 * _MISSES) % _MISSES
    rays["miss"][len(cases) :] = misses + 0x10000 * (np.arange(2 * _MISSES) // _MISSES)
    # The formula of the Vulkan specification, Shader Binding Table, Hit Shader Binding Table Indexing.
    wanted = _NUMBERS[np.array(_OFFSETS)[instance] + offset % 16 + geometry * (stride % 16)]
    if damage is not None:
        damage(rays)
    hits = [HitGroup(f"{_FOLDER}/record_{number}.rchit") for number in _NUMBERS]
    step = RayPass(
        "conformance/records",
        threads=len(rays),
        hits=hits,
        misses=[f"{_FOLDER}/record_{number}.rmiss" for number in _NUMBERS[:_MISSES]],
    )
    with Structures(shaders.device, {"row": parts}, placed, own_records=True) as structures:
        found = shaders.run_steps([step], {"tlas": structures.tlas, "record_rays": rays}, {"records_run": len(rays)})
    run = found["records_run"]
    # Rays whose offset or stride has a fifth bit prove another rule.
    large = (offset > 15) | (stride > 15)
    labels = [f"instance {i}, geometry {g}, offset {o}, stride {s}" for i, g, o, s in cases]
    wrong = run[: len(cases)] != wanted
    yield count_wrong(_HIT_RECORD, [labels[i] for i in np.flatnonzero(wrong & ~large)])
    yield count_wrong(_FOUR_BITS, [labels[i] for i in np.flatnonzero(wrong & large)])
    missed = np.flatnonzero(run[len(cases) :] != _NUMBERS[misses] + 10)
    yield count_wrong(_MISS_RECORD, [f"index {int(rays['miss'][len(cases) + i]):#x}" for i in missed])


# ---- launches ---------------------------------------------------------------------------------------

_LAUNCH = Rule(
    "a launch runs each invocation once, with its gl_LaunchIDEXT and gl_LaunchSizeEXT", GLSL, "Built-In Variables"
)
_INDIRECT = Rule(
    "vkCmdTraceRaysIndirectKHR launches as many invocations as the buffer says", VULKAN, "Ray Tracing Commands"
)
_SPARE = 64
SIZES = ((1,), (1009,), (37, 5), (1, 300), (7, 5, 3), (1, 1, 64))


def measure_launches(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Launch rays in one, two and three dimensions, directly and indirectly."""
    dtype = shaders.element("conformance/launch.rgen", "launches")
    misses = [f"{_FOLDER}/launch.rmiss"]
    wrong: dict[Rule, list[str]] = {_LAUNCH: [], _INDIRECT: []}
    with Structures(shaders.device, {"one": [Triangles(triangle()[None])]}, [Placement("one")]) as structures:
        for size in SIZES:
            x, y, z = (*size, 1, 1)[:3]
            counts = np.array([0, 0, 0, x, y, z], np.uint32)  # the first three are for compute shaders
            steps = {
                _LAUNCH: RayPass("conformance/launch", threads=size, misses=misses),
                _INDIRECT: RayPass("conformance/launch", indirect="launch_counts", misses=misses),
            }
            for rule, step in steps.items():
                # Elements after the last show whether there are too many invocations.
                inputs = {"tlas": structures.tlas, "launch_counts": counts}
                outputs = {"launches": np.zeros(x * y * z + _SPARE, dtype)}
                if not _is_whole_launch(shaders.run_steps([step], inputs, outputs)["launches"], (x, y, z)):
                    wrong[rule].append("x".join(map(str, size)))
    for rule, sizes in wrong.items():
        yield count_wrong(rule, sizes)


def _is_whole_launch(found: np.ndarray, size: tuple[int, int, int]) -> bool:
    """Whether each invocation of a launch ran once, and its shaders were told its id and the size."""
    x, y, z = size
    ids = np.stack(np.unravel_index(np.arange(x * y * z), (z, y, x))[::-1], 1)
    if found["count"].tolist() != [1] * len(ids) + [0] * _SPARE:
        return False
    for stage in ("generation", "miss"):
        invocations = found[stage][: len(ids)]
        if (invocations["id"] != ids).any() or (invocations["size"] != size).any():
            return False
    return True


# ---- reported hits ----------------------------------------------------------------------------------

_CONFIRMATION = "Ray Intersection Confirmation"
_ACCEPTED = Rule(
    "reportIntersectionEXT accepts hits between Tmin and the nearest so far that no any-hit shader ignores",
    VULKAN,
    _CONFIRMATION,
)
_NEAREST = Rule(
    "of several hits of one intersection shader the nearest accepted one is hit",
    VULKAN,
    "Ray Closest Hit Determination",
)
_ATTRIBUTES = Rule(
    "hitAttributeEXT: any-hit and closest-hit shaders get the attributes of their report", GLSL, "hitAttributeEXT"
)
_KEPT = Rule(
    "hitAttributeEXT: the closest hit keeps its attributes when later reports are refused", GLSL, "hitAttributeEXT"
)
_IGNORED = 127  # report.glsl
Triple = tuple[int, int, int]


class _Reports(NamedTuple):
    """Three reported hits of a ray, and what the device must make of them.

    accepted: which hits are accepted; None where this depends on the order in which the driver meets the boxes. x: of
    the ray: 0.5 meets a box whose shader reports all three hits, 2.5 meets three boxes that report one each.
    """

    t_min: float
    t_max: float
    ts: Triple
    kinds: Triple
    accepted: Triple | None
    x: float


_REPORTS = {
    "ever nearer": _Reports(0, 100, (9, 6, 3), (1, 2, 3), (1, 1, 1), 0.5),
    "ever farther": _Reports(0, 100, (3, 6, 9), (1, 2, 3), (1, 0, 0), 0.5),
    "nearest in the middle": _Reports(0, 100, (6, 3, 4), (0, 64, 1), (1, 1, 0), 0.5),
    "before Tmin": _Reports(5, 100, (1, 2, 4), (1, 2, 3), (0, 0, 0), 0.5),
    "one before Tmin": _Reports(5, 100, (4, 8, 7), (1, 2, 3), (0, 1, 1), 0.5),
    "beyond Tmax": _Reports(0, 8, (9, 20, 1000), (1, 2, 3), (0, 0, 0), 0.5),
    "one beyond Tmax": _Reports(0, 8, (9, 6, 7), (1, 126, 3), (0, 1, 0), 0.5),
    "ignored": _Reports(0, 100, (3, 4, 5), (_IGNORED, _IGNORED, _IGNORED), (0, 0, 0), 0.5),
    "nearest ignored": _Reports(0, 100, (3, 6, 5), (_IGNORED, 2, 3), (0, 1, 1), 0.5),
    "ignored between": _Reports(0, 100, (6, 3, 5), (1, _IGNORED, 3), (1, 0, 1), 0.5),
    # All behind the boxes, so that each box is met.
    "of several boxes": _Reports(0, 100, (40, 60, 50), (1, 2, 3), None, 2.5),
    "of several boxes, in another order": _Reports(0, 100, (60, 40, 50), (1, 2, 3), None, 2.5),
}


def measure_reports(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """Report several hits of a box, and one hit of each of several boxes. `damage` changes the rays, to seed bugs."""
    rays = np.zeros(len(_REPORTS), shaders.element("conformance/report.rgen", "report_rays"))
    for ray, reports in zip(rays, _REPORTS.values(), strict=True):
        ray["origin"] = (reports.x, 0.5, 2)
        ray["t_min"] = reports.t_min
        ray["t_max"] = reports.t_max
        ray["t"] = reports.ts
        ray["kind"] = reports.kinds
    if damage is not None:
        damage(rays)
    files = (f"{_FOLDER}/report.{suffix}" for suffix in ("rchit", "rahit", "rint"))
    step = RayPass("conformance/report", threads=len(rays), misses=[f"{_FOLDER}/report.rmiss"], hits=[HitGroup(*files)])
    # The box reaches far enough for rays with a large Tmin to meet it, and no report depends on where it is.
    # Boxes of the second shape lie behind each other, 2 apart.
    box = np.array([[(0, 0, -1000), (1, 1, 1)]])
    several = np.array([[(2, 0, -2 * i), (3, 1, 1 - 2 * i)] for i in range(3)])
    shapes = {"box": [Boxes(box)], "several": [Boxes(several)]}
    placed = [Placement("box"), Placement("several", custom=1)]
    with Structures(shaders.device, shapes, placed, own_records=True) as structures:
        before = np.zeros(len(rays), shaders.element("conformance/report.rgen", "reported"))
        answers = shaders.run_steps([step], {"tlas": structures.tlas, "report_rays": rays}, {"reported": before})
    wrong: dict[Rule, list[str]] = {_ACCEPTED: [], _NEAREST: [], _ATTRIBUTES: [], _KEPT: []}
    for (name, reports), got in zip(_REPORTS.items(), answers["reported"], strict=True):
        for rule, what in _wrong_reports(reports, got):
            wrong[rule].append(name + what)
    for rule, names in wrong.items():
        yield count_wrong(rule, names)


def _wrong_reports(reports: _Reports, got: np.void) -> Iterator[tuple[Rule, str]]:
    """The rules that an answer to a ray breaks, each with what is wrong."""
    accepted = reports.accepted
    hits = list(zip(reports.ts, reports.kinds, accepted or (1, 1, 1), strict=True))
    t, kind = min(((t, kind) for t, kind, is_accepted in hits if is_accepted), default=(-1, 0))
    if (got["t"], got["kind"]) != (t, kind):
        yield _NEAREST, f" (t = {got['t']:g}, kind {got['kind']})"
    # After the nearest hit, a later report that is refused must leave its attributes as they are.
    is_last = accepted is not None and (accepted[-1] or not any(accepted))
    if t >= 0 and tuple(got["attributes"]) != (t, -t, kind, 0.25 * t + kind):  # report.glsl
        yield (_ATTRIBUTES if is_last else _KEPT), ""
    if accepted is None:
        return
    if got["accepted"] != sum(is_accepted << i for i, is_accepted in enumerate(accepted)):
        yield _ACCEPTED, ""
    # Any-hit shaders run for accepted hits and for those that they ignore themselves.
    ignored = sum(kind == _IGNORED and reports.t_min < t < reports.t_max for t, kind, _ in hits)
    if got["any_hits"] != sum(accepted) + ignored:
        yield _ATTRIBUTES, ", any-hit shader"


RECORD_RULES = (_HIT_RECORD, _FOUR_BITS, _MISS_RECORD)
LAUNCH_RULES = (_LAUNCH, _INDIRECT)
REPORT_RULES = (_ACCEPTED, _NEAREST, _ATTRIBUTES, _KEPT)
