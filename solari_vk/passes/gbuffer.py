"""The G-buffer: the surface that each pixel shows, and its position in the previous frame; glsl/passes/gbuffer/."""

from __future__ import annotations

from collections.abc import Collection

from solari_vk.gpu.frame.stages import Draw, DrawList, History, IfUsed, Pass, Stage
from solari_vk.settings import Settings

COUNTERS = ("drawn_first", "drawn_second", "frustum_culled", "occlusion_culled")
"""Fields of `gbuffer_counters`, numbers of instances: drawn because they were visible in the previous frame, drawn
because those don't hide them, outside the frustum, and occluded. Their sum is the number of visible instances."""

_DRAW_COUNT_BYTES = 4
PROXIES = "SCENE_PROXIES"  # the feature of instances with a ray_mesh
VAST = "SCENE_VAST"  # that of instances which are too large for rasterizers
PREVIOUS_INSTANCES = "previous_instances"  # the rows stay valid when the table of instances grows


def chosen_method(
    device_kind: str, method: str = "auto", features: Collection[str] = (), has_lens: bool = False
) -> str:
    """ "raster" or "traced". For "auto", what is faster on a device of this kind (`DeviceProperties.kind`), and raster
    where a scene with these features has meshes for rays alone, so that pictures show the others; traced for cameras
    with a lens, since raster draws straight lines, and else for instances too large for raster."""
    if method != "auto":
        return method
    if has_lens:
        return "traced"
    if PROXIES in features:
        return "raster"
    return "raster" if device_kind == "cpu" and VAST not in features else "traced"


def stage(
    size: tuple[int, int], settings: Settings, instance_capacity: int, method: str, has_lobes: bool = False
) -> Stage:
    """The images of the packed layout with their history. instance_capacity: rows of the scene's `instances`. method:
    "raster" or "traced".

    has_lobes: whether the scene's materials need more than the first image has.
    Outputs: `gbuffer`, `gbuffer_surface`, `gbuffer_offsets`, `gbuffer_lobes`, `depth`, `motion_vectors`; for the next
    frame `visible_instances`.
    """
    # Few scenes have lobes such as coats; the others need no memory for them.
    lobes = size[0] * size[1] if has_lobes else 1
    buffers: dict[str, int | History | IfUsed] = {PREVIOUS_INSTANCES: instance_capacity, "gbuffer_lobes": IfUsed(lobes)}
    images: dict[str, tuple[int, int] | History] = {
        "gbuffer": History(size),
        "gbuffer_surface": History(size),
        "gbuffer_offsets": size,
        "depth": History(size),
        "motion_vectors": size,
    }
    passes: list[Pass | Draw] = [Pass("gbuffer/trace", threads=size)]
    if method == "raster":
        levels = _pyramid_sizes(size) if settings.occlusion_culling else []
        buffers |= _raster_buffers(instance_capacity, levels)
        images |= {"raster_triangles": size, "raster_depth": size}
        passes = _raster_passes(settings, instance_capacity, levels)
        passes.append(Pass("gbuffer/resolve", threads=size))
    return Stage("gbuffer", buffers=buffers, images=images, passes=passes)


def raster_stage(size: tuple[int, int], instance_capacity: int) -> Stage:
    """The nearest triangle of each pixel alone.

    Outputs: `raster_triangles`, `depth`; for the next frame `visible_instances`.
    """
    return Stage(
        "raster",
        buffers=_raster_buffers(instance_capacity, []),
        images={"raster_triangles": size, "raster_depth": size, "depth": size},
        passes=_raster_passes(Settings(occlusion_culling=False), instance_capacity, []),
    )


def last_stage(instance_capacity: int) -> Stage:
    """Stores the transforms of this frame for the motion vectors of the next. It is the last stage, because all others
    need those of the previous frame.

    Inputs: `previous_instances`. Outputs: `previous_instances`, `older_instances`.
    """
    older = {"older_instances": instance_capacity}
    return Stage("remember", buffers=older, passes=[Pass("gbuffer/remember_instances", threads=instance_capacity)])


def _raster_buffers(instance_capacity: int, levels: list[tuple[int, int]]) -> dict[str, int]:
    return {
        "gbuffer_counters": 1,
        "draw_counts": 1,
        "single_sided_draws": instance_capacity,
        "double_sided_draws": instance_capacity,
        "visible_instances": instance_capacity,
        # All levels one after the other; a buffer has at least one element.
        "depth_pyramid": max(sum(width * height for width, height in levels), 1),
    }


def _raster_passes(settings: Settings, rows: int, levels: list[tuple[int, int]]) -> list[Pass | Draw]:
    """Draws the instances that were visible in the previous frame, then those that the first ones don't hide: Haar and
    Aaltonen, "GPU-Driven Rendering Pipelines" (2015). Without levels of the depth pyramid, draws all that are in
    view."""

    def draw(number: int) -> list[Pass | Draw]:
        constants = {
            "draw_pass": number,
            "frustum_culling": settings.frustum_culling,
            "occlusion_culling": settings.occlusion_culling,
        }
        at = 2 * number * _DRAW_COUNT_BYTES  # each of the two passes has two counts
        lists = [
            DrawList("single_sided_draws", "draw_counts", rows, at),
            DrawList("double_sided_draws", "draw_counts", rows, at + _DRAW_COUNT_BYTES, culls_backs=False),
        ]
        return [
            Pass("gbuffer/cull", threads=rows, constants=constants),
            Draw("gbuffer/raster", lists, ("raster_triangles", "depth"), "raster_depth", clears=number == 0),
        ]

    passes = [Pass("gbuffer/begin", threads=1), *draw(0)]
    for number, level in enumerate(levels, 1):
        passes.append(Pass("gbuffer/depth_pyramid", threads=level, constants={"level": number}))
    return [*passes, *draw(1)] if levels else passes


def _pyramid_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """The sizes of the depth pyramid's levels from 1 on: each has a quarter of the width and height of the one before,
    and the last is a single texel."""
    sizes: list[tuple[int, int]] = []
    while not sizes or size != (1, 1):
        # Rounded up, so that each texel of a level stands for up to 4 x 4 of the one before, and none is left out.
        size = (-(-size[0] // 4), -(-size[1] // 4))
        sizes.append(size)
    return sizes
