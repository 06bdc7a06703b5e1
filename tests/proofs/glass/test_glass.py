"""Glass in closed form: a pane colors the light that passes it, white solids are invisible in an even environment; and
realtime frames of glass and layers against the path tracer."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from support.frames import Effort, measure_paths, path_traced_runs
from support.seeded_bugs import Bug, bug_tests, require

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

COLOR = np.array((0.9, 0.5, 0.2))
PASSES = 0.96  # the share of light that passes a boundary of an index of refraction of 1.5 at normal incidence
CLEAR = {"base_color": 1.0, "perceptual_roughness": 0.0, "transmission": 1.0}
TINTED = {**CLEAR, "attenuation_color": COLOR, "attenuation_distance": 0.5}
NOTHING = np.zeros((1, 1, 4), np.uint8)  # a texture


def mean(device, scene, size, samples, **settings):
    return path_traced_runs(device, scene, size, samples, **settings).mean.mean(axis=(0, 1))


def light_through(device, material, strategy="nee"):
    """The light of a floor seen from just above, with a lamp high above it, and a pane between camera and lamp."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 1), (1, 0, 0)), matte(0.5))
    scene.add(shapes.quad((0, 6, 0), (0.05, 0, 0), (0, 0, 0.05)), lamp(1000.0))
    if material:
        scene.add(shapes.quad((0, 3, 0), (0, 0, 3), (3, 0, 0)), material)
    scene.camera = sv.Camera.look_at((0, 0.5, 0.3), (0, 0, 0), vertical_fov=0.3)
    return mean(device, scene, (8, 8), 128, max_bounces=1, light_strategy=strategy)


@functools.cache
def light_of_free_window(device):
    return light_through(device, None)


@pytest.mark.parametrize(
    ("strategy", "fields", "passes"),
    [
        ("mis", {}, PASSES),
        ("nee", {}, PASSES),
        # Texels of 0 take away the reflections of the pane, and those of its coat.
        ("nee", {"specular_texture": NOTHING}, 1.0),
        ("nee", {"specular_color_texture": NOTHING}, 1.0),
        ("nee", {"clearcoat": 1.0, "clearcoat_texture": NOTHING}, PASSES),
        ("nee", {"solid": True}, 0.0),
    ],
)
def test_shadow_rays(device, strategy, fields, passes):
    """Light samples and rays that meet the lamp count the pane's color once between them; solids stop them."""
    pane = sv.Material(**{**CLEAR, "base_color": COLOR, "double_sided": True, **fields})
    tinted = light_through(device, pane, strategy)
    np.testing.assert_allclose(tinted / light_of_free_window(device), passes * COLOR, rtol=0.01)


def check_block(device, expected, eye, fov, size, samples, **fields):
    """The light of a block of glass in an even environment."""
    scene = sv.Scene(sv.Instance(shapes.box(), sv.Material(**{**CLEAR, **fields})))
    scene.environment = sv.Environment(np.ones((4, 8, 3), np.float32))
    scene.camera = sv.Camera.look_at(eye, (0, 0, 0), vertical_fov=fov)
    np.testing.assert_allclose(mean(device, scene, size, samples, max_bounces=64), expected, rtol=0.015)


@pytest.mark.parametrize(
    "fields", [{"solid": True}, {}, {"solid": True, "perceptual_roughness": 0.5}], ids=["solid", "thin", "rough"]
)
def test_white_glass_is_invisible_in_an_even_environment(device, fields):
    check_block(device, 1.0, (1.2, 1.0, 1.5), 0.6, (8, 8), 256, **fields)


def test_a_solid_absorbs_by_the_law_of_beer_and_lambert(device):
    """Seen straight on through a meter of glass that hardly bends or reflects light."""
    check_block(device, COLOR**2, (0, 0, 30), 0.005, (4, 4), 64, **TINTED, ior=1.0001, solid=True)


@pytest.mark.parametrize("rotation", [0.0, np.pi / 2])
def test_anisotropy_of_metal(device, rotation):
    """A floor seen from above, whose u runs along z, under a sun at 40 degrees in the plane of u, then in that of v."""
    fields = {"metallic": 1.0, "perceptual_roughness": 0.4, "anisotropy": 1.0, "anisotropy_rotation": rotation}
    floor = sv.Instance(shapes.quad((0, 0, 0), (0, 0, 2), (2, 0, 0)), sv.Material(base_color=0.9, **fields))
    sine, cosine = np.sin(np.radians(40)), np.cos(np.radians(40))
    camera = sv.Camera.look_at((0, 3, 0.001), (0, 0, 0), up=(0, 0, -1), vertical_fov=0.05)
    light = []
    for toward in ((0, -cosine, -sine), (-sine, -cosine, 0)):
        scene = sv.Scene(floor, sv.DirectionalLight(toward, illuminance=10.0), camera)
        light.append(mean(device, scene, (4, 4), 16).mean())
    along, across = light if rotation == 0 else reversed(light)
    assert along > 10 * across > 0


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a solid absorbs nothing": (
            test_a_solid_absorbs_by_the_law_of_beer_and_lambert,
            Bug("scene/medium.glsl", "transmittance", "return vec3(1.0);"),
        ),
        "a pane doesn't color light": (
            lambda device: test_shadow_rays(device, "nee", {}, PASSES),
            Bug(
                "scene/alpha.glsl",
                "attenuate_by_surface(inout RayTransmittance through, vec4",
                "through.probability *= 1.0 - filter_opacity.w;",
            ),
        ),
        "the tangent is turned": (
            lambda device: test_anisotropy_of_metal(device, 0.0),
            Bug(
                "scene/base_material.glsl",
                "orient_anisotropy",
                "correct(base, frame, mat3(tangent_frame[1], tangent_frame[0], tangent_frame[2]));",
            ),
        ),
    }
)


# ---- realtime frames --------------------------------------------------------------------------------

METAL = {"base_color": (0.9, 0.8, 0.6), "metallic": 1.0, "perceptual_roughness": 0.4}
BALLS = {
    "solids": [{**TINTED, "solid": True}, {**TINTED, "solid": True, "perceptual_roughness": 0.5}],
    "thin walls": [{**CLEAR, "base_color": COLOR}, {**CLEAR, "base_color": COLOR, "perceptual_roughness": 0.5}],
    "layers": [
        {"base_color": (0.6, 0.1, 0.1), "clearcoat": 1.0, "clearcoat_roughness": 0.4},
        {"base_color": (0.1, 0.1, 0.3), "sheen_color": (0.7, 0.7, 1.0), "sheen_roughness": 0.4},
        {**METAL, "anisotropy": 0.7, "anisotropy_rotation": 0.5},
    ],
}


def balls(*materials):
    """Balls on a gray floor, seen from above, in an environment that is brighter on one side and at the top."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), matte(0.5))
    for i, fields in enumerate(materials):
        at = (1.1 * (i - (len(materials) - 1) / 2), 0.55, 0)
        scene.add(shapes.sphere(0.5, 32), sv.Material(**fields), place(at=at))
    row, column = np.mgrid[:8, :16]
    light = (1 + 0.5 * np.cos(row / 8 * np.pi)) * (1 + 0.5 * np.cos(column / 16 * 2 * np.pi))
    scene.environment = sv.Environment(np.repeat(light[..., None], 3, axis=2).astype(np.float32))
    scene.camera = sv.Camera.look_at((0, 3.0, 1.6), (0, 0.4, 0), vertical_fov=0.75)
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("name", BALLS)
def test_frames_have_the_path_tracers_mean(device, name):
    run = Effort(16, 0, 64), 0.01
    require(measure_paths(device, balls(*BALLS[name]), 8192, {"one": run, "several": run}))
