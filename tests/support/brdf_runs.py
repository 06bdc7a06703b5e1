"""Runs brdf.comp of tests/proofs/brdf, which computes samples, values or albedos of materials for given directions."""

import numpy as np

LOBES = {
    "transmission": 0.0, "ior": 1.5, "solid": 0, "inside": 0, "specular_weight": 1.0, "anisotropy": 0.0,
    "anisotropy_direction": (1.0, 0.0), "coat": 0.0, "coat_roughness": 0.0, "coat_normal": (0.0, 0.0, 1.0),
    "sheen_color": (0.0, 0.0, 0.0), "sheen_roughness": 0.0,
}  # fmt: skip
"""The fields of the lobes that few materials have, as in brdf.comp, and the values of a material without them."""
MATERIAL = np.dtype(
    [("base_color", "<f4", 3), ("reflectance", "<f4", 3), ("metallic", "<f4"), ("perceptual_roughness", "<f4")]
    + [(name, "<u4" if isinstance(value, int) else "<f4", np.shape(value)) for name, value in LOBES.items()]
)
MODES = ("draw", "evaluate", "albedo", "sampled_albedo")
ALL_LOBES = {"SCENE_GLASS": True, "SCENE_LAYERS": True}
"""The constants for materials with such lobes."""
RESULT_COUNT = 4  # vectors that the shader writes for each row


def materials(base_color=1.0, reflectance=0.5, metallic=0.0, roughness=0.5, **lobes):
    """Records of the broadcast arguments; colors may be numbers or (..., 3). lobes: fields of LOBES, of all records."""
    shape = np.broadcast_shapes(np.shape(metallic), np.shape(roughness), np.shape(base_color)[:-1], (1,))
    records = np.zeros(shape, MATERIAL)
    given = {**LOBES, **lobes, "metallic": metallic, "perceptual_roughness": roughness}
    for name, value in (("base_color", base_color), ("reflectance", reflectance)):
        given[name] = value if np.ndim(value) else np.full(3, value)
    for name, value in given.items():
        records[name] = value
    return records.ravel()


def direction(degrees, turn=0.4):
    """A direction (3,) at this angle from the normal; `turn` is its azimuth in radians."""
    angle = np.radians(degrees)
    return np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], np.float32)


def run(shaders, mode, count, materials, wo, wi=(0.0, 0.0, 0.0), **constants):
    """The rows (count, 4, 3) that brdf.comp writes; constants are its specialization constants."""
    wo, wi = (np.atleast_2d(np.asarray(directions, np.float32)) for directions in (wo, wi))
    given = {"test_materials": materials, "outgoing": wo, "incoming": wi, **shaders.brdf_tables()}
    constants = {"MODE": MODES.index(mode), **constants}
    out = shaders.run("test/brdf", count, given, {"results": RESULT_COUNT * count}, constants=constants)
    return out["results"].reshape(count, RESULT_COUNT, 3)


def albedo(shaders, materials, wo, **constants):
    """Directional albedo (N, 3) of each material seen from the direction of the same row."""
    return run(shaders, "albedo", max(len(materials), len(np.atleast_2d(wo))), materials, wo, **constants)[:, 0]
