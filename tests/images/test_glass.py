"""Glass in closed form: a pane colors the light that passes it, white solids are invisible in an even environment."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte

COLOR = np.array((0.9, 0.5, 0.2))
SHARE = 0.96  # of light that passes a boundary of an index of refraction of 1.5 at normal incidence


def window(pane, **glass):
    """A floor seen from just above, a lamp high above it, and between camera and lamp a pane, if there is one."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 1), (1, 0, 0)), matte(0.5))
    scene.add(shapes.quad((0, 6, 0), (0.05, 0, 0), (0, 0, 0.05)), lamp(1000.0))
    if pane:
        material = sv.Material(base_color=COLOR, perceptual_roughness=0.0, transmission=1.0, double_sided=True, **glass)
        scene.add(shapes.quad((0, 3, 0), (0, 0, 3), (3, 0, 0)), material)
    scene.camera = sv.Camera.look_at((0, 0.5, 0.3), (0, 0, 0), vertical_fov=0.3)
    return scene


@pytest.mark.parametrize("strategy", ["mis", "nee"])
def test_a_thin_pane_colors_shadow_rays(picture, strategy):
    """Light samples and rays that meet the lamp count the pane's color once between them."""
    settings = {"max_bounces": 1, "light_strategy": strategy}
    free = picture(window(False), (8, 8), 128, **settings).mean.mean(axis=(0, 1))
    tinted = picture(window(True), (8, 8), 128, **settings).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(tinted / free, SHARE * COLOR, rtol=0.01)


@pytest.mark.parametrize(
    ("slot", "fields"),
    [("specular_texture", {}), ("specular_color_texture", {}), ("clearcoat_texture", {"clearcoat": 1.0})],
)
def test_textures_of_a_thin_pane_count_in_shadow_rays(picture, slot, fields):
    """Texels of 0 take away the reflections of the pane, and those of its coat."""
    settings = {"max_bounces": 1, "light_strategy": "nee"}
    free = picture(window(False), (8, 8), 128, **settings).mean.mean(axis=(0, 1))
    nothing = np.zeros((1, 1, 4), np.uint8)
    tinted = picture(window(True, **fields, **{slot: nothing}), (8, 8), 128, **settings).mean.mean(axis=(0, 1))
    reflected = SHARE if slot == "clearcoat_texture" else 1.0
    np.testing.assert_allclose(tinted / free, reflected * COLOR, rtol=0.01)


def test_solids_cast_shadows(picture):
    dark = picture(window(True, solid=True), (8, 8), 32, max_bounces=1, light_strategy="nee")
    assert dark.mean.max() == 0


@pytest.mark.parametrize("fields", [{"solid": True}, {}, {"solid": True, "perceptual_roughness": 0.5}],
                         ids=["solid", "thin", "rough"])  # fmt: skip
def test_white_glass_is_invisible_in_an_even_environment(picture, fields):
    scene = sv.Scene()
    glass = {"base_color": 1.0, "perceptual_roughness": 0.0, "transmission": 1.0, **fields}
    scene.add(shapes.box(), sv.Material(**glass))
    scene.environment = sv.Environment(np.ones((4, 8, 3), np.float32))
    scene.camera = sv.Camera.look_at((1.2, 1.0, 1.5), (0, 0, 0), vertical_fov=0.6)
    seen = picture(scene, (8, 8), 256, max_bounces=64).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(seen, 1, rtol=0.015)


def test_a_solid_absorbs_by_the_law_of_beer_and_lambert(picture):
    """Seen straight on through a meter of glass that hardly bends or reflects light."""
    scene = sv.Scene()
    glass = {"base_color": 1.0, "perceptual_roughness": 0.0, "transmission": 1.0, "ior": 1.0001, "solid": True}
    scene.add(shapes.box(), sv.Material(**glass, attenuation_color=COLOR, attenuation_distance=0.5))
    scene.environment = sv.Environment(np.ones((4, 8, 3), np.float32))
    scene.camera = sv.Camera.look_at((0, 0, 30), (0, 0, 0), vertical_fov=0.005)
    seen = picture(scene, (4, 4), 64, max_bounces=8).mean.mean(axis=(0, 1))
    np.testing.assert_allclose(seen, COLOR**2, rtol=0.01)


@pytest.mark.parametrize("rotation", [0.0, np.pi / 2])
def test_metal_spreads_light_along_its_anisotropy(picture, rotation):
    """A floor seen from above, whose u runs along z, under a sun at 40 degrees in the plane of u, then in that of v."""
    fields = {"metallic": 1.0, "perceptual_roughness": 0.4, "anisotropy": 1.0, "anisotropy_rotation": rotation}
    metal = sv.Material(base_color=0.9, **fields)
    light = []
    for x, z in ((0.0, 1.0), (1.0, 0.0)):
        scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (0, 0, 2), (2, 0, 0)), metal))
        sine, cosine = np.sin(np.radians(40)), np.cos(np.radians(40))
        scene.add(sv.DirectionalLight((-sine * x, -cosine, -sine * z), illuminance=10.0))
        scene.camera = sv.Camera.look_at((0, 3, 0.001), (0, 0, 0), up=(0, 0, -1), vertical_fov=0.05)
        light.append(picture(scene, (4, 4), 16).mean.mean())
    along, across = light if rotation == 0 else reversed(light)
    assert along > 10 * across > 0
