"""The groups of the suite: what each of them measures, and in which cases."""

from __future__ import annotations

from solari_vk.lab.conformance import (
    bulk_checks,
    embree_checks,
    position_checks,
    probe_checks,
    ray_cases,
    ray_pipeline_checks,
    renderer_checks,
    structure_checks,
)
from solari_vk.lab.conformance.cases import Measure, by, cases_of
from solari_vk.lab.conformance.ray_cases import parts as parts
from solari_vk.lab.structures import BUILD_MODES, FRESH

RAYS = {"ray_pipelines": "pipeline", "ray_queries": "query"}
"""The way to trace that a group is about. The suite opens the device for it, unless it is told another way."""
GROUPS: dict[str, dict[str, Measure]] = {
    "acceleration_structures": {
        "inactive_instances": lambda run: structure_checks.measure_inactive_instances(run.shaders),
        **cases_of(
            "inactive",
            lambda run, kind: structure_checks.measure_inactive_primitives(run.shaders, kind),
            "triangle",
            "box",
        ),
        "ways": lambda run: structure_checks.measure_build_modes(run.shaders),
        "formats": lambda run: structure_checks.measure_formats(run.shaders),
        "indices": lambda run: structure_checks.measure_indices(run.shaders),
        "nothing": lambda run: structure_checks.measure_nothing(run.shaders),
        "rebuilds": lambda run: structure_checks.measure_tlas_rebuilds(run.shaders),
        "many_blases": lambda run: structure_checks.measure_many_blases(run.shaders, 2000 if run.full else 500),
        **cases_of("large_tlas", ray_cases.large_tlas, 100_000, 1_000_000),
    },
    "ray_pipelines": {
        **cases_of("probes", ray_cases.ray_probes, *BUILD_MODES),
        "records": by(
            "pipeline", ray_pipeline_checks.RECORD_RULES, lambda run: ray_pipeline_checks.measure_records(run.shaders)
        ),
        "launches": by(
            "pipeline", ray_pipeline_checks.LAUNCH_RULES, lambda run: ray_pipeline_checks.measure_launches(run.shaders)
        ),
        "reports": by(
            "pipeline", ray_pipeline_checks.REPORT_RULES, lambda run: ray_pipeline_checks.measure_reports(run.shaders)
        ),
    },
    "ray_queries": {
        **cases_of("probes", ray_cases.probes, *BUILD_MODES),
        **cases_of("probes", ray_cases.probes, *((FRESH, stage) for stage in probe_checks.STAGES[1:])),
        "not_finite": by("query", bulk_checks.NOT_FINITE_RULES, lambda r: bulk_checks.measure_not_finite(r.shaders)),
        "vertex_return": by("query", position_checks.RULES.values(), ray_cases.vertex_return),
    },
    "ray_traversal": {
        **cases_of("embree", ray_cases.embree, *embree_checks.SCENES),
        "watertight": lambda run: bulk_checks.measure_watertight(run.shaders),
        "many_instances": lambda run: bulk_checks.measure_many_instances(run.shaders, 100_000 if run.full else 70_000),
        "extreme_transforms": lambda run: bulk_checks.measure_extreme_transforms(run.shaders),
        "thin_triangles": lambda run: bulk_checks.measure_thin_triangles(run.shaders),
    },
    "renderer": {
        "series": lambda run: renderer_checks.measure_series(run.device),
        "closed_room": lambda run: renderer_checks.measure_closed_room(run.device),
        "frames": lambda run: renderer_checks.measure_frames(run.device),
        "gbuffer": lambda run: renderer_checks.measure_gbuffer(run.device),
    },
}
