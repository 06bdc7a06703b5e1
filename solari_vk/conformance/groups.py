"""The groups of the suite: what each of them measures, and in which cases."""

from __future__ import annotations

from solari_vk.conformance import (
    alpha_checks,
    brdf_checks,
    bulk_checks,
    display_checks,
    embree_checks,
    environment_checks,
    gbuffer_checks,
    guide_checks,
    light_checks,
    light_tree_checks,
    lobe_checks,
    material_lobe_checks,
    path_checks,
    pose_checks,
    position_checks,
    probe_checks,
    punctual_checks,
    ray_cases,
    ray_pipeline_checks,
    structure_checks,
)
from solari_vk.conformance.cases import Measure, by, cases_of
from solari_vk.conformance.ray_cases import parts as parts
from solari_vk.conformance.worlds import FRESH, WAYS

# Each light strategy; random directions almost never meet the small sun, so that "brdf" leaves it out.
_SUNS = [(0.0093, "mis"), (0.0093, "nee"), (0.8, "mis"), (0.8, "nee"), (0.8, "brdf")]
_WHITE_WALLS = [(roughness, metallic) for roughness in (0.0, 0.15, 0.5, 1.0) for metallic in (0.0, 0.5, 1.0)]

RAYS = {"ray_pipelines": "pipeline", "ray_queries": "query"}
"""The way to trace that a group is about. The suite opens the device for it, unless it is told another way."""
GROUPS: dict[str, dict[str, Measure]] = {
    "acceleration_structures": {
        "inactive_instances": lambda run: structure_checks.measure_inactive_instances(run.shaders),
        **cases_of("inactive", lambda run, kind: structure_checks.measure_inactive_primitives(run.shaders, kind),
                   "triangle", "box"),
        "ways": lambda run: structure_checks.measure_ways(run.shaders),
        "formats": lambda run: structure_checks.measure_formats(run.shaders),
        "indices": lambda run: structure_checks.measure_indices(run.shaders),
        "nothing": lambda run: structure_checks.measure_nothing(run.shaders),
        "rebuilds": lambda run: structure_checks.measure_tlas_rebuilds(run.shaders),
        "many_blases": lambda run: structure_checks.measure_many_blases(run.shaders, 2000 if run.full else 500),
        **cases_of("large_tlas", ray_cases.large_tlas, 100_000, 1_000_000),
    },
    "brdf": {
        **cases_of("white_furnace", lambda run, metal: brdf_checks.measure_furnace(run.shaders, metal), 0.0, 0.5, 1.0),
        "draws": lambda run: brdf_checks.measure_draws(run.shaders, brdf_checks.CASES, 1_000_000),
        "numbers": lambda run: brdf_checks.measure_numbers(run.shaders, 1_000_000),
        "lobes": lambda run: material_lobe_checks.measure_lobes(run.shaders, 1_000_000),
    },
    "poses": {
        "vertices": lambda run: pose_checks.measure_vertices(run.device),
        **cases_of("normals", lambda run, way: pose_checks.measure_normals(run.device, way), "raster", "traced"),
        **cases_of("motion", lambda run, way: pose_checks.measure_motion(run.device, way), "raster", "traced"),
    },
    "display": {"picture": lambda run: display_checks.measure_picture(run.device),
                "views": lambda run: display_checks.measure_views(run.device)},
    "environments": {
        **cases_of("floor", lambda run, strategy: environment_checks.measure_floor(run.device, strategy),
                   "mis", "nee", "brdf"),
        "background": lambda run: environment_checks.measure_background(run.device),
        "mirror": lambda run: environment_checks.measure_mirror(run.device),
        "texels": lambda run: environment_checks.measure_texels(run.device),
        "sun": lambda run: environment_checks.measure_sun(run.device, 4096 if run.full else 512),
        "means": lambda run: environment_checks.measure_means(
            run.device, environment_checks.FULL if run.full else environment_checks.FAST),
    },
    "gbuffer": {
        **cases_of("raster", lambda run, scene: gbuffer_checks.measure_raster(
            run.device, gbuffer_checks.make_scene(scene)), *gbuffer_checks.SCENES),
        **cases_of("motion", lambda run, way: gbuffer_checks.measure_motion(run.device, way), "raster", "traced"),
        **cases_of("still", lambda run, way: gbuffer_checks.measure_still(run.device, way), "raster", "traced"),
        "culling": lambda run: gbuffer_checks.measure_culling(run.device),
    },
    "guides": {
        **cases_of("mirrors", lambda run, name: guide_checks.measure_mirrors(run.device, name), *guide_checks.MIRRORS),
        "wall": lambda run: guide_checks.measure_wall(run.device),
        "range": lambda run: guide_checks.measure_range(run.device),
        "parts": lambda run: guide_checks.measure_parts(run.device),
    },
    "lights": {
        **cases_of("lamp", lambda run, strategy: light_checks.measure_lamp(run.device, strategy), "mis", "nee", "brdf"),
        **cases_of(
            "textured_lamp", lambda run, strategy: light_checks.measure_textured_lamp(run.device, strategy),
            "mis", "nee", "brdf",
        ),
        **cases_of("sun", lambda run, *case: light_checks.measure_sun(run.device, *case), *_SUNS),
        "invariance": lambda run: light_checks.measure_invariance(run.device),
        **cases_of("punctual", lambda run, *of: punctual_checks.measure_floor(run.device, *of), *punctual_checks.CASES),
        "punctual_several": lambda run: punctual_checks.measure_several(run.device),
        "punctual_seen": lambda run: punctual_checks.measure_seen(run.device),
    },
    "path_tracer": {
        **cases_of("series", lambda run, bounces: path_checks.measure_series(run.device, bounces), 0, 1, 5),
        **cases_of("white_box", lambda run, *case: path_checks.measure_white_box(run.device, *case), *_WHITE_WALLS),
        "light_tight": lambda run: path_checks.measure_light_tight(run.device),
        "seeds": lambda run: path_checks.measure_seeds(run.device),
        "alpha": lambda run: alpha_checks.measure_alpha(run.device),
    },
    "paths": {
        "light_tree": lambda run: light_tree_checks.measure_tree(run.shaders),
        "mirrors": lambda run: lobe_checks.measure_mirrors(run.device),
        "mirror_chain": lambda run: lobe_checks.measure_mirror_chain(run.device),
        "lobes": lambda run: lobe_checks.measure_lobes(run.device, run.shaders),
        "distances": lambda run: lobe_checks.measure_distances(run.device),
    },
    "ray_pipelines": {
        **cases_of("probes", ray_cases.ray_probes, *WAYS),
        "records": by("pipeline", ray_pipeline_checks.RECORD_RULES,
                      lambda run: ray_pipeline_checks.measure_records(run.shaders)),
        "launches": by("pipeline", ray_pipeline_checks.LAUNCH_RULES,
                       lambda run: ray_pipeline_checks.measure_launches(run.shaders)),
        "reports": by("pipeline", ray_pipeline_checks.REPORT_RULES,
                      lambda run: ray_pipeline_checks.measure_reports(run.shaders)),
    },
    "ray_queries": {
        **cases_of("probes", ray_cases.probes, *WAYS),
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
}  # fmt: skip
