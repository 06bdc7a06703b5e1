"""Glass, clearcoat, sheen, anisotropy and diffuse transmission: energy, the distribution of samples, and
reciprocity; realtime frames of leaves against the path tracer."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np
import pytest
from support.frames import ALL_LOBES, Effort, direction_at, material_records, measure_paths, run_brdf
from support.seeded_bugs import GLSL, Bug, bug_tests, require, with_shaders
from support.statistics import chi_squared_p, sidak

import solari_vk as sv
from solari_vk.gpu.shaders import compiler
from solari_vk.scene import shapes

DEGREES = (0, 30, 60, 75, 84)
WHITE_GLASS = {"base_color": 1.0, "transmission": 1.0}
SIDES = {
    "a thin wall": {},
    "the outside of a solid": {"solid": True},
    "the inside of a solid": {"solid": True, "inside": 1},
}
LEAF = {"diffuse_transmission": 0.6, "diffuse_transmission_color": 1.0}
LAYERS = {
    "a smooth coat": {"clearcoat": 1.0, "roughness": 0.5},
    "a rough coat on metal": {"clearcoat": 1.0, "clearcoat_roughness": 0.4, "metallic": 1.0, "roughness": 0.4},
    "a tilted coat": {"clearcoat": 1.0, "clearcoat_roughness": 0.3, "coat_normal": (0.28, 0.0, 0.96), "roughness": 0.6},
    "sheen": {"sheen_color": 1.0, "sheen_roughness": 0.4, "roughness": 0.6},
    "smooth sheen": {"sheen_color": 1.0, "sheen_roughness": 0.1, "roughness": 0.6},
    "anisotropic metal": {"anisotropy": 0.6, "anisotropy_direction": (0.6, 0.8), "metallic": 1.0, "roughness": 0.4},
    "strongly anisotropic metal": {
        "anisotropy": 1.0, "anisotropy_direction": (0.6, 0.8), "metallic": 1.0, "roughness": 0.2,
    },
    "an anisotropic dielectric": {"anisotropy": 0.9, "anisotropy_direction": (0.6, 0.8), "roughness": 0.3},
    "a smooth anisotropic dielectric": {"anisotropy": 0.6, "anisotropy_direction": (0.6, 0.8), "roughness": 0.2},
    "weak reflections": {"specular": 0.3, "roughness": 0.3},
    "a leaf": {**LEAF, "roughness": 0.4},
    "a coated lampshade": {
        **LEAF, "diffuse_transmission": 1.0, "clearcoat": 1.0, "clearcoat_roughness": 0.4, "roughness": 0.6,
    },
    "all at once": {
        "clearcoat": 0.6, "clearcoat_roughness": 0.5, "sheen_color": 0.5, "sheen_roughness": 0.5, "anisotropy": 0.5,
        "metallic": 0.3, "transmission": 0.5, "solid": True, "roughness": 0.5, **LEAF,
    },
}  # fmt: skip
# What layers take twice, from light on its way down and up, is at most the layer's mean albedo: that of a coat is
# F0 + (1 - F0) / 21. Tilted coats also send grazing reflections below the surface. Where the albedo of an anisotropic
# dielectric is unknown, its bound loses light.
COAT_LOSS = 0.04 + 0.96 / 21
LOSSES = {
    "a tilted coat": 0.3,
    "sheen": 0.11,
    "anisotropic metal": 0.01,
    "strongly anisotropic metal": 0.01,
    "an anisotropic dielectric": 0.22,
    "a smooth anisotropic dielectric": 0.12,
    "a leaf": 0.01,
}
SMOOTH = ("a smooth coat", "smooth sheen", "a smooth anisotropic dielectric")  # whose lobes cells don't resolve
DRAWN = {f"glass, {name}": {"roughness": 0.55, **WHITE_GLASS, **side} for name, side in SIDES.items()}
FILM = {"iridescence": 1.0, "iridescence_ior": 1.8, "iridescence_thickness": (0, 300)}
DRAWN |= {f"a film on {name}": {**fields, **FILM} for name, fields in DRAWN.items()}
DRAWN |= {name: layers for name, layers in LAYERS.items() if name not in SMOOTH}
DRAWN["a film on metal"] = {"metallic": 1.0, "roughness": 0.5, **FILM}
CELLS = (32, 32)  # over the cosine, of both sides, and the turn of a direction
FINE = 12  # points of a cell along each axis


def run(shaders, mode, count, record, wo, wi=None):
    return run_brdf(shaders, mode, count, record, wo, wi, **ALL_LOBES)


# ---- energy -----------------------------------------------------------------------------------------


def sampled_albedos(shaders, turn, materials):
    """The albedos (materials, DEGREES, 3)."""
    wo = np.tile([direction_at(degrees, turn) for degrees in DEGREES], (len(materials), 1))
    records = np.concatenate([material_records(**fields) for fields in materials]).repeat(len(DEGREES))
    return run(shaders, "sampled_albedo", len(wo), records, wo)[:, 0].reshape(len(materials), len(DEGREES), 3)


def check_glass_furnace(shaders):
    """White glass neither gains nor loses light, at any roughness, from both sides, also when it reflects less than its
    index of refraction says."""
    materials = [
        {"roughness": roughness, "ior": ior, "reflectance": weight * 2.5 * (ior - 1) / (ior + 1), **WHITE_GLASS, **side}
        for side, roughness, (ior, weight) in itertools.product(
            SIDES.values(), (0.0, 0.15, 0.3, 0.5, 0.75, 1.0), ((1.1, 1.0), (1.5, 1.0), (1.8, 1.0), (1.5, 0.4))
        )
    ]
    for material, albedo in zip(materials, sampled_albedos(shaders, 0.4, materials), strict=True):
        np.testing.assert_allclose(albedo, 1, atol=0.01, err_msg=str(material))


def check_layer_furnace(shaders):
    """Layers over a white surface gain no light, but for interpolation in tables, and lose little."""
    for turn in (0.3, 0.927, 2.5):
        for name, albedo in zip(LAYERS, sampled_albedos(shaders, turn, list(LAYERS.values())), strict=True):
            print(name, albedo.min(), albedo.max())
            assert albedo.max() < 1.004, name
            assert albedo.min() > 1 - LOSSES.get(name, COAT_LOSS), name


def charlie(alpha, wo, wi):
    """Sheen of white fibers times the cosine of wi (N,), as appendix B of KHR_materials_sheen and Khronos' sample
    viewer have it: Estevez and Kulla (2017)."""
    half_vector = wo + wi
    half_vector /= np.linalg.norm(half_vector, axis=1, keepdims=True)
    distribution = (2 + 1 / alpha) * (1 - half_vector[:, 2] ** 2) ** (0.5 / alpha) / (2 * np.pi)
    weight = (1 - alpha) ** 2
    a, b, c, d, e = (
        np.array((21.5473, 3.82987, 0.19823, -1.97760, -4.32054)) * (1 - weight)
        + np.array((25.3245, 3.32435, 0.16801, -1.27393, -4.85967)) * weight
    )

    def fit(cosine):
        return a / (1 + b * cosine**c) + d * cosine + e

    def shadowing(cosine):
        below = np.exp(fit(np.minimum(cosine, 0.5)))
        return np.where(cosine < 0.5, below, np.exp(2 * fit(0.5) - fit(np.minimum(1 - cosine, 0.5))))

    return distribution / ((1 + shadowing(wo[:, 2]) + shadowing(wi[:, 2])) * 4 * wo[:, 2])


def check_charlie(shaders):
    """Sheen over black has the values of its formula, and the albedo of the formula's integral."""
    rng = np.random.default_rng(5)
    z = rng.uniform(0.17, 1, (2, 20_000))
    turn, sine = rng.uniform(0, 2 * np.pi, z.shape), np.sqrt(1 - z**2)
    wo, wi = np.stack([sine * np.cos(turn), sine * np.sin(turn), z], axis=-1)
    steps = (np.arange(400) + 0.5) / 400  # of the cosine and of the turn
    cosine, around = (grid.ravel() for grid in np.meshgrid(steps, 2 * np.pi * steps))
    over = np.stack([np.sqrt(1 - cosine**2) * f(around) for f in (np.cos, np.sin)] + [cosine], axis=1)
    for roughness in (0.3, 0.5, 1.0):
        black = {"base_color": 0.0, "specular": 0.0, "sheen_color": 1.0, "sheen_roughness": roughness}
        rows = run(shaders, "evaluate", len(wo), material_records(**black), wo, wi)
        expected = charlie(roughness**2, wo, wi)
        np.testing.assert_allclose(rows[:, 1, 0] + rows[:, 3, 0], expected, rtol=2e-3, atol=1e-5 * expected.max())
        for degrees, albedo in zip(DEGREES[:4], sampled_albedos(shaders, 0.4, [black])[0, :4], strict=True):
            seen = np.broadcast_to(direction_at(degrees).astype(np.float64), over.shape)
            whole = 2 * np.pi * charlie(roughness**2, seen, over).mean()
            np.testing.assert_allclose(albedo, whole, rtol=0.02, err_msg=f"{roughness}, {degrees} degrees")


# ---- samples ----------------------------------------------------------------------------------------


def sphere_cells(wi):
    """The rows and columns of CELLS of directions (N, 3): equal steps of the cosine and of the turn."""
    row = np.clip(((wi[:, 2] + 1) / 2 * CELLS[0]).astype(np.intp), 0, CELLS[0] - 1)
    turn = np.arctan2(wi[:, 1], wi[:, 0]) / (2 * np.pi) % 1
    return row, np.minimum((turn * CELLS[1]).astype(np.intp), CELLS[1] - 1)


def expected_shares(shaders, material, wo):
    """The probability of each cell, from brdf_pdf: Gauss quadrature over the cosine, midpoints over the turn."""
    nodes, weights = np.polynomial.legendre.leggauss(FINE)
    cosine = (np.arange(CELLS[0])[:, None] + (nodes + 1) / 2) / CELLS[0] * 2 - 1
    turn = 2 * np.pi * (np.arange(CELLS[1] * FINE) + 0.5) / (CELLS[1] * FINE)
    z, phi = (grid.ravel() for grid in np.meshgrid(cosine.ravel(), turn, indexing="ij"))
    sine = np.sqrt(1 - z * z)
    wi = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)
    pdf = run(shaders, "evaluate", len(wi), material, wo, wi)[:, 2, 0]
    cells = pdf.astype(np.float64).reshape(CELLS[0], FINE, CELLS[1], FINE).sum(axis=3)
    return np.einsum("rnc,n->rc", cells, weights / CELLS[0]) * 2 * np.pi / (CELLS[1] * FINE)


def check_draws(shaders, count, names=tuple(DRAWN)):
    """Samples of rough lobes follow brdf_pdf, and their weights are f cos / pdf."""
    wo = direction_at(50)
    for name in names:
        record = material_records(**{"base_color": 0.8, **DRAWN[name]})
        rows = run(shaders, "draw", count, record, wo).astype(np.float64)
        wi = rows[:, 0]
        weight = rows[:, 1]
        pdf, drawn_pdf, _ = rows[:, 2].T
        value = rows[:, 3]
        valid = (drawn_pdf > 0) & (wi[:, 2] != 0)
        off = np.abs(weight[valid] * pdf[valid, None] - value[valid]) / np.maximum(value[valid], 1e-4)
        assert off.max() < 2e-3, name
        shares = expected_shares(shaders, record, wo)
        counts = np.zeros(CELLS)
        np.add.at(counts, sphere_cells(wi[valid]), 1)
        observed = np.append(counts, count - valid.sum())
        expected = np.append(np.maximum(shares, 1e-12), max(1 - shares.sum(), 1e-12)) * count
        assert chi_squared_p(observed, expected) > sidak(0.01, len(DRAWN)), name


# ---- reciprocity ------------------------------------------------------------------------------------


def check_reciprocity(shaders, count=100_000):
    """Light takes each way back as it came; through glass, divided by the square of the index of refraction."""
    rng = np.random.default_rng(7)

    def directions():
        v = rng.normal(size=(count, 3))
        v[:, 2] = np.abs(v[:, 2]) + 0.2
        return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), np.float32)

    def values(wo, wi, **fields):
        rows = run(shaders, "evaluate", len(wo), material_records(**fields), wo, wi)
        return (rows[:, 1] + rows[:, 3])[:, 0] / np.abs(wi[:, 2])

    def require_equal(there, back, bar, what):
        error = (np.abs(there - back) / (np.abs(back) + 1e-3 * np.abs(back).max())).max()
        assert error < bar, what

    flip = np.array((1, 1, -1), np.float32)
    # So smooth that multiple scattering, which isn't reciprocal, stays below the bar.
    solid = {"roughness": 0.15, "ior": 1.5, "solid": True, **WHITE_GLASS}
    wo = directions()
    wi = run(shaders, "draw", count, material_records(**solid), wo)[:, 0]
    refracted = (wi[:, 2] < -0.2) & (wo[:, 2] > 0.5)
    wo, wi = wo[refracted], wi[refracted]
    there, back = values(wo, wi, **solid), values(wi * flip, wo * flip, **solid, inside=1)
    require_equal(there, back * 1.5**2, 1e-2, "glass")
    wo, wi = directions(), directions()
    require_equal(values(wo, wi * flip, **LEAF), values(wi, wo * flip, **LEAF), 1e-3, "a leaf")
    for name, fields in (
        ("sheen over a diffuse surface", {"sheen_color": 0.8, "sheen_roughness": 0.5, "reflectance": 0.0}),
        ("a coat over a diffuse surface", {"clearcoat": 0.8, "clearcoat_roughness": 1e-3, "reflectance": 0.0}),
        (
            "an anisotropic dielectric without multiple scattering",
            {"anisotropy": 0.7, "base_color": 0.0, "reflectance": 0.0, "roughness": 0.4},
        ),
    ):
        require_equal(values(wo, wi, **fields), values(wi, wo, **fields), 1e-3, name)


# ---- each check holds, and can fail -----------------------------------------------------------------


@pytest.mark.parametrize("check", [check_glass_furnace, check_layer_furnace, check_charlie, check_reciprocity])
def test_holds(shaders, check):
    check(shaders)


@pytest.mark.slow
def test_draws(shaders):
    check_draws(shaders, 1_000_000)


# ---- realtime frames --------------------------------------------------------------------------------


def leaves():
    """A leaf and a lampshade between a floor and a lamp, seen from both sides, and a mirror that shows them."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 2), (2, 0, 0)), sv.Material(base_color=0.5, roughness=1.0))
    for x, share, turn in ((-0.9, 0.5, 0.4), (0.3, 1.0, -0.4)):
        leaf = sv.Material(
            base_color=(0.3, 0.5, 0.1),
            roughness=0.4,
            double_sided=True,
            diffuse_transmission=share,
            diffuse_transmission_color=(0.6, 0.8, 0.1),
        )
        scene.add(shapes.quad((x, 0.8, 0), (0.5, turn, 0), (0, turn, 0.5)), leaf)
    mirror = sv.Material(base_color=0.9, metallic=1.0, roughness=0.0)
    scene.add(shapes.quad((0, 0.7, -1.2), (1.5, 0, 0), (0, 0.7, 0)), mirror)
    scene.add(shapes.quad((0, 2.5, 0), (0.5, 0, 0), (0, 0, 0.5)), sv.Material(base_color=0, emissive=(9, 8, 6)))
    scene.add(sv.PointLight((0.5, 0.2, 0.3), intensity=0.3))
    scene.environment = sv.Environment(np.full((4, 8, 3), 0.3, np.float32))
    scene.camera = sv.Camera.look_at((0, 2.0, 2.5), (0, 0.6, 0), vertical_fov=0.75)
    return scene


@pytest.mark.slow
def test_frames_have_the_path_tracers_mean(device):
    plain = Effort(16, 0, 64), 0.01
    cached = Effort(16, 24, 64), 0.02, 0.1
    require(measure_paths(device, leaves(), 8192, {"one": plain, "several": plain, "cached": cached}))


GLASS, COAT, SHEEN, TRANSMISSION = (
    f"scene/lobes/{name}.glsl" for name in ("glass", "coat", "sheen", "diffuse_transmission")
)


# ---- a lobe of one's own ----------------------------------------------------------------------------

DUST = """
#include "scene/lobes/interface.glsl"
struct DustParameters { float share; };
struct Dust { float share; };
const DustParameters NO_DUST = DustParameters(0.25);
DustParameters resolve_lobe(DustParameters none, Material material, TexturePoint point) { return none; }
uint pack_lobe(DustParameters dust, mat3 frame) { return 0u; }
DustParameters unpack_lobe(DustParameters none, uint bits, mat3 frame) { return none; }
void limit_roughness(inout DustParameters dust, float smallest) {}
Dust prepare_lobe(DustParameters dust, BaseMaterial base, vec3 wo) { return Dust(dust.share); }
LobeAlbedo lobe_albedo(DustParameters dust, BaseMaterial base, vec3 wo) {
    return LobeAlbedo(vec3(1.0), dust.share, true);
}
LobeAlbedo lobe_albedo(Dust dust, vec3 wo) { return LobeAlbedo(vec3(1.0), dust.share, true); }
vec3 diffuse_value(Dust dust, vec3 wo, vec3 wi) { return vec3(dust.share * INVERSE_PI * wi.z); }
vec3 specular_value(Dust dust, vec3 wo, vec3 wi) { return vec3(0.0); }
float lobe_pdf(Dust dust, vec3 wo, vec3 wi) { return max(wi.z, 0.0) * INVERSE_PI; }
LobeSample sample_lobe(Dust dust, vec3 wo, float choice, vec2 u) {
    return spread_sample(sample_cosine_hemisphere(u), true);
}
float lobe_cover(Dust dust, vec3 wo, vec3 wi) { return dust.share; }
float lobe_spread(Dust dust, float probability) { return 1.0; }
void remove_diffuse(inout Dust dust) { dust.share = 0.0; }
void leave_out(inout Dust dust) { dust.share = 0.0; }
"""
"""A quarter of every surface is covered by white dust."""


def check_dust(shaders):
    """Over black and over white, a quarter of the light comes from the dust, and the rest is as it was."""
    materials = [{"base_color": color, "roughness": 0.5} for color in (0.0, 1.0)]
    clean = sampled_albedos(shaders, 0.4, materials)
    with tempfile.TemporaryDirectory() as name:
        lobes = Path(name, "scene", "lobes")
        lobes.mkdir(parents=True)
        (lobes / "dust.glsl").write_text(f"#ifndef DUST_GLSL\n#define DUST_GLSL\n{DUST}\n#endif\n", encoding="utf-8")
        listed = (GLSL / "scene/lobes/list.glsl").read_text(encoding="utf-8")
        row = "#define LAYER_3(DO) DO(dust, Dust, DustParameters, NO_DUST, SCENE_LAYERS, uint)\n"
        listed = listed.replace("#define LAYERS(DO) ", f'#include "scene/lobes/dust.glsl"\n{row}#define LAYERS(DO) ')
        listed = listed.replace("LAYER_1(DO) LAYER_2(DO)", "LAYER_1(DO) LAYER_2(DO) LAYER_3(DO)")
        listed = listed.replace("LAYER_2(DO) LAYER_1(DO)", "LAYER_3(DO) LAYER_2(DO) LAYER_1(DO)")
        (lobes / "list.glsl").write_text(listed, encoding="utf-8")
        compiler.overlays.insert(0, Path(name))
        try:
            dusty = sampled_albedos(shaders, 0.4, materials)
        finally:
            compiler.overlays.pop(0)
    np.testing.assert_allclose(dusty, 0.25 + 0.75 * clean, atol=0.01)


def test_a_new_lobe_is_a_file_and_a_row(device):
    with_shaders(check_dust)(device)


GLASS_FURNACE, LAYER_FURNACE = with_shaders(check_glass_furnace), with_shaders(check_layer_furnace)
RECIPROCITY = with_shaders(check_reciprocity)
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "glass furnace": (GLASS_FURNACE, Bug("scene/brdf_table.glsl", "lookup_glass_table", "return vec2(1.0, 0.0);")),
        "layers gain light": (LAYER_FURNACE, Bug(COAT, "lobe_cover", "return 1.0;")),
        "layers lose light": (LAYER_FURNACE, Bug(SHEEN, "lobe_cover", "return 0.5 * correct(sheen, wo, wi);")),
        "density of glass": (
            with_shaders(check_draws, 200_000, ["glass, a thin wall"]),
            Bug(GLASS, "glass_jacobian", "return 1.1 * correct(glass, wo, wi, m);"),
        ),
        "density of coats": (
            with_shaders(check_draws, 200_000, ["a rough coat on metal"]),
            Bug(COAT, "coat_pdf", "return 1.1 * correct(coat, wi);"),
        ),
        "density of anisotropic lobes": (
            with_shaders(check_draws, 200_000, ["anisotropic metal"]),
            Bug("scene/microfacet.glsl", "ggx_vndf_pdf_per_d(vec3 wo, vec2", "return 1.1 * correct(wo, roughness);"),
        ),
        "density of diffuse transmission": (
            with_shaders(check_draws, 200_000, ["a leaf"]),
            Bug(TRANSMISSION, "diffuse_transmission_pdf", "return 1.1 * correct(lobe, wi);"),
        ),
        "reciprocity of diffuse transmission": (
            RECIPROCITY,
            Bug(
                TRANSMISSION,
                "evaluate_diffuse_transmission",
                "return correct(lobe, specular, wo, wi) * (1.0 + 0.1 * wo.z);",
            ),
        ),
        "a pixel's diffuse transmission": (
            test_frames_have_the_path_tracers_mean,
            Bug(
                TRANSMISSION,
                "unpack_diffuse_transmission",
                "DiffuseTransmissionParameters lobe = correct(bits); lobe.weight *= 0.9; return lobe;",
            ),
        ),
        "reciprocity of glass": (
            RECIPROCITY,
            Bug(GLASS, "evaluate_glass", "return correct(glass, wo, wi) * (1.0 + 0.1 * wo.z);"),
        ),
        "another sheen": (
            with_shaders(check_charlie),
            Bug(SHEEN, "sheen_alpha", "return 0.9 * correct(perceptual_roughness);"),
        ),
        "reciprocity of sheen": (
            RECIPROCITY,
            Bug(SHEEN, "evaluate_sheen(float", "return correct(alpha, wo, wi) * (1.0 + 0.1 * wo.z);"),
        ),
    },
    quick=("layers gain light",),
)
