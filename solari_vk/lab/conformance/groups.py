"""The groups of the suite: what each of them measures, and in which cases."""

from __future__ import annotations

from solari_vk.lab.conformance import (
    bulk_checks,
    discarded_checks,
    embree_checks,
    position_checks,
    probe_checks,
    ray_cases,
    ray_pipeline_checks,
    renderer_checks,
    structure_checks,
)
from solari_vk.lab.conformance.cases import Measure, by, cases_of, with_device, with_shaders
from solari_vk.lab.conformance.ray_cases import parts as parts
from solari_vk.lab.structures import BUILD_MODES, FRESH

_DRIVER = ("query", "pipeline")
RAYS = {
    "acceleration_structures": _DRIVER,
    "ray_pipelines": ("pipeline",),
    "ray_queries": ("query",),
    "ray_traversal": _DRIVER,
    "compute_rays": ("compute",),
}
"""The ways to trace that a group is about. The suite opens the device for the first one that it has, unless it is told
another way."""
GROUPS: dict[str, dict[str, Measure]] = {
    "acceleration_structures": {
        "inactive_instances": with_shaders(structure_checks.measure_inactive_instances),
        **cases_of("inactive", ray_cases.inactive, "triangle", "box"),
        "ways": with_shaders(structure_checks.measure_build_modes),
        "formats": with_shaders(structure_checks.measure_formats),
        "indices": with_shaders(structure_checks.measure_indices),
        "nothing": with_shaders(structure_checks.measure_nothing),
        "rebuilds": with_shaders(structure_checks.measure_tlas_rebuilds),
        "many_blases": ray_cases.many_blases,
        **cases_of("large_tlas", ray_cases.large_tlas, 100_000, 1_000_000),
    },
    "ray_pipelines": {
        **cases_of("probes", ray_cases.ray_probes, *BUILD_MODES),
        "records": by("pipeline", ray_pipeline_checks.RECORD_RULES, with_shaders(ray_pipeline_checks.measure_records)),
        "launches": by(
            "pipeline", ray_pipeline_checks.LAUNCH_RULES, with_shaders(ray_pipeline_checks.measure_launches)
        ),
        "nested": by("pipeline", discarded_checks.NESTED_RULES, with_shaders(discarded_checks.measure_nested)),
        "reports": by("pipeline", ray_pipeline_checks.REPORT_RULES, with_shaders(ray_pipeline_checks.measure_reports)),
    },
    "ray_queries": {
        **cases_of("probes", ray_cases.probes, *BUILD_MODES),
        **cases_of("probes", ray_cases.probes, *((FRESH, stage) for stage in probe_checks.STAGES[1:])),
        "not_finite": by("query", bulk_checks.NOT_FINITE_RULES, with_shaders(bulk_checks.measure_not_finite)),
        "discarded": by("query", discarded_checks.DISCARDED_RULES, with_shaders(discarded_checks.measure_discarded)),
        "vertex_return": by("query", position_checks.RULES.values(), ray_cases.vertex_return),
    },
    "ray_traversal": {
        **cases_of("embree", ray_cases.embree, *embree_checks.SCENES),
        "watertight": with_shaders(bulk_checks.measure_watertight),
        "many_instances": ray_cases.many_instances,
        "extreme_transforms": with_shaders(bulk_checks.measure_extreme_transforms),
        "thin_triangles": with_shaders(bulk_checks.measure_thin_triangles),
    },
    "compute_rays": {
        **cases_of("embree", ray_cases.embree_exactly, *embree_checks.SCENES, *embree_checks.BUILTIN),
        "watertight": with_shaders(bulk_checks.measure_watertight),
        "many_instances": ray_cases.many_instances,
        "extreme_transforms": with_shaders(bulk_checks.measure_extreme_transforms),
        "thin_triangles": with_shaders(bulk_checks.measure_thin_triangles),
        "inactive_instances": with_shaders(structure_checks.measure_inactive_instances),
    },
    "renderer": {
        "series": with_device(renderer_checks.measure_series),
        "closed_room": with_device(renderer_checks.measure_closed_room),
        "frames": with_device(renderer_checks.measure_frames),
        "gbuffer": with_device(renderer_checks.measure_gbuffer),
    },
}
