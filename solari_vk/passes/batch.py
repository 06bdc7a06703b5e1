"""First hits of many views in one frame; glsl/passes/batch/."""

from __future__ import annotations

from collections.abc import Collection

from solari_vk.gpu.frame.stages import Pass, Stage

GEOMETRY = ("depth", "distance", "position", "geometric_normal", "instance_id", "primitive")
"""What the surface at each pixel's center gives without its material: `reference.AOVS` says what those of a picture
are. primitive: the index of the triangle in the ray_mesh or mesh, -1 without a surface."""
MOTION = ("motion_vectors",)
"""The position in the previous frame minus the position, in shares of the picture, right and down, without jitter."""
MATERIALS = ("shading_normal", "camera_normal", "uv", "albedo", "roughness_metallic", "emissive", "material_id")
"""What needs the material of the surface; as in `reference.AOVS`."""
OUTPUTS = (*GEOMETRY, *MOTION, *MATERIALS)
MAX_PIXELS = 1 << 23  # of a dispatch, whose first hits take about 6 ms on an H100; drivers end dispatches of seconds


def labels_stage(strip: tuple[int, int], rows: int, outputs: Collection[str], instance_capacity: int) -> Stage:
    """The surface at the center of every pixel of the strip of `views`, and a dispatch over some rows, from the uniform
    first_row on. The last one over the strip stores the instances' transforms for the motion vectors of the next frame.

    Inputs: `views`, `triangle_orders`, `order_starts`. Outputs: `aov_*`, `previous_instances`.
    """
    pixels = strip[0] * strip[1]
    has_motion, has_materials = (not set(group).isdisjoint(outputs) for group in (MOTION, MATERIALS))
    sizes = dict.fromkeys(GEOMETRY, pixels)
    sizes |= dict.fromkeys(MOTION, pixels if has_motion else 1) | dict.fromkeys(
        MATERIALS, pixels if has_materials else 1
    )
    constants = {"has_motion": has_motion, "has_materials": has_materials}
    remember = Pass("batch/remember_instances", threads=instance_capacity)
    return Stage(
        "labels",
        buffers={
            **{f"aov_{name}": size for name, size in sizes.items()},
            "previous_instances": instance_capacity if has_motion else 1,
        },
        passes=[Pass("batch/labels", threads=(strip[0], rows), constants=constants), *[remember] * has_motion],
    )
