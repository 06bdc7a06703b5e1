"""First hits of many views in one frame; glsl/passes/batch/."""

from __future__ import annotations

from solari_vk.gpu.frame.stages import Pass, Stage

GEOMETRY = ("depth", "position", "geometric_normal", "instance_id", "primitive", "motion_vectors")
"""What the surface at each pixel's center gives without its material: `pathtracer.AOVS` says what those of a picture
are. primitive: the index of the triangle in the ray_mesh or mesh, -1 without a surface. motion_vectors: the position in
the previous frame minus the position, in shares of the picture, right and down, without jitter."""
MATERIALS = ("shading_normal", "albedo", "roughness_metallic", "emissive")
"""What needs the material of the surface; as in `pathtracer.AOVS`."""


def labels_stage(strip: tuple[int, int], rows: int, materials: bool) -> Stage:
    """The surface at the center of every pixel of the strip of `views`, and a dispatch over some rows, from the uniform
    first_row on.

    Inputs: `views`, `previous_instances`, `triangle_orders`, `order_starts`. Outputs: `aov_*`.
    """
    pixels = strip[0] * strip[1]
    sizes = dict.fromkeys(GEOMETRY, pixels) | dict.fromkeys(MATERIALS, pixels if materials else 1)
    return Stage(
        "labels",
        buffers={f"aov_{name}": size for name, size in sizes.items()},
        passes=[Pass("batch/labels", threads=(strip[0], rows), constants={"has_materials": materials})],
    )


def last_stage(instance_capacity: int) -> Stage:
    """Stores the instances' transforms for the motion vectors of the next frame, in the last dispatch over the strip.

    Inputs: `views`. Outputs: `previous_instances`.
    """
    return Stage(
        "remember",
        buffers={"previous_instances": instance_capacity},
        passes=[Pass("batch/remember_instances", threads=instance_capacity)],
    )
