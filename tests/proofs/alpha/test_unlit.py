"""Unlit materials: cameras see exactly their base colors, in mirrors too, and they light nothing."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import LIGHT_OFF, make_renderer, path_traced
from support.seeded_bugs import Bug, bug_tests
from test_alpha import CAMERA, SHOWN, SIZE, quad

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.material import UNLIT_RADIANCE

# of the values 0 and 1, since devices decode other sRGB values with an error
PIXELS = 255 * np.array([[[1, 0, 0], [0, 1, 1]], [[1, 0, 1], [1, 1, 1]]], np.uint8)
COLOR = np.array([0.9, 0.5, 0.7], np.float32)
RIGHT = (UNLIT_RADIANCE * COLOR * PIXELS / 255).repeat(4, axis=0).repeat(4, axis=1)[::-1]
CARD, FLOOR = np.s_[10:22, 10:22], np.s_[26:, :]
QUARTERS = np.r_[0:4, 8:12]  # of the card's 12 x 12 pixels: without those at the edges of texels


def card_over_a_floor(*lights):
    """A card of four colors before the camera, over a floor."""
    image = sv.TextureImage(pixels=PIXELS)
    texture = sv.Texture(image=image, magnification="nearest", minification="nearest", mipmaps=False)
    card = sv.Material(  # emission and metallic are to count for nothing
        base_color=COLOR,
        base_color_texture=texture,
        unlit=True,
        emissive=50.0,
        metallic=1.0,
        roughness=0.1,
        double_sided=True,
    )
    floor = shapes.quad((0, -0.6, -1.5), (3, 0, 0), (0, 0, -1.5))
    return sv.Scene(sv.Instance(quad(2.0, 0.5), card), sv.Instance(floor, sv.Material()), *lights)


def traced(device, scene):
    return path_traced(device, scene, 16, SIZE, CAMERA)


def rendered(device, scene, **settings):
    with make_renderer(device, scene, SIZE, **settings) as renderer:
        for _ in range(3):
            frame = renderer.render(CAMERA)["radiance"].copy()
    return frame


def shown(device, scene):
    """Surfaces and visible emission alone."""
    return rendered(device, scene, passes=SHOWN, **LIGHT_OFF)


def denoised(device, scene):
    return rendered(device, scene, denoise=True, gbuffer="traced")


def check_color(device, render=traced):
    """The card's color under a strong light; means round, and frames round it to nine bits."""
    scene = card_over_a_floor(sv.DirectionalLight((0, -1, -1), illuminance=100.0))
    assert not scene.instances[0].material.emits
    if render is traced:  # frames would take minutes to compile
        scene.instances[0].material.update(clearcoat=1.0, transmission=1.0)
    found = render(device, scene)[CARD][QUARTERS][:, QUARTERS]
    error = np.abs(found - RIGHT)
    assert (error <= (1e-5 if render is traced else 2**-9) * RIGHT.max(axis=-1, keepdims=True)).all(), error.max()


def check_darkness(device, render=traced):
    """Without other lights the floor stays black."""
    picture = render(device, card_over_a_floor())
    assert picture[CARD].any()
    assert not picture[FLOOR].any()


def check_mirror(device, render=traced):
    """A mirror shows the card behind the camera, and so does one behind clear glass; rough metal doesn't."""
    card = sv.Instance(quad(-4.0), sv.Material(base_color=COLOR, unlit=True, double_sided=True))
    mirror, rough = (sv.Material(base_color=1.0, metallic=1.0, roughness=roughness) for roughness in (0.0, 0.5))
    found = render(device, sv.Scene(card, sv.Instance(quad(2.0), mirror)))
    assert found == pytest.approx(np.broadcast_to(UNLIT_RADIANCE * COLOR, found.shape), rel=2**-9)
    glass = sv.Instance(quad(1.0), sv.Material(base_color=1.0, transmission=1.0, roughness=0.0))
    found = render(device, sv.Scene(card, glass, sv.Instance(quad(2.0), mirror))).mean(axis=(0, 1))
    assert (found > 0.9 * UNLIT_RADIANCE * COLOR).all()
    assert not render(device, sv.Scene(card, sv.Instance(quad(2.0), rough))).any()
    card.material.double_sided = False
    assert not render(device, sv.Scene(card, sv.Instance(quad(2.0), mirror))).any(), "its back is to the mirror"


def check_grazing(device, render=traced):
    """A dark sheet that is seen along its surface, against the light, doesn't reflect it."""
    sheet = shapes.quad((0, -0.03, -2), (0, 0, 9), (9, 0, 0))
    material = sv.Material(base_color=0.01, unlit=True, roughness=0.3, double_sided=True)
    scene = sv.Scene(sv.Instance(sheet, material), sv.DirectionalLight((0, -0.01, 1), illuminance=100.0))
    scene.environment = sv.Environment(10.0)
    found = render(device, scene)[-SIZE[1] // 4 :]
    assert found == pytest.approx(np.full_like(found, 0.01 * UNLIT_RADIANCE), rel=2**-8)


def split(device, scene):
    return rendered(device, scene, lighting="split", restir=False, world_cache=False, jitter=False)


@pytest.mark.parametrize("render", [traced, *(pytest.param(way, marks=pytest.mark.slow) for way in (rendered, split))])
def test_a_mirror(render, device):
    check_mirror(device, render)


@pytest.mark.parametrize("check", [check_color, check_darkness, check_grazing])
@pytest.mark.parametrize(
    "render",
    [traced, shown, pytest.param(rendered, marks=pytest.mark.slow), pytest.param(denoised, marks=pytest.mark.slow)],
)
def test_unlit(check, render, device):
    check(device, render)


def test_a_card_casts_a_shadow(device):
    light = sv.DirectionalLight((0, -1, 1), illuminance=10.0)
    scene = card_over_a_floor(light)
    shadowed = traced(device, scene)[FLOOR]
    scene.instances[0].visible = False
    assert 0 < shadowed.sum() < 0.9 * traced(device, scene)[FLOOR].sum()


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "other rays see it": (
            check_darkness,
            Bug(
                "scene/surface.glsl",
                "resolve_surface_interaction(Hit hit, Mesh",
                "SurfaceInteraction found = correct(hit, mesh, ray_direction, cone_width); "
                "found.emits_towards_ray = found.emits_towards_ray || found.unlit; return found;",
            ),
        ),
        "rough surfaces reflect it": (
            check_mirror,
            Bug(
                "scene/walk.glsl",
                "scatter",
                "bool shown = walk.delta_path_from_camera; "
                "bool possible = correct(walk, next, frame, geometric_normal, below); "
                "walk.delta_path_from_camera = shown; return possible;",
            ),
        ),
        "it reflects at grazing angles": (
            check_grazing,
            Bug("scene/surface.glsl", "make_unlit", "correct(material); material.base.unlit = false;"),
        ),
        "it is lit": (
            check_color,
            Bug(
                "scene/surface.glsl",
                "make_unlit",
                "vec3 color = material.base.color; correct(material); material.base.color = color;",
            ),
        ),
    }
)
