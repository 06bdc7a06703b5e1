"""The shown picture and the debug views: host and device agree on colours, and looking at a view changes no frame."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.output.tone_mapping import TONEMAPS, encode_picture
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.scene.constants import NO_INDEX

SIZE = 40, 24
METAL = sv.Material(base_color=(0.9, 0.7, 0.4), metallic=1.0, perceptual_roughness=0.2)


def make_scene() -> sv.Scene:
    """A Cornell box in which no view is of one colour: two lamps, a metal, something that emits a little."""
    scene = sv.builtin("cornell_box")
    by_name = {instance.name: instance for instance in scene.instances}
    by_name["short block"].material = METAL
    by_name["tall block"].material = sv.Material(base_color=(0.2, 0.3, 0.9), emissive=(0.1, 0.3, 0.2))
    return scene


def make_settings() -> sv.Settings:
    return sv.Settings(world_cache_lod_distance=0.5)  # so that cells of several sizes are in view


def cameras(scene: sv.Scene, count: int) -> list[sv.Camera]:
    """A camera that walks, so that things move."""
    steps = [scene.camera.transform.copy() for _ in range(count)]
    for index, transform in enumerate(steps):
        transform[0, 3] += 0.02 * index
    return [sv.Camera(transform=t, vertical_fov=scene.camera.vertical_fov, ev100=scene.camera.ev100) for t in steps]


@pytest.fixture(scope="module")
def frames(device):
    """frames(view, tonemap) -> the renderer, after one more frame that shows the view."""
    scene = make_scene()
    path = iter(cameras(scene, 200))
    with sv.Renderer(device, scene, SIZE, make_settings()) as renderer:
        for _ in range(4):
            renderer.render(next(path))

        def show(view, tonemap="agx"):
            renderer.view, renderer.tonemap = view, tonemap
            renderer.render(next(path))
            return renderer

        yield show


def shown(radiance, curve="agx"):
    exposure = 1 / (1.2 * 2 ** make_scene().camera.ev100)
    return encode_picture(radiance, exposure=exposure, curve=curve).astype(float)


@pytest.mark.parametrize("curve", TONEMAPS)
def test_the_display_is_the_picture_that_the_host_makes(frames, curve):
    renderer = frames("picture", curve)
    codes = renderer["display"]
    assert codes.shape == (SIZE[1], SIZE[0], 4)
    assert codes.dtype == np.uint8
    assert (codes[..., 3] == 255).all()
    assert codes[..., :3].std() > 20
    assert np.abs(codes[..., :3] - shown(renderer["radiance"], curve)).max() <= 1


PARTS = {
    "di": ["di_diffuse", "di_specular"], "gi": ["gi_diffuse"], "specular": ["specular_gi"], "emission": ["emission"],
    "diffuse_radiance": ["diffuse_radiance"], "specular_radiance": ["specular_radiance"],
}  # fmt: skip


@pytest.mark.parametrize("view", PARTS)
def test_views_of_light_are_the_buffers(frames, view):
    renderer = frames(view)
    radiance = sum(renderer[name] for name in PARTS[view])
    assert radiance.max() > 0
    assert np.abs(renderer["display"][..., :3] - shown(radiance)).max() <= 1


@pytest.mark.parametrize("view", DEBUG_VIEWS)
def test_every_view_shows_something(frames, view):
    renderer = frames(view)
    assert renderer.view == view
    assert len(np.unique(renderer["display"].reshape(-1, 4), axis=0)) > 1


def test_views_of_surfaces_are_the_buffers(frames):
    renderer = frames("metallic")
    assert 5 < (renderer["display"][..., 0] == 255).sum() < SIZE[0] * SIZE[1] / 4
    renderer = frames("roughness")
    assert round(255 * METAL.perceptual_roughness) in renderer["display"][..., 0]
    renderer = frames("guide_roughness")
    expected = 255 * renderer["guides_normal_roughness"][..., 3]
    assert np.abs(renderer["display"][..., 0] - expected).max() <= 1
    renderer = frames("guide_normal")
    there = renderer["gbuffer_depth"][..., 0] > 0
    expected = 255 * (0.5 + 0.5 * renderer["guides_normal_roughness"][..., :3])
    assert np.abs(renderer["display"][..., :3] - expected)[there].max() <= 1


def test_views_of_reservoirs_are_the_buffers(frames):
    renderer = frames("di_neighbor")
    red, green = renderer["display"][..., 0], renderer["display"][..., 1]
    there = renderer["gbuffer_depth"][..., 0] > 0
    np.testing.assert_array_equal(red > green, there & (renderer["di_outcomes"][..., 0] == NO_INDEX))
    renderer = frames("di_visibility")
    there = renderer["gbuffer_depth"][..., 0] > 0
    chosen = renderer["di_reservoirs"]["light_sample"]["light_index"] != NO_INDEX
    seen = there & chosen & (renderer["di_outcomes"][..., 1] != 0)
    assert 0 < seen.sum() < there.sum()
    np.testing.assert_array_equal(renderer["display"][..., 0] == 255, seen)


def test_views_only_read(frames):
    rows = {row.name: row for row in frames("cache_cells")._frame.describe()}
    assert rows["display/debug_view"].writes == ("display",)
    assert "world_cache_checksums" in rows["display/debug_view"].reads


def test_looking_changes_nothing(device):
    """A run that shows another view in each frame is the run that shows none."""
    runs = []
    for views in (list(DEBUG_VIEWS), ["picture"] * len(DEBUG_VIEWS)):
        scene = make_scene()
        with sv.Renderer(device, scene, SIZE, make_settings()) as renderer:
            for view, camera in zip(views, cameras(scene, len(views)), strict=True):
                renderer.view = view
                renderer.render(camera)
            runs.append((renderer["radiance"], renderer["world_cache/active_cells"]))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1] > 100


def test_names_it_refuses(frames):
    renderer = frames("picture")
    with pytest.raises(sv.SolariError, match=r"smell.*base_color"):
        renderer.view = "smell"
    with pytest.raises(sv.SolariError, match=r"fog.*reinhard"):
        renderer.tonemap = "fog"
    assert (renderer.view, renderer.tonemap) == ("picture", "agx")
