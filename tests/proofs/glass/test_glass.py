"""Glass in closed form: a pane colors the light that passes it, white solids are invisible in an even environment; and
glass and layers in realtime frames, by both ways to trace, with seeded bugs."""

from __future__ import annotations

import numpy as np
import pytest
from support.measured import hold
from support.paths import Profile, measure_means
from support.realtime import Effort, make_renderer
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

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


BUGS = {
    "a solid absorbs nothing": (test_a_solid_absorbs_by_the_law_of_beer_and_lambert, Bug(
        "scene/walk.glsl", "transmittance", "return vec3(1.0);")),
    "a pane doesn't color light": (lambda picture: test_a_thin_pane_colors_shadow_rays(picture, "nee"), Bug(
        "scene/alpha.glsl", "attenuate_by_cover(inout RayTransmittance through, vec4",
        "through.probability *= 1.0 - cover.w;")),
    "the tangent is turned": (lambda picture: test_metal_spreads_light_along_its_anisotropy(picture, 0.0), Bug(
        "scene/material_lobes.glsl", "orient_lobes",
        "correct(lobes, shading_normal, coat_normal, mat3(tangent_frame[1], tangent_frame[0], tangent_frame[2]));")),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", BUGS)
def test_a_bug_is_noticed(picture, name):
    proof, bug = BUGS[name]
    with seeded(bug), pytest.raises(AssertionError):
        proof(picture)


def balls(*materials):
    """Balls on a gray floor, seen from above, in an environment that is brighter on one side and at the top."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), matte(0.5))
    for i, material in enumerate(materials):
        scene.add(shapes.sphere(0.5, 32), material, place(at=(1.1 * (i - (len(materials) - 1) / 2), 0.55, 0)))
    row, column = np.mgrid[:8, :16]
    light = (1 + 0.5 * np.cos(row / 8 * np.pi)) * (1 + 0.5 * np.cos(column / 16 * 2 * np.pi))
    scene.environment = sv.Environment(np.repeat(light[..., None], 3, axis=2).astype(np.float32))
    scene.camera = sv.Camera.look_at((0, 3.0, 1.6), (0, 0.4, 0), vertical_fov=0.75)
    return scene


GLASS = {"base_color": 1.0, "transmission": 1.0, "perceptual_roughness": 0.0}
TINTED = {"attenuation_color": COLOR, "attenuation_distance": 0.5}
METAL = {"base_color": (0.9, 0.8, 0.6), "metallic": 1.0, "perceptual_roughness": 0.4}
PICTURES = {
    "solids": lambda: balls(
        sv.Material(**GLASS, **TINTED, solid=True),
        sv.Material(**{**GLASS, "perceptual_roughness": 0.5}, **TINTED, solid=True),
    ),
    "thin walls": lambda: balls(
        sv.Material(**{**GLASS, "base_color": COLOR}),
        sv.Material(**{**GLASS, "base_color": COLOR, "perceptual_roughness": 0.5}),
    ),
    "layers": lambda: balls(
        sv.Material(base_color=(0.6, 0.1, 0.1), clearcoat=1.0, clearcoat_roughness=0.4),
        sv.Material(base_color=(0.1, 0.1, 0.3), sheen_color=(0.7, 0.7, 1.0), sheen_roughness=0.4),
        sv.Material(**METAL, anisotropy=0.7, anisotropy_rotation=0.5),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_frames_have_the_path_tracers_mean(device, name):
    profile = Profile(Effort(16, 0, 64, 8192), Effort(), (0.01, 0.0))
    hold(measure_means(device, profile, PICTURES[name](), kinds=("one", "several")))


@pytest.mark.parametrize("frames", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_queries_and_pipelines_are_equal(frames):
    """A pane before a solid that absorbs: the path tracer's picture, and some realtime frames."""
    scene = balls(sv.Material(**GLASS, **TINTED, solid=True))
    pane = sv.Material(**{**GLASS, "base_color": COLOR}, double_sided=True)
    scene.add(shapes.quad((0, 1.3, 0.3), (0, 0, 0.6), (0.6, 0, 0)), pane)
    taken = []
    for way in ("query", "pipeline"):
        with sv.Device(validation=True, rays=way) as device:
            with sv.PathTracer(device, scene, (16, 16), seed=5) as tracer:
                taken.append([tracer.render(scene.camera, 4)["radiance"].copy()])
            if frames:
                with make_renderer(device, scene, (16, 16), seed=5) as renderer:
                    taken[-1] += [renderer.render(scene.camera)["radiance"].copy() for _ in range(frames)]
    for query, pipeline in zip(*taken, strict=True):
        assert query.any()
        assert query.tobytes() == pipeline.tobytes()
