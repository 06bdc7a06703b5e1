"""The directional albedo of the specular lobe, of sheen and of glass, computed once for a renderer;
glsl/passes/brdf_table/."""

from __future__ import annotations

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect

NAMES = ("brdf_table", "brdf_averages", "sheen_table", "glass_table")


def stage() -> Stage:
    """The tables over cosine and roughness, that of glass also over the index of refraction, and the averages of the
    first one over the cosine. Shaders define the sizes."""
    size, glass, slices = (
        int(reflect(compile_shader(shader), shader).constants[name].default)
        for shader, name in (
            ("passes/brdf_table/integrate.comp", "BRDF_TABLE_SIZE"),
            ("passes/brdf_table/glass.comp", "GLASS_TABLE_SIZE"),
            ("passes/brdf_table/glass.comp", "GLASS_TABLE_SLICES"),
        )
    )
    return Stage(
        "brdf_table",
        buffers={
            "brdf_table": size * size,
            "brdf_averages": size,
            "sheen_table": size * size,
            "glass_table": glass * glass * slices,
        },
        passes=[
            Pass("brdf_table/integrate", threads=(size, size)),
            Pass("brdf_table/average", threads=size),
            Pass("brdf_table/sheen", threads=(size, size)),
            Pass("brdf_table/glass", threads=(glass, glass, slices)),
        ],
    )


def compute(device: Device) -> tuple[Frame, dict[str, Buffer]]:
    """Run the stage; returns its frame, which owns the buffers, and the buffers by name."""
    frame = Frame(device, [stage()])
    frame.submit()
    return frame, {name: frame.resource(name) for name in NAMES}
