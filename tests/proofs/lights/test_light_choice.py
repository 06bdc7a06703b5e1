"""Which lights and triangles light samples take, and that a ray which hits a light finds the density of its sample."""

from __future__ import annotations

import numpy as np
from scipy import stats
from support.seeded_bugs import Bug, bug_tests, with_shaders

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.emissive_meshes import MIN_LUMINANCE
from solari_vk.bound.lights.light_list import EQUAL_SHARE
from solari_vk.scene import shapes
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

COUNT = 400_000
SIDE = 12


def ceiling():
    """A lamp of 2 SIDE^2 triangles; its texture is black but for one bright and a few dim spots."""
    pixels = np.zeros((SIDE, SIDE, 3), np.uint8)
    pixels[2, 3], pixels[7, 5], pixels[7, 6], pixels[9] = (255, 255, 255), (80, 0, 0), (0, 0, 80), (9, 9, 9)
    x, z = np.meshgrid(np.arange(SIDE + 1), np.arange(SIDE + 1))
    first = (np.arange(SIDE)[:, None] * (SIDE + 1) + np.arange(SIDE)).ravel()
    corners = np.stack([first, first + 1, first + SIDE + 1, first + 1, first + SIDE + 2, first + SIDE + 1], axis=1)
    grid = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3) / SIDE
    mesh = sv.Mesh(grid - (0.5, 0, 0.5), corners.reshape(-1, 3), uvs=grid[:, ::2])
    return mesh, sv.Texture(pixels, magnification="nearest")


def make_world():
    mesh, texture = ceiling()
    soup = sv.Mesh(np.random.default_rng(1).normal(size=(21, 3)))
    shear = np.array([[2, 0.5, 0, 0.3], [0, 1, 0, 2], [0, 0.7, 3, 0.1]])
    mirror = np.array([[-1, 0, 0, 2.5], [0, 1, 0, 1.5], [0, 0, 1, 0]])
    return sv.Scene(
        sv.Instance(mesh, sv.Material(emissive=(5.0, 4.0, 3.0), emissive_texture=texture), transform=(0, 0.5, 0)),
        sv.Instance(soup, sv.Material(emissive=(0.0, 0.2, 0.0), double_sided=True), transform=shear),
        sv.Instance(soup, sv.Material(emissive=(0.0, 0.0, 1.0)), transform=mirror),
        sv.Instance(shapes.facing_quad((0.0, 3.0, 1.0), 0.4), sv.Material(emissive=(1.0, 1.0, 1.0))),
        sv.Instance(soup, sv.Material(emissive=(1.0, 1.0, 1.0), emissive_texture=np.zeros((1, 1), np.uint8)),
                    transform=(9, 9, 9)),
        sv.DirectionalLight(direction=(0, -1, 0), illuminance=2.0),
        sv.DirectionalLight(direction=(0, -1, 0), illuminance=0.0),
    )  # fmt: skip


def draw(shaders, world):
    """The samples, the lights' powers, and the mesh's triangle of each uploaded triangle for each light."""
    binder = SceneBinder(shaders.device, world)
    try:
        binder.update()
        drawn = shaders.run("test/light_choice", COUNT, binder.resources, {"drawn": COUNT})["drawn"]
        orders = [binder._geometry.orders[instance.mesh] for instance in world]
        return drawn, binder.lights.powers, orders
    finally:
        shaders.device.wait_idle()
        binder.destroy()


def part_shares(world, orders):
    """The probabilities of each light's parts, in the order of upload."""
    for instance, order in zip(world, orders, strict=True):
        corners = instance.mesh.positions[instance.mesh.triangles].astype(np.float64)
        weights = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        texture = instance.material.emissive_texture
        if texture is not None and texture.image.pixels[..., :3].any():
            x, y = (instance.mesh.uvs[instance.mesh.triangles].mean(axis=1) * SIDE).astype(int).T
            light = LINEAR_OF_SRGB[texture.image.pixels[y, x, :3]] @ [0.2126, 0.7152, 0.0722]
            weights *= np.maximum(light, MIN_LUMINANCE * light.mean())
        yield (weights / weights.sum())[order]
    for _ in world.lights:
        yield np.ones(1)


def check_choice(shaders):
    world = make_world()
    drawn, powers, orders = draw(shaders, world)
    lit = powers > 0
    chances = (1 - EQUAL_SHARE) * powers / powers.sum() + EQUAL_SHARE * lit / lit.sum()
    assert np.isin(drawn["light_index"], np.flatnonzero(lit)).all(), "dark lights are never taken"
    shares = [chance * share for chance, share in zip(chances, part_shares(world, orders), strict=True)]
    first = np.cumsum([0, *(len(share) for share in shares)])
    expected = np.concatenate(shares)
    place = first[drawn["light_index"]] + drawn["part"]
    np.testing.assert_allclose(drawn["probability"], expected[place], rtol=5e-4)
    observed = np.bincount(place, minlength=len(expected))
    assert stats.chisquare(observed[expected > 0], COUNT * expected[expected > 0]).pvalue > 1e-3


def check_densities(shaders):
    drawn = draw(shaders, make_world())[0]
    hit = drawn["hit_pdf"] >= 0
    for light in range(4):
        mine = hit & (drawn["light_index"] == light)
        assert mine.sum() > 1000, "the receivers see the light"
        ratio = drawn["hit_pdf"][mine].astype(np.float64) / drawn["sample_pdf"][mine]
        assert np.median(np.abs(ratio - 1)) < 1e-5
        assert np.quantile(np.abs(ratio - 1), 0.99) < 1e-2, "grazing rays lose digits"


def test_lights_and_triangles_are_chosen_by_their_light(shaders):
    check_choice(shaders)


def test_the_density_at_a_hit_is_that_of_the_sample(shaders):
    check_densities(shaders)


CHOICE = "scene/lights/choice.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    "aliases": (with_shaders(check_choice), Bug(CHOICE, "choose", "return row;")),
    "probabilities": (with_shaders(check_choice), Bug(
        CHOICE, "choice_probability", "return part_probability(light, part);")),
    "equal parts": (with_shaders(check_choice), Bug(CHOICE, "has_equal_parts", "return true;")),
    "densities at hits": (with_shaders(check_densities), Bug("scene/surface.glsl", "resolve_hit_full", """
        ResolvedRayHitFull surface = correct(hit, mesh, ray_direction, cone_width);
        surface.light_area_pdf *= 1.01;
        return surface;""")),
}, quick=("aliases",))  # fmt: skip
