"""Runs brdf.comp of tests/proofs/brdf, which computes samples, values or albedos of materials for given directions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from solari_vk.conformance.shader_runner import ShaderRunner

LOBES: dict[str, Any] = {
    "transmission": 0.0, "ior": 1.5, "solid": 0, "inside": 0, "specular_weight": 1.0, "coat": 0.0,
    "coat_roughness": 0.0, "coat_normal": (0.0, 0.0, 1.0), "sheen_color": (0.0, 0.0, 0.0), "sheen_roughness": 0.0,
    "anisotropy": 0.0, "anisotropy_direction": (1.0, 0.0),
}  # fmt: skip
"""The fields of the lobes that few materials have, as in MaterialLobes, and the values of a material without them."""
MATERIAL = np.dtype(
    [("base_color", "<f4", 3), ("reflectance", "<f4", 3), ("metallic", "<f4"), ("perceptual_roughness", "<f4")]
    + [(name, "<u4" if isinstance(value, int) else "<f4", np.shape(value)) for name, value in LOBES.items()]
)
MODES = ("draw", "evaluate", "albedo", "sampled_albedo")
ALL_LOBES = {"SCENE_GLASS": True, "SCENE_LAYERS": True}
"""The constants for materials with such lobes."""
RESULT_COUNT = 4  # vectors that the shader writes for each row



def materials(
    base_color: ArrayLike = 1.0, reflectance: ArrayLike = 0.5, metallic: ArrayLike = 0.0, roughness: ArrayLike = 0.5,
    **lobes: ArrayLike,
) -> NDArray[Any]:  # fmt: skip
    """Records of the broadcast arguments; colors may be numbers or (..., 3). lobes: fields of LOBES, of all records."""
    shape = np.broadcast_shapes(np.shape(metallic), np.shape(roughness), np.shape(base_color)[:-1], (1,))
    records = np.zeros(shape, MATERIAL)
    for name, value in (LOBES | lobes).items():
        records[name] = value
    for name, value in (("metallic", metallic), ("perceptual_roughness", roughness)):
        records[name] = value
    for name, value in (("base_color", base_color), ("reflectance", reflectance)):
        records[name] = value if np.ndim(value) else np.full(3, value)
    return records.ravel()


def direction(degrees: float, turn: float = 0.4) -> NDArray[np.float32]:
    """A direction (3,) at this angle from the normal; `turn` is its azimuth in radians."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], np.float32)


def run(
    shaders: ShaderRunner, mode: str, count: int, materials: NDArray[Any], wo: ArrayLike, wi: ArrayLike | None = None,
    **constants: Any,
) -> NDArray[np.float32]:  # fmt: skip
    """The rows (count, 4, 3) that brdf.comp writes; constants are its specialization constants."""
    wo = np.atleast_2d(np.asarray(wo, np.float32))
    wi = np.zeros((1, 3), np.float32) if wi is None else np.atleast_2d(np.asarray(wi, np.float32))
    given = {"test_materials": materials, "outgoing": wo, "incoming": wi, **shaders.brdf_tables()}
    constants = {"MODE": MODES.index(mode), **constants}
    out = shaders.run("test/brdf", count, given, {"results": RESULT_COUNT * count}, constants=constants)
    return out["results"].reshape(count, RESULT_COUNT, 3)


def albedo(shaders: ShaderRunner, materials: NDArray[Any], wo: ArrayLike, **constants: Any) -> NDArray[np.float32]:
    """Directional albedo (N, 3) of each material seen from the direction of the same row."""
    return run(shaders, "albedo", max(len(materials), len(np.atleast_2d(wo))), materials, wo, **constants)[:, 0]
