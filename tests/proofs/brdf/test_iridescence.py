"""Iridescence: the reflectance of thin films against two oracles, energy, reciprocity, samples, albedos and
textures. test_material_fields.py compares realtime frames, and so the packing of films, with the path tracer."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import ALL_LOBES, direction_at, material_records, run_brdf
from support.seeded_bugs import Bug, bug_tests, with_shaders

import solari_vk as sv
from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.scene import shapes

FILM = "scene/lobes/iridescence.glsl"
COSINES = np.array((1.0, 0.8, 0.5, 0.2))
FILMS = [(ior, thickness) for ior in (1.2, 1.33, 1.55, 1.8) for thickness in (0, 150, 300, 450, 700, 2000)]
F0S = (0.04, 0.2, 0.6, 0.95)
RGB_OF_XYZ = np.array(
    ((3.2404542, -1.5371385, -0.4985314), (-0.969266, 1.8760108, 0.041556), (0.0556434, -0.2040259, 1.0572252))
)


def directions(cosines):
    return np.stack([np.sqrt(1 - np.square(cosines)), np.zeros(len(cosines)), cosines], axis=1)


def run(shaders, mode, fields, wo, wi=(0.0, 0.0, 1.0)):
    """The rows of brdf.comp for a row of materials and one of directions each."""
    wo = np.atleast_2d(wo)
    records = np.concatenate([material_records(**one) for one in fields]).repeat(len(wo))
    wo = np.tile(wo, (len(fields), 1))
    return run_brdf(shaders, mode, len(records), records, wo, wi, **ALL_LOBES)


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
        (0, 5.4856e-13, 1.6810e6, 4.3278e9),
        (0, 9.7470e-14, 2.2399e6, 4.5282e9),
        (1, 4.4201e-13, 1.7953e6, 9.3046e9),
        (2, 5.2481e-13, 2.2084e6, 6.6121e9),
    ):
        weight = np.exp(-((numbers - center) ** 2) / (4 * variance))
        xyz[channel] += value * np.sqrt(2 * np.pi * variance) * np.average(reflected - mean, weights=weight)
    return np.clip(mean + RGB_OF_XYZ @ xyz / 1.0685e-7, 0, 1)


def physics(f0, ior, thickness, cosine):
    """The color of the exact reflectance of both polarizations, under light of equal energy, with the CIE 1931 color
    matching functions as Wyman et al. (2013) fit them."""
    waves = np.arange(380, 781, 2.0)

    def bell(center, left, right):
        return np.exp(-0.5 * ((waves - center) / np.where(waves < center, left, right)) ** 2)

    observer = np.array(
        (
            1.056 * bell(599.8, 37.9, 31.0) + 0.362 * bell(442.0, 16.0, 26.7) - 0.065 * bell(501.1, 20.4, 26.2),
            0.821 * bell(568.8, 46.9, 40.5) + 0.286 * bell(530.9, 16.3, 31.1),
            1.217 * bell(437.0, 11.8, 36.0) + 0.681 * bell(459.0, 26.0, 13.8),
        )
    )
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
    """Against the model: the shader cuts the sum of interferences after the second, which matters at grazing angles.
    Bare surfaces reflect as Schlick's Fresnel."""
    error = np.abs(measured(shaders) - expected(model))
    assert error[:, [i for i, one in enumerate(FILMS) if not one[1]]].max() < 1e-5
    assert error[:, :, 0].max() < 0.005
    assert error[:, :, 3].max() < 0.1
    assert error.mean() < 0.003


def check_physics(shaders):
    """Against physics: what Schlick's Fresnel and Gaussians lose, and white light that isn't adapted to D65, which
    tints bright metals. The mean is over films, angles and colors."""
    error = np.abs(measured(shaders) - expected(physics)).mean(axis=(1, 2, 3))
    np.testing.assert_array_less(error, (0.03, 0.05, 0.13, 0.13))


# ---- energy, reciprocity, samples -------------------------------------------------------------------

DEGREES = (0, 30, 60, 75, 84)
BASES = {
    "a white dielectric": {"base_color": 1.0},
    "a white dense dielectric": {"base_color": 1.0, "reflectance": 1.2},
    "white metal": {"base_color": 1.0, "metallic": 1.0},
    "half metal": {"base_color": 1.0, "metallic": 0.5},
    "a glass wall": {"transmission": 1.0},
    "glass": {"transmission": 1.0, "solid": True},
    "glass from within": {"transmission": 1.0, "solid": True, "inside": 1},
}
GAINS = {"glass": 1.012, "glass from within": 1.045}
LEAST = {"a white dielectric": 0.93, "a white dense dielectric": 0.85, "half metal": 0.96, "glass from within": 0.97}
GRID = [(1.3, 200), (1.3, 400), (1.8, 300), (2.2, 500)]


def furnace(shaders, base):
    """The albedos (roughnesses, GRID, DEGREES, 3) of white films."""
    wo = np.array([direction_at(degrees) for degrees in DEGREES])
    fields = [film(*one, roughness=roughness, **base) for roughness in (0.0, 0.3, 0.6, 1.0) for one in GRID]
    return run(shaders, "sampled_albedo", fields, wo)[:, 0].reshape(4, len(GRID), len(DEGREES), 3)


def check_furnace(shaders):
    """Films gain no light but on rough glass seen from within; what white dielectrics lose by glTF's layering is the
    difference of the brightest color to the others."""
    for name, base in BASES.items():
        albedos = furnace(shaders, base)
        print(name, albedos.max(), albedos.mean())
        assert albedos.max() < GAINS.get(name, 1.004), name
        assert albedos.mean() > LEAST.get(name, 0.98), name


def check_reciprocity(shaders):
    """Light takes each way back as it came; roughness is so small that multiple scattering, which isn't reciprocal,
    stays below the bar."""
    rng = np.random.default_rng(7)
    wo, wi = np.abs(rng.normal(size=(2, 20_000, 3))) + np.array((0, 0, 0.3))
    wo, wi = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (wo, wi))
    for base in ({"metallic": 1.0, "base_color": (0.9, 0.5, 0.2)}, {"base_color": 0.8}):
        there, back = (
            run(shaders, "evaluate", [film(1.5, 300, roughness=0.1, **base)], a, b)[:, (1, 3)].sum(axis=1) / b[:, 2:]
            for a, b in ((wo, wi), (wi, wo))
        )
        error = np.abs(there - back) / (back + 1e-3 * back.max())
        assert error.max() < 1e-2, base


def check_samples(shaders):
    """The weight of a sample is f cos / pdf, also where films darken a lobe to nothing."""
    wo = np.tile(direction_at(50), (50_000, 1))
    for name, base in BASES.items():
        rows = run(shaders, "draw", [film(1.8, 300, roughness=0.4, **base)], wo).astype(np.float64)
        weight = rows[:, 1]
        pdf, drawn_pdf, _ = rows[:, 2].T
        value = rows[:, 3]
        valid = (drawn_pdf > 0) & (rows[:, 0, 2] != 0)
        off = np.abs(weight[valid] * pdf[valid, None] - value[valid]) / np.maximum(value[valid], 1e-4)
        assert valid.mean() > 0.8, name
        assert off.max() < 2e-3, name


def check_lobe_albedos(shaders):
    """What demodulation, the guides of denoisers and the world cache take for the albedo is that of the samples."""
    wo = np.array([direction_at(degrees) for degrees in DEGREES])
    for name in ("a white dielectric", "white metal", "half metal"):
        colored = BASES[name] | {"base_color": (0.9, 0.5, 0.2)}
        fields = [film(*one, roughness=roughness, **colored) for roughness in (0.0, 0.3, 0.6) for one in GRID]
        estimated = run(shaders, "lobe_albedos", fields, wo)[:, :2].sum(axis=1)
        error = np.abs(estimated - run(shaders, "sampled_albedo", fields, wo)[:, 0])
        print(name, error.mean(), error.max())
        assert error.mean() < 0.01, name
        assert error.max() < 0.1, name


def check_absence(shaders):
    """A factor of 0 is a material without a film, bit by bit."""
    wo = np.array([direction_at(degrees) for degrees in np.linspace(0, 85, 500)])
    for base in BASES.values():
        records = material_records(**film(1.8, 300, 0.0, roughness=0.3, **base)).repeat(len(wo))
        for mode in ("draw", "lobe_albedos"):
            one, other = (
                run_brdf(shaders, mode, len(wo), records, wo, **ALL_LOBES | {"SCENE_IRIDESCENCE": on})
                for on in (True, False)
            )
            np.testing.assert_array_equal(one, other)


CHECKS = (
    check_reflectance,
    check_physics,
    check_furnace,
    check_reciprocity,
    check_samples,
    check_lobe_albedos,
    check_absence,
)


@pytest.mark.parametrize("check", CHECKS)
def test_holds(shaders, check):
    check(shaders)


# ---- textures ---------------------------------------------------------------------------------------


def test_textures(tracer):
    """Red weighs the film, and green goes from the first to the second thickness."""
    texel = np.array([[(51, 102, 0, 255)]], np.uint8)
    common = {"metallic": 1.0, "roughness": 0.2, "iridescence_ior": 1.6}
    found = []
    for fields in (
        {
            "iridescence": 1.0,
            "iridescence_texture": texel,
            "iridescence_thickness": (200, 700),
            "iridescence_thickness_texture": texel,
        },
        {"iridescence": 0.2, "iridescence_thickness": 400},
    ):
        scene = sv.Scene(sv.Environment(np.ones((4, 8, 3), np.float32)))
        scene.add(shapes.sphere(1, 16), sv.Material(**common, **fields))
        scene.camera = sv.Camera.look_at((0, 0, 3), (0, 0, 0))
        found.append(tracer(scene, (12, 12)).render(samples=4)["radiance"])
    np.testing.assert_allclose(*found, rtol=2e-5)
    assert np.ptp(found[0][6, 6]) > 0.01, "the film has a color"


def test_a_film_on_a_pane_dims_what_shadow_rays_find(device):
    lit = []
    for weight in (0.0, 1.0):
        scene = sv.Scene(sv.PointLight((0, 2, 0), intensity=100))
        glass = sv.Material(base_color=1, transmission=1, roughness=0, **film(1.8, 300, weight))
        scene.add(shapes.quad((0, 1, 0), (1, 0, 0), (0, 0, 1)), glass)
        lit.append(sv.illuminance(device, scene, [(0, 0, 0)], samples=16, max_bounces=0).lux[0])
    filmed = 1 - model(0.04, 1.8, 300, 1.0) @ LUMINANCE_WEIGHTS
    assert lit[1] / lit[0] == pytest.approx(filmed / (1 - 0.04), abs=0.002)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "interference": (
            with_shaders(check_reflectance),
            Bug(FILM, "film_sensitivity", "return correct(1.05 * path, shift);"),
        ),
        "films gain light": (
            with_shaders(check_furnace),
            Bug(FILM, "film_cover", "return 0.5 * correct(cover, mean, ab);"),
        ),
        "reciprocity": (
            with_shaders(check_reciprocity),
            Bug(
                "scene/lobes/specular.glsl",
                "add_film",
                "correct(specular, LdotH, dielectric, metal); metal *= 1.0 + 0.2 * specular.albedo_terms.y;",
            ),
        ),
        "albedos": (with_shaders(check_lobe_albedos), Bug(FILM, "film_albedo", "return 0.5 * correct(mean, ab);")),
        "absence": (
            with_shaders(check_absence),
            Bug(
                "scene/base_material.glsl",
                "resolve_film",
                "ThinFilm film = correct(material, point); film.weight = max(film.weight, 1e-3); return film;",
            ),
        ),
    },
    quick=("interference",),
)
