"""Runs brdf.comp of tests/proofs/brdf, which computes samples, values or albedos of materials for given directions."""

import numpy as np

from solari_vk.bound.constants import MATERIAL_SOLID, NO_INDEX
from solari_vk.bound.features import LOBES
from solari_vk.bound.material_record import TYPES
from solari_vk.scene.material import TEXTURES

_NUMPY = {"float": ("<f4", ()), "vec2": ("<f4", 2), "vec3": ("<f4", 3), "uint": ("<u4", ())}
MATERIAL = np.dtype(
    [(name, *_NUMPY[kind]) for name, kind in TYPES.items()]
    + [("inside", "<u4"), ("coat_normal", "<f4", 3), ("anisotropy_direction", "<f4", 2)]
)
WITHOUT_LOBES = {
    **dict.fromkeys(TEXTURES, NO_INDEX),
    "ior": 1.5,
    "specular": 1.0,
    "coat_normal": (0.0, 0.0, 1.0),
    "anisotropy_direction": (1.0, 0.0),
}
"""The fields of a record whose value is not 0 for a material without lobes that few materials have."""
MODES = ("draw", "evaluate", "albedo", "sampled_albedo", "lobe_albedos")
ALL_LOBES = dict.fromkeys(LOBES, True)
"""The constants for materials with such lobes."""
RESULT_COUNT = 4  # vectors that the shader writes for each row


def materials(base_color=1.0, reflectance=0.5, metallic=0.0, roughness=0.5, solid=False, **lobes):
    """Records of the broadcast arguments; colors may be numbers or (..., 3). lobes: fields of MATERIAL, of all
    records."""
    shape = np.broadcast_shapes(np.shape(metallic), np.shape(roughness), np.shape(base_color)[:-1], (1,))
    records = np.zeros(shape, MATERIAL)
    given = {**WITHOUT_LOBES, **lobes, "flags": MATERIAL_SOLID * solid}
    given |= {"metallic": metallic, "perceptual_roughness": roughness}
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
