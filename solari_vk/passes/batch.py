"""First hits of many views in one frame; glsl/passes/batch/."""

from __future__ import annotations

from collections.abc import Collection

from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.passes import first_hits
from solari_vk.passes.first_hits import FIRST_HITS

GEOMETRY = (*first_hits.GEOMETRY, "primitive")
"""What the surface at each pixel's center gives without its material. primitive: the index of the triangle in the
ray_mesh or mesh, -1 without a surface."""
MOTION = ("motion_vectors",)
"""The position in the previous frame minus the position, in shares of the picture, right and down, without jitter."""
MATERIALS = tuple(name for name in FIRST_HITS if name not in GEOMETRY)
"""What needs the material of the surface."""
OUTPUTS = (*GEOMETRY, *MOTION, *MATERIALS)
MAX_PIXELS = 1 << 23  # of a dispatch, whose first hits take about 6 ms on an H100; drivers end dispatches of seconds


def labels_stage(strip: tuple[int, int], rows: int, outputs: Collection[str], instance_capacity: int) -> Stage:
    """The surface at the center of every pixel of the strip of `views`, and a dispatch over some rows, from the uniform
    first_row on. The last one over the strip stores the instances' transforms for the motion vectors of the next frame.

    Inputs: `views`, `triangle_orders`, `order_starts`. Outputs: `aov_*`, `previous_instances`.
    """
    # Views stand below each other in a strip, so that one dispatch covers all of them, or some rows of it.
    pixels = strip[0] * strip[1]
    has_motion = not set(MOTION).isdisjoint(outputs)
    has_materials = not set(MATERIALS).isdisjoint(outputs)
    # Geometry costs next to nothing where a ray is traced, so all of it is stored whenever some is asked for.
    sizes = dict.fromkeys(GEOMETRY, pixels)
    sizes |= dict.fromkeys(MOTION, pixels if has_motion else 1)
    sizes |= dict.fromkeys(MATERIALS, pixels if has_materials else 1)
    constants = {"has_motion": has_motion, "has_materials": has_materials}
    passes = [Pass("batch/labels", threads=(strip[0], rows), constants=constants)]
    if has_motion:
        passes.append(Pass("batch/remember_instances", threads=instance_capacity))
    return Stage(
        "labels",
        buffers={
            **{f"aov_{name}": size for name, size in sizes.items()},
            "previous_instances": instance_capacity if has_motion else 1,
        },
        passes=passes,
    )
