"""What ray pipelines have that ray queries don't: records of the shader binding table, launches, reported hits."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from solari_vk.gpu.frame.frame import HitGroup, RayPass
from solari_vk.lab.conformance.probes import triangle
from solari_vk.lab.conformance.ray_probe_checks import GLSL
from solari_vk.lab.conformance.rules import VULKAN, Measurement, Rule, count_wrong
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
_GEOMETRIES, _OFFSETS = 4, (0, 1, 13, 32)
_MISSES = 8


def measure_records(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """Trace rays at four geometries in each of four instances. `damage` changes the rays, to seed bugs."""
    parts = [Triangles(triangle(3 * i)[None]) for i in range(_GEOMETRIES)]
    placed = [Placement("row", translation(0, 5 * i), sbt_offset=offset) for i, offset in enumerate(_OFFSETS)]
    choices = (0, 1, 2, 7, 15)
    cases = list(itertools.product(range(len(_OFFSETS)), range(_GEOMETRIES), (*choices, 17), (*choices, 18)))
    rays = np.zeros(len(cases) + 2 * _MISSES, shaders.element("conformance/records.rgen", "record_rays"))
    instance, geometry, offset, stride = np.array(cases).T
    rays["origin"][: len(cases)] = np.stack([3 * geometry + 0.5, 5 * instance + 0.5, np.ones(len(cases))], 1)
    rays["offset"][: len(cases)], rays["stride"][: len(cases)] = offset, stride
    rays["origin"][len(cases) :] = (-9, -9, 1)
    misses = np.arange(2 * _MISSES) % _MISSES
    rays["miss"][len(cases) :] = misses + 0x10000 * (np.arange(2 * _MISSES) // _MISSES)
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
            ways = {
                _LAUNCH: RayPass("conformance/launch", threads=size, misses=misses),
                _INDIRECT: RayPass("conformance/launch", indirect="launch_counts", misses=misses),
            }
            ids = np.stack(np.unravel_index(np.arange(x * y * z), (z, y, x))[::-1], 1)
            for rule, step in ways.items():
                # Elements after the last show whether there are too many invocations.
                inputs = {"tlas": structures.tlas, "launch_counts": counts}
                found = shaders.run_steps([step], inputs, {"launches": np.zeros(len(ids) + 64, dtype)})["launches"]
                right = found["count"].tolist() == [1] * len(ids) + [0] * 64
                for stage in ("generation", "miss"):
                    told = found[stage][: len(ids)]
                    right &= (told["id"] == ids).all() and (told["size"] == (x, y, z)).all()
                if not right:
                    wrong[rule].append("x".join(map(str, size)))
    for rule, sizes in wrong.items():
        yield count_wrong(rule, sizes)


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
# By name: Tmin, Tmax, the reported t and their kinds, which of them are accepted (None: this depends on the order in
# which the driver meets the boxes), and x of the ray: 0.5 meets a box that reports all, 2.5 three that report one each.
Triple = tuple[int, int, int]
_REPORTS: dict[str, tuple[float, float, Triple, Triple, Triple | None, float]] = {
    "ever nearer": (0, 100, (9, 6, 3), (1, 2, 3), (1, 1, 1), 0.5),
    "ever farther": (0, 100, (3, 6, 9), (1, 2, 3), (1, 0, 0), 0.5),
    "nearest in the middle": (0, 100, (6, 3, 4), (0, 64, 1), (1, 1, 0), 0.5),
    "before Tmin": (5, 100, (1, 2, 4), (1, 2, 3), (0, 0, 0), 0.5),
    "one before Tmin": (5, 100, (4, 8, 7), (1, 2, 3), (0, 1, 1), 0.5),
    "beyond Tmax": (0, 8, (9, 20, 1000), (1, 2, 3), (0, 0, 0), 0.5),
    "one beyond Tmax": (0, 8, (9, 6, 7), (1, 126, 3), (0, 1, 0), 0.5),
    "ignored": (0, 100, (3, 4, 5), (_IGNORED, _IGNORED, _IGNORED), (0, 0, 0), 0.5),
    "nearest ignored": (0, 100, (3, 6, 5), (_IGNORED, 2, 3), (0, 1, 1), 0.5),
    "ignored between": (0, 100, (6, 3, 5), (1, _IGNORED, 3), (1, 0, 1), 0.5),
    # All behind the boxes, so that each box is met.
    "of several boxes": (0, 100, (40, 60, 50), (1, 2, 3), None, 2.5),
    "of several boxes, in another order": (0, 100, (60, 40, 50), (1, 2, 3), None, 2.5),
}


def measure_reports(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """Report several hits of a box, and one hit of each of several boxes. `damage` changes the rays, to seed bugs."""
    rays = np.zeros(len(_REPORTS), shaders.element("conformance/report.rgen", "report_rays"))
    for ray, (t_min, t_max, ts, kinds, _, x) in zip(rays, _REPORTS.values(), strict=True):
        ray["origin"], ray["t_min"], ray["t_max"], ray["t"], ray["kind"] = (x, 0.5, 2), t_min, t_max, ts, kinds
    if damage is not None:
        damage(rays)
    files = (f"{_FOLDER}/report.{suffix}" for suffix in ("rchit", "rahit", "rint"))
    step = RayPass("conformance/report", threads=len(rays), misses=[f"{_FOLDER}/report.rmiss"], hits=[HitGroup(*files)])
    # The box reaches far enough for rays with a large Tmin to meet it, and no report depends on where it is.
    box, several = (
        np.array([[(x, 0, low - 2 * i), (x + 1, 1, 1 - 2 * i)] for i in range(count)])
        for x, low, count in ((0, -1000, 1), (2, 0, 3))
    )
    shapes = {"box": [Boxes(box)], "several": [Boxes(several)]}
    placed = [Placement("box"), Placement("several", custom=1)]
    with Structures(shaders.device, shapes, placed, own_records=True) as structures:
        before = np.zeros(len(rays), shaders.element("conformance/report.rgen", "reported"))
        answers = shaders.run_steps([step], {"tlas": structures.tlas, "report_rays": rays}, {"reported": before})
    wrong: dict[Rule, list[str]] = {_ACCEPTED: [], _NEAREST: [], _ATTRIBUTES: [], _KEPT: []}
    for (name, (t_min, t_max, ts, kinds, accepted, _)), got in zip(_REPORTS.items(), answers["reported"], strict=True):
        reports = list(zip(ts, kinds, accepted or (1, 1, 1), strict=True))
        t, kind = min(((t, kind) for t, kind, yes in reports if yes), default=(-1, 0))
        if (got["t"], got["kind"]) != (t, kind):
            wrong[_NEAREST].append(f"{name} (t = {got['t']:g}, kind {got['kind']})")
        last = accepted is not None and (accepted[-1] or not any(accepted))
        if t >= 0 and tuple(got["attributes"]) != (t, -t, kind, 0.25 * t + kind):
            wrong[_ATTRIBUTES if last else _KEPT].append(name)
        if accepted is None:
            continue
        if got["accepted"] != sum(yes << i for i, yes in enumerate(accepted)):
            wrong[_ACCEPTED].append(name)
        ignored = sum(kind == _IGNORED and t_min < t < t_max for t, kind, _ in reports)
        if got["any_hits"] != sum(accepted) + ignored:
            wrong[_ATTRIBUTES].append(f"{name}, any-hit shader")
    for rule, names in wrong.items():
        yield count_wrong(rule, names)


RECORD_RULES = (_HIT_RECORD, _FOUR_BITS, _MISS_RECORD)
LAUNCH_RULES = (_LAUNCH, _INDIRECT)
REPORT_RULES = (_ACCEPTED, _NEAREST, _ATTRIBUTES, _KEPT)
