"""The directional albedo of the specular lobe, computed once for a renderer; glsl/passes/brdf_table/."""

from __future__ import annotations

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect

NAMES = ("brdf_table", "brdf_averages")


def stage() -> Stage:
    """The table over cosine and roughness, and its averages over the cosine. The shader defines the table's size."""
    shader = "passes/brdf_table/integrate.comp"
    size = int(reflect(compile_shader(shader), shader).constants["BRDF_TABLE_SIZE"].default)
    return Stage(
        "brdf_table",
        buffers={"brdf_table": size * size, "brdf_averages": size},
        passes=[Pass("brdf_table/integrate", threads=(size, size)), Pass("brdf_table/average", threads=size)],
    )


def compute(device: Device) -> tuple[Frame, dict[str, Buffer]]:
    """Run the stage; returns its frame, which owns the buffers, and the buffers by name."""
    frame = Frame(device, [stage()])
    frame.submit()
    return frame, {name: frame.resource(name) for name in NAMES}
