"""Seeded bugs in the G-buffer's shaders: the check that should notice each must fail."""

from __future__ import annotations

import pytest
import test_gbuffer as still
import test_gbuffer_culling as culling
import test_gbuffer_motion as motion
import test_gbuffer_rays as rays

from solari_vk.gpu.shaders.patches import write_patched

FOLDER = "passes/gbuffer/"


def surfaces(device, glsl):
    still.check_raster_equals_rays(device, still.make_scene("material_zoo"), glsl=glsl)


def pictures(device, glsl):
    culling.check_culling(device, frame_count=24, glsl=glsl)


def counts(device, glsl):
    culling.check_counts(device, glsl)


def moves(device, glsl):
    motion.check_motion(device, glsl=glsl)


def rows(device, glsl):
    motion.check_rows(device, glsl)


def offsets(device, glsl):
    rays.check_offsets(device, glsl)


MUTANTS = {
    "jitter the wrong way": (surfaces, "raster.vert", "+ jitter * view.z", "- jitter * view.z"),
    "mirrored instances inside out": (surfaces, "raster.vert", "if (mirrored &&", "if (false &&"),
    "snapped points not put back": (surfaces, "pixel.glsl", "cosine < -1e-3 ? t : hit.t", "0.999 * hit.t"),
    "barycentrics swapped": (
        surfaces, "resolve.comp", "Hit(dot(point, ray.direction), row, triangle, barycentrics,",
        "Hit(dot(point, ray.direction), row, triangle, barycentrics.yx,",
    ),
    "double-sided like single-sided": (surfaces, "cull.comp", "& MATERIAL_DOUBLE_SIDED) != 0u", "& 0u) != 0u"),
    "rays' mesh drawn for its bounds": (pictures, "cull.comp", "mesh.most - mesh.least);\n", "mesh.least);\n"),
    "frustum without slack": (pictures, "cull.comp", "(1.0 + 4.0 / vec2(uniforms.size))", "0.95"),
    "extents with the wrong signs": (pictures, "cull.comp", "abs(normal * box.half_axes)", "normal * box.half_axes"),
    "boxes' far side for their near one": (pictures, "cull.comp", "min(nearest, view_depth)", "view_depth"),
    "pyramid of the nearest": (
        pictures, "depth_pyramid.comp", "farthest = min(\n", "farthest = max(\n",
    ),
    "pyramid off by a level": (
        pictures, "cull.comp", "pyramid_index(level, uvec2(x, y))", "pyramid_index(max(level, 2u) - 1u, uvec2(x, y))",
    ),
    "second pass takes last frame's word": (pictures, "cull.comp", "draws = visible && !was_visible", "draws = false"),
    "visibility of rows, not of instances": (
        rows, "cull.comp", "visible_instances.at[row] == instance.id", "visible_instances.at[row] != 0u",
    ),
    "nothing is ever hidden": (counts, "cull.comp", "/ nearest * 1.0001 <", "/ nearest * 1e9 <"),
    "nothing is ever out of view": (counts, "cull.comp", "&& is_outside_frustum(box)", "&& box.rounding < 0.0"),
    "all is drawn twice": (counts, "cull.comp", "draws = visible && !was_visible", "draws = visible"),
    "motion the wrong way": (moves, "pixel.glsl", "motion_vector(now, before)", "motion_vector(before, now)"),
    "motion of cameras only": (moves, "pixel.glsl", "motion_vector(now, before)", "motion_vector(now, now)"),
    "the sky is near": (
        moves, "pixel.glsl", "uniforms.previous_world_from_view[3] + ray.direction * 1e6",
        "uniforms.world_from_view[3] + ray.direction",
    ),
    "rows remembered, not instances": (
        rows, "gbuffer.glsl", "previous.id == instances.at[instance_index].id", "previous.id != 0u",
    ),
    "offset of the point alone": (
        offsets, "gbuffer.glsl", "+ world_ray_offset(reach, m, cofactors, object_normal)", "",
    ),
}  # fmt: skip


QUICK = {"mirrored instances inside out", "boxes' far side for their near one", "motion the wrong way"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in MUTANTS])
def test_seeded_bug_is_noticed(device, tmp_path, name):
    check, file, old, new = MUTANTS[name]
    root = write_patched(tmp_path, (FOLDER + file, old, new))
    with pytest.raises(AssertionError):
        check(device, root)
