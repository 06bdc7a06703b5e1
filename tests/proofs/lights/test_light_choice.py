"""Which lights and triangles light samples take, and that a ray which hits a light finds the density of its sample."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from support.frames import bound_scene
from support.seeded_bugs import Bug, bug_tests, with_shaders

import solari_vk as sv
from solari_vk.bound.lights.emissive_meshes import MIN_LUMINANCE
from solari_vk.bound.lights.light_leaves import EQUAL_SHARE
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

COUNT = 400_000
SIDE = 12


def triangle_grid(side):
    """A square of 2 side^2 triangles over [-1, 1]^2 at height 1, facing down."""
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    corners = np.stack([first, first + 1, first + side + 1, first + 1, first + side + 2, first + side + 1], axis=1)
    positions = np.stack([x, np.ones_like(x), z], axis=-1).reshape(-1, 3)
    return sv.Mesh(positions, corners.reshape(-1, 3), uvs=0.5 + 0.5 * positions[:, ::2])


def make_world():
    """A lamp whose texture is black but for one bright and a few dim spots, other lamps, dark ones, and suns."""
    pixels = np.zeros((SIDE, SIDE, 3), np.uint8)
    pixels[2, 3] = (255, 255, 255)
    pixels[7, 5] = (80, 0, 0)
    pixels[7, 6] = (0, 0, 80)
    pixels[9] = (9, 9, 9)
    grid = triangle_grid(SIDE)
    ceiling = sv.Mesh(grid.positions * (0.5, 0, 0.5), grid.triangles, uvs=grid.uvs)
    texture = sv.Texture(pixels, magnification="nearest")
    soup = sv.Mesh(np.random.default_rng(1).normal(size=(21, 3)))
    shear = np.array([[2, 0.5, 0, 0.3], [0, 1, 0, 2], [0, 0.7, 3, 0.1]])
    mirror = np.array([[-1, 0, 0, 2.5], [0, 1, 0, 1.5], [0, 0, 1, 0]])
    black = np.zeros((1, 1), np.uint8)
    return sv.Scene(
        sv.Instance(ceiling, sv.Material(emissive=(5.0, 4.0, 3.0), emissive_texture=texture), transform=(0, 0.5, 0)),
        sv.Instance(soup, sv.Material(emissive=(0.0, 0.2, 0.0), double_sided=True), transform=shear),
        sv.Instance(soup, sv.Material(emissive=(0.0, 0.0, 1.0)), transform=mirror),
        sv.Instance(shapes.facing_quad((0.0, 3.0, 1.0), 0.4), sv.Material(emissive=(1.0, 1.0, 1.0))),
        sv.Instance(soup, sv.Material(emissive=(1.0, 1.0, 1.0), emissive_texture=black), transform=(9, 9, 9)),
        sv.DirectionalLight(direction=(0, -1, 0), illuminance=2.0),
        sv.DirectionalLight(direction=(0, -1, 0), illuminance=0.0),
    )


def test_a_sun_counts_for_all_that_it_lights(device):
    """Also where the scene is one mesh, whose center alone has no area."""
    ground = shapes.quad((0, 0, 0), (500, 0, 0), (0, 0, -500))
    scene = sv.Scene(sv.Instance(ground), sv.DirectionalLight((0, -1, 0), illuminance=10.0), sv.PointLight((0, 2, 0)))
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        tracer.render(samples=1)
        lamp_power, sun_power = sorted(tracer.binder.lights.powers)
    assert lamp_power < 1e6 < sun_power / 10 < 2e6, "1 km^2 and more"


def draw(shaders, world):
    """The samples, by power and by the tree (2, N), and the lights' powers."""
    with bound_scene(shaders.device, world) as binder:
        # The path tracer alone has strata.
        constants = dict.fromkeys(binder.features - {"SCENE_LIGHT_STRATA"}, True)
        drawn = shaders.run(
            "test/light_choice", 2 * COUNT, binder.resources, {"drawn": 2 * COUNT}, constants=constants
        )["drawn"]
        return drawn.reshape(2, COUNT), binder.lights.powers


def part_shares(world):
    """The probabilities of each light's parts, in the order of upload."""
    for instance in world:
        corners = instance.mesh.positions[instance.mesh.triangles]
        order = spatial_order(corners.min(axis=1), corners.max(axis=1))
        corners = corners.astype(np.float64)
        weights = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        texture = instance.material.emissive_texture
        if texture is not None and texture.image.pixels[..., :3].any():
            x, y = (instance.mesh.uvs[instance.mesh.triangles].mean(axis=1) * SIDE).astype(int).T
            light = LINEAR_OF_SRGB[texture.image.pixels[y, x, :3]] @ [0.2126, 0.7152, 0.0722]
            weights *= np.maximum(light, MIN_LUMINANCE * light.mean())
        yield (weights / weights.sum())[order]
    for _ in world.lights:
        yield np.ones(1)


def test_lights_and_triangles_are_chosen_by_their_light(shaders):
    world = make_world()
    (drawn, _), powers = draw(shaders, world)
    lit = powers > 0
    chances = (1 - EQUAL_SHARE) * powers / powers.sum() + EQUAL_SHARE * lit / lit.sum()
    assert np.isin(drawn["light_index"], np.flatnonzero(lit)).all(), "dark lights are never taken"
    shares = [chance * share for chance, share in zip(chances, part_shares(world), strict=True)]
    first = np.cumsum([0, *(len(share) for share in shares)])
    expected = np.concatenate(shares)
    place = first[drawn["light_index"]] + drawn["part"]
    np.testing.assert_allclose(drawn["probability"], expected[place], rtol=5e-4)
    observed = np.bincount(place, minlength=len(expected))
    assert stats.chisquare(observed[expected > 0], COUNT * expected[expected > 0]).pvalue > 1e-3


def test_the_density_at_a_hit_is_that_of_the_sample(shaders):
    for drawn in draw(shaders, make_world())[0]:
        hit = drawn["hit_pdf"] >= 0
        for light in range(4):
            mine = hit & (drawn["light_index"] == light)
            assert mine.sum() > 1000, "the receivers see the light"
            ratio = drawn["hit_pdf"][mine].astype(np.float64) / drawn["sample_pdf"][mine]
            assert np.median(np.abs(ratio - 1)) < 1e-5
            assert np.quantile(np.abs(ratio - 1), 0.99) < 1e-2, "grazing rays lose digits"


# ---- there is no limit of 65,536, neither for lights nor for the triangles of a light ----------------


def light_under(device, *lamps):
    """The mean radiance of a floor, rendered with light samples only, and its standard error."""
    scene = sv.Scene(sv.Camera.look_at((0, 0.9, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=math.radians(60)), *lamps)
    scene.add(shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), matte(0.5))
    with sv.PathTracer(device, scene, (32, 32), max_bounces=1, lambert=True, light_strategy="nee") as tracer:
        radiance = tracer.render(samples=64)["radiance"]
        return float(radiance[..., 1].mean()), math.sqrt(tracer["variance"].mean() / radiance[..., 0].size)


def many_triangles():
    return [sv.Instance(triangle_grid(300), lamp(3.0))]


def many_lights():
    """Seventy thousand instances, each a light. A limit on indices would lose the last ones."""
    half = 1 / 265
    mesh, material = shapes.quad((0, 0, 0), (half, 0, 0), (0, 0, half)), lamp(3.0)
    at = np.linspace(half - 1, 1 - half, 265)
    return [sv.Instance(mesh, material, (x, 1.0, z)) for x in at for z in at]


@pytest.mark.parametrize("make", [many_triangles, pytest.param(many_lights, marks=pytest.mark.slow)])
def test_many_parts_of_a_square_light_a_floor_like_two(device, make):
    expected, least = light_under(device, sv.Instance(triangle_grid(1), lamp(3.0)))
    value, error = light_under(device, *make())
    assert abs(value - expected) < 4 * math.hypot(error, least)
    assert math.hypot(error, least) < 0.005 * value


def test_a_bright_spot_of_a_dark_lamp(device):
    """A lamp of 20,000 triangles of which 1 % is lit: light samples that took all triangles equally often would have a
    relative variance of 99, those that take the dark part for a tenth of the light have one of 0.1."""
    pixels = np.zeros((10, 10, 3), np.uint8)
    pixels[2, 6] = 255
    material = lamp(300.0)
    material.emissive_texture = sv.Texture(sv.TextureImage(pixels), magnification="nearest")
    value, error = light_under(device, sv.Instance(triangle_grid(100), material))
    truth, least = light_under(device, sv.Instance(shapes.quad((0.3, 1, -0.5), (0.1, 0, 0), (0, 0, 0.1)), lamp(300.0)))
    assert abs(value - truth) < 4 * math.hypot(error, least)
    assert 32 * 32 * 64 * (error / value) ** 2 < 0.2


CHOICE = "scene/lights/choice.glsl"
CHOSEN = with_shaders(test_lights_and_triangles_are_chosen_by_their_light)
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "aliases": (CHOSEN, Bug(CHOICE, "choose", "return row;")),
        "probabilities": (
            CHOSEN,
            Bug(CHOICE, "choice_probability_by_power", "return part_of_leaf(light, part).probability;"),
        ),
        "equal parts": (CHOSEN, Bug(CHOICE, "has_equal_parts", "return true;")),
        "leaves": (
            with_shaders(test_the_density_at_a_hit_is_that_of_the_sample),
            Bug(CHOICE, "part_of_leaf", "PartOfLeaf found = correct(light, part); found.leaf ^= 1u; return found;"),
        ),
        "densities at hits": (
            with_shaders(test_the_density_at_a_hit_is_that_of_the_sample),
            Bug(
                "scene/surface.glsl",
                "resolve_surface_interaction(Hit hit, Mesh",
                """
        SurfaceInteraction surface = correct(hit, mesh, ray_direction, cone_width);
        surface.area_pdf_by_power *= 1.01;
        return surface;""",
            ),
        ),
    },
    quick=("aliases",),
)
