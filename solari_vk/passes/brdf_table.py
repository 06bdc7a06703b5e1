"""The directional albedo of the specular lobe, of sheen, of glass and of anisotropic metal, computed once for a
renderer; glsl/passes/brdf_table/."""

from __future__ import annotations

from contextlib import ExitStack

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.frame.stages import Pass, Stage
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect

NAMES = ("brdf_table", "brdf_averages", "sheen_table", "glass_table", "anisotropy_table")


def stage() -> Stage:
    """The tables over cosine and roughness, that of glass also over the index of refraction, that of anisotropic metal
    over the direction and strength of anisotropy, and the averages of the first one over the cosine. Shaders define the
    sizes.

    Outputs: `*_table`, `brdf_averages`.
    """
    size = _constant("integrate", "BRDF_TABLE_SIZE")
    glass = _constant("glass", "GLASS_TABLE_SIZE")
    slices = _constant("glass", "GLASS_TABLE_SLICES")
    anisotropy = _constant("anisotropy", "ANISOTROPY_TABLE_SIZE")
    return Stage(
        "brdf_table",
        buffers={"brdf_averages": size, "glass_table": glass * glass * slices, "anisotropy_table": anisotropy**4},
        images={"brdf_table": (size, size), "sheen_table": (size, size)},
        passes=[
            # Single-scattering GGX as F0 A + B (Karis 2013), then its average over the hemisphere for the diffuse lobe
            # below (Kulla and Conty 2017).
            Pass("brdf_table/integrate", threads=(size, size)),
            Pass("brdf_table/average", threads=size),
            Pass("brdf_table/sheen", threads=(size, size)),
            # Light that is scattered several times is added by dividing by these (Turquin 2019).
            Pass("brdf_table/glass", threads=(glass, glass, slices)),
            Pass("brdf_table/anisotropy", threads=(anisotropy, anisotropy, anisotropy**2)),
        ],
    )


def _constant(shader: str, name: str) -> int:
    """The default of a specialization constant of one of the stage's shaders."""
    path = f"passes/brdf_table/{shader}.comp"
    return int(reflect(compile_shader(path), path).constants[name].default)


def compute(device: Device) -> tuple[Frame, dict[str, Buffer | Image]]:
    """Run the stage; returns its frame, which owns the tables, and the tables by name."""
    with ExitStack() as undo:
        frame = undo.enter_context(Frame(device, [stage()]))
        frame.submit()
        undo.pop_all()
    return frame, {name: frame.resource(name) for name in NAMES}
