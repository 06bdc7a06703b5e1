"""Iridescence: the reflectance of thin films against two oracles, energy, reciprocity, samples, albedos, packing and
textures; realtime frames of films against the path tracer."""

from __future__ import annotations

import numpy as np
import pytest
from support import brdf_runs
from support.seeded_bugs import Bug, bug_tests, with_shaders

import solari_vk as sv
from solari_vk.scene import shapes

FILM = "scene/lobes/iridescence.glsl"
COSINES = np.array((1.0, 0.8, 0.5, 0.2))
FILMS = [(ior, thickness) for ior in (1.2, 1.33, 1.5, 1.8) for thickness in (0, 150, 300, 450, 700, 2000)]
F0S = (0.04, 0.2, 0.6, 0.95)
RGB_OF_XYZ = np.array(((3.2404542, -1.5371385, -0.4985314), (-0.969266, 1.8760108, 0.041556), (0.0556434, -0.2040259, 1.0572252)))  # fmt: skip


def directions(cosines):
    return np.stack([np.sqrt(1 - np.square(cosines)), np.zeros(len(cosines)), cosines], axis=1)


def run(shaders, mode, fields, wo, wi=(0.0, 0.0, 1.0), count=None):
    """The rows of brdf.comp for a row of materials and one of directions each."""
    wo = np.atleast_2d(wo)
    records = np.concatenate([brdf_runs.materials(**one) for one in fields]).repeat(len(wo))
    return brdf_runs.run(shaders, mode, count or len(records), records, np.tile(wo, (len(fields), 1)), wi,
                         **brdf_runs.ALL_LOBES)  # fmt: skip


def film(ior, thickness, weight=1.0, **fields):
    return {"iridescence": weight, "iridescence_ior": ior, "iridescence_thickness": (0, thickness), **fields}


# ---- reflectance ------------------------------------------------------------------------------------


def measured(shaders):
    """What mirrors of metal reflect, (F0S, FILMS, COSINES, 3)."""
    fields = [film(*one, metallic=1.0, roughness=0.0, base_color=f0) for f0 in F0S for one in FILMS]
    rows = run(shaders, "draw", fields, directions(COSINES))
    return rows[:, 1].reshape(len(F0S), len(FILMS), len(COSINES), 3)


def model(f0, ior, thickness, cosine):
    """The paper's model by another way: amplitudes of Schlick's Fresnel, whose whole Airy sum is integrated over wave
    numbers under the Gaussians that stand for color matching functions."""
    if thickness == 0:
        return np.full(3, f0 + (1 - f0) * (1 - cosine) ** 5)
    below = np.sqrt(1 - (1 - cosine**2) / ior**2)
    base = (1 + np.sqrt(min(f0, 0.9999))) / (1 - np.sqrt(min(f0, 0.9999)))
    first, second = (((b - a) / (b + a)) ** 2 for a, b in ((1, ior), (ior, base)))
    first, second = first + (1 - first) * (1 - cosine) ** 5, second + (1 - second) * (1 - below) ** 5
    if not first:
        return np.full(3, second)
    # |r1 + r2 e^ix|^2 / |1 + r1 r2 e^ix|^2, with r1 < 0 < r2 where the surface is denser than the film.
    r1, r2 = -np.sqrt(first), np.sqrt(second) * (-1 if base > ior else 1)
    numbers = np.linspace(0.2e6, 4e6, 6000)  # in 2 pi / m
    phase = np.exp(2j * np.pi * numbers * 2e-9 * ior * thickness * below)
    reflected = np.abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2
    # Without interference the colors are those of the mean, which is added to what the Gaussians say of the rest.
    mean = first + (1 - first) ** 2 * second / (1 - first * second)
    xyz = np.zeros(3)
    for channel, value, center, variance in (
        (0, 5.4856e-13, 1.6810e6, 4.3278e9), (0, 9.7470e-14, 2.2399e6, 4.5282e9), (1, 4.4201e-13, 1.7953e6, 9.3046e9),
        (2, 5.2481e-13, 2.2084e6, 6.6121e9),
    ):  # fmt: skip
        weight = np.exp(-((numbers - center) ** 2) / (4 * variance))
        xyz[channel] += value * np.sqrt(2 * np.pi * variance) * np.average(reflected - mean, weights=weight)
    return np.clip(mean + RGB_OF_XYZ @ xyz / 1.0685e-7, 0, 1)


def physics(f0, ior, thickness, cosine):
    """The color of the exact reflectance of both polarizations, under light of equal energy, with the CIE 1931 color
    matching functions as Wyman et al. (2013) fit them."""
    waves = np.arange(380, 781, 2.0)

    def bell(center, left, right):
        return np.exp(-0.5 * ((waves - center) / np.where(waves < center, left, right)) ** 2)

    observer = np.array((
        1.056 * bell(599.8, 37.9, 31.0) + 0.362 * bell(442.0, 16.0, 26.7) - 0.065 * bell(501.1, 20.4, 26.2),
        0.821 * bell(568.8, 46.9, 40.5) + 0.286 * bell(530.9, 16.3, 31.1),
        1.217 * bell(437.0, 11.8, 36.0) + 0.681 * bell(459.0, 26.0, 13.8),
    ))  # fmt: skip
    base = (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))
    media = np.array((1.0, ior, base))
    cosines = np.sqrt(1 - (1 - cosine**2) / media**2)
    phase = np.exp(4j * np.pi * ior * thickness * cosines[1] / waves)
    reflected = np.zeros(len(waves))
    for admittance in (media * cosines, media / cosines):
        r1, r2 = ((admittance[i] - admittance[i + 1]) / (admittance[i] + admittance[i + 1]) for i in (0, 1))
        reflected += 0.5 * np.abs((r1 + r2 * phase) / (1 + r1 * r2 * phase)) ** 2
    return RGB_OF_XYZ @ (observer @ reflected) / observer[1].sum()


def expected(oracle):
    return np.array([[[oracle(f0, *one, cosine) for cosine in COSINES] for one in FILMS] for f0 in F0S])


def check_reflectance(shaders):
    """The shader cuts the sum of interferences after the second; bare surfaces reflect as Schlick's Fresnel."""
    error = np.abs(measured(shaders) - expected(model))
    print("model", error.max(axis=(1, 2, 3)), error.mean(axis=(1, 2, 3)))
    w = np.argsort(error.max(axis=-1).ravel())[::-1][:12]; print([(F0S[i], FILMS[j], COSINES[k], error[i, j, k].max()) for i, j, k in zip(*np.unravel_index(w, error.shape[:3]))])
    for k in range(4): print(COSINES[k], error[:, :, k].max(axis=(1, 2)), error[:, :, k].mean(axis=(1, 2)))
    assert error[:, [i for i, one in enumerate(FILMS) if not one[1]]].max() < 1e-5
    assert error[0].max() < 0.002
    assert error[1].max() < 0.02
    assert error.mean() < 0.02


def check_physics(shaders):
    error = np.abs(measured(shaders) - expected(physics))
    print("physics", error.max(axis=(1, 2, 3)), error.mean(axis=(1, 2, 3)))


@pytest.mark.parametrize("check", [check_reflectance, check_physics])
def test_holds(shaders, check):
    check(shaders)
