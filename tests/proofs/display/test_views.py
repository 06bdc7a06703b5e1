"""Debug views: each shows its buffer in the right colors, and showing one changes no later frame."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.encodings import encode_srgb
from support.frames import add_up, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.output import tone_mapping
from solari_vk.passes.debug_views import DEBUG_VIEWS, views_of
from solari_vk.scene.builtin import cornell_box, place

SIZE = (32, 24)
LIGHTINGS = ("paths", pytest.param("split", marks=pytest.mark.slow))
# Views of light and the results that they show, by lighting.
OF_BOTH = ("paths_diffuse", "paths_specular", "emission", "diffuse_radiance", "specular_radiance")
LIGHT = {lighting: {name: (name,) for name in OF_BOTH} for lighting in ("paths", "split")}
LIGHT["split"] |= {"di": ("di_diffuse", "di_specular"), "gi": ("gi_diffuse",), "specular": ("specular_gi",)}
SURFACE = {
    "metallic": lambda frame: frame["gbuffer"][..., 2:3] >> 8 & 255,
    "roughness": lambda frame: 255 * frame["guides_normal_roughness"][..., 3:],
    "shading_normal": lambda frame: 127.5 + 127.5 * frame["guides_normal_roughness"][..., :3],
    "motion": lambda frame: 127.5 - 255 / 16 * frame["motion_vectors"] * SIZE,
    "guide_roughness": lambda frame: 255 * frame["guides_normal_roughness"][..., 3:],
    "guide_normal": lambda frame: 127.5 + 127.5 * frame["guides_normal_roughness"][..., :3],
    "guide_diffuse_albedo": lambda frame: encode_srgb(frame["guides_diffuse_albedo"][..., :3] / 255),
    "guide_specular_albedo": lambda frame: encode_srgb(frame["guides_specular_albedo"][..., :3] / 255),
    "guide_specular_motion": lambda frame: 127.5 - 255 / 16 * frame["guides_specular_motion"] * SIZE,
}
# Views of numbers, and whether a pixel without a number is black.
NUMBERS = {
    "depth": False,
    "guide_depth": False,
    "cache_lod": False,
    "cache_samples": True,
    "cache_life": True,
    "paths_distance": True,
    "denoise_frames": False,
    "denoise_noise": False,
    "di_confidence": False,
    "di_weight": True,
    "gi_confidence": False,
    "gi_weight": False,
}
# Five colors of Viridis (van der Walt and Smith 2015).
VIRIDIS = np.array([(68, 1, 84), (58, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])


def room():
    """A Cornell box with more materials and lights, so that every view should show several colors."""
    scene = cornell_box()
    blocks = {instance.name: instance for instance in scene.instances}
    blocks["short block"].material = sv.Material(base_color=(0.9, 0.7, 0.4), metallic=1.0, perceptual_roughness=0.2)
    blocks["tall block"].material = sv.Material(base_color=(0.2, 0.3, 0.9), emissive=(0.1, 0.3, 0.2))
    return scene


def camera_at(scene, index):
    """Cameras along a path, so that motion vectors aren't zero."""
    transform = place(at=(0.2 * np.sin(index), 0, 0.5)) @ scene.camera.transform
    return sv.Camera(transform=transform, vertical_fov=scene.camera.vertical_fov, ev100=scene.camera.ev100)


def make(device, scene, lighting, **settings):
    small_cells = {"world_cache_lod_distance": 0.5}  # makes cells of several sizes visible
    return make_renderer(device, scene, SIZE, lighting=lighting, denoise=True, **small_cells, **settings)


def not_viridis(codes):
    """Whether codes (N, 3) are far from all colors between neighboring ones of VIRIDIS."""
    share = np.linspace(0, 4, 1025)
    ramp = np.stack([np.interp(share, np.arange(5), channel) for channel in VIRIDIS.T], axis=-1)
    return np.abs(codes[:, None] - ramp).max(axis=-1).min(axis=-1) > 2


def check_views(device, lighting="paths"):
    """Renders each view in a frame of its own, and compares it with its buffers; the camera moves between frames."""
    constant, errors = [], {}
    scene = room()
    with make(device, scene, lighting, jitter=False) as renderer:
        for index, view in enumerate(["picture"] * 4 + list(views_of(lighting))):
            renderer.view, camera = view, camera_at(scene, index)
            frame = renderer.render(camera)
            there = frame["gbuffer_depth"][..., 0] > 0
            codes = frame["display"][..., :3][there].astype(np.float64)
            if len(np.unique(codes, axis=0)) < 2:
                constant.append(view)
            if view in LIGHT[lighting]:
                exposed = (add_up(frame, *LIGHT[lighting][view]) * camera.exposure)[there].astype(np.float32)
                errors[view] = np.abs(codes - encode_srgb(tone_mapping.CURVES["agx"](exposed))).max()
            if view in SURFACE:
                expected = np.clip(SURFACE[view](frame)[there], 0, 255)
                errors[view] = np.abs(codes[:, : expected.shape[-1]] - expected).max()
            if view in NUMBERS:
                none = NUMBERS[view] & (codes == 0).all(axis=-1)
                errors[view] = np.where((not_viridis(codes) & ~none).any(), np.inf, 0)
    assert not constant, "these views show one color"
    assert not {view: error for view, error in errors.items() if error > 1}, "codes of these views are wrong"


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_views_show_their_buffers(device, lighting):
    assert {*LIGHT["paths"], *LIGHT["split"], *SURFACE, *NUMBERS} <= set(DEBUG_VIEWS)
    check_views(device, lighting)


@pytest.mark.slow
def test_views_of_reservoirs_are_the_buffers(device):
    scene = room()
    with make(device, scene, "split") as renderer:
        for index, renderer.view in enumerate(["picture"] * 4 + ["di_neighbor"]):
            renderer.render(camera_at(scene, index))
        red, green = renderer["display"][..., 0], renderer["display"][..., 1]
        there = renderer["gbuffer_depth"][..., 0] > 0
        np.testing.assert_array_equal(red > green, there & (renderer["di_outcomes"][..., 0] == NO_INDEX))
        renderer.view = "di_visibility"
        renderer.render(camera_at(scene, 5))
        there = renderer["gbuffer_depth"][..., 0] > 0
        chosen = renderer["di_reservoirs"]["light_sample"]["light_index"] != NO_INDEX
        seen = there & chosen & (renderer["di_outcomes"][..., 1] != 0)
        assert 0 < seen.sum() < there.sum()
        np.testing.assert_array_equal(renderer["display"][..., 0] == 255, seen)


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_views_change_no_frame(device, lighting):
    """Frames that show another view each have the same radiance as frames of the picture."""
    scene, runs = room(), []
    with make(device, scene, lighting) as renderer:
        for views in (views_of(lighting), ["picture"] * len(views_of(lighting))):
            renderer.reset()
            renderer.frame_count = 0  # which seeds the random numbers
            for index, renderer.view in enumerate(views):
                renderer.render(camera_at(scene, index))
            runs.append((renderer["radiance"], renderer["world_cache/active_cells"]))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1] > 10


def test_names_of_views(device):
    """Unknown ones and those of another lighting are refused; after the lighting has changed to one that lacks the
    view, it is "picture" again."""
    with make_renderer(device, room(), SIZE, passes=("gbuffer/", "display/")) as renderer:
        settings = renderer.settings
        with pytest.raises(sv.SolariError, match=r"smell.*base_color"):
            renderer.view = "smell"
        with pytest.raises(sv.SolariError, match=r"fog.*reinhard"):
            renderer.tonemap = "fog"
        with pytest.raises(sv.SolariError, match="'di_light' needs the setting lighting=split, not paths"):
            renderer.view = "di_light"
        assert (renderer.view, renderer.tonemap) == ("picture", "agx")
        renderer.view = "depth"
        settings.lighting = "split"
        renderer.render()
        assert renderer.view == "depth"
        renderer.view = "di_light"
        settings.lighting = "paths"
        codes = renderer.render()["display"]
        assert renderer.view == "picture"
        assert (codes.shape, codes.dtype) == ((SIZE[1], SIZE[0], 4), np.uint8)
        assert (codes[..., 3] == 255).all()


TONEMAP, VIEWS = "passes/display/tonemap.glsl", "passes/display/debug_views.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        name: (check_views, Bug(*bug))
        for name, bug in {
            "views of one color": (VIEWS, "show_number", "return vec3(0.5);"),
            "views of light": (TONEMAP, "show_radiance", "return correct(1.1 * radiance);"),
            "views of surfaces": (VIEWS, "show_direction", "return 0.5 - 0.5 * direction;"),
            "views of numbers": (VIEWS, "show_share", "return vec3(share, 0.0, 0.0);"),
        }.items()
    }
)
