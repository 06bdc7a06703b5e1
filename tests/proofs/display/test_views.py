"""The debug views whose colors the conformance suite doesn't check; and showing a view changes no later frame.

test_display proves the colors of the picture and of all other views.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_display import room

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.passes.debug_views import views_of
from solari_vk.passes.lighting import debug_view_pass
from solari_vk.scene.builtin import place

SIZE = 40, 24
SETTINGS = {"world_cache_lod_distance": 0.5}  # makes cells of several sizes visible
LIGHTINGS = ("paths", "split")


def cameras(scene, count):
    """Cameras along a straight path, so that motion vectors aren't zero."""
    for index in range(count):
        transform = place(at=(0.02 * index, 0, 0)) @ scene.camera.transform
        yield sv.Camera(transform=transform, vertical_fov=scene.camera.vertical_fov, ev100=scene.camera.ev100)


@pytest.fixture(scope="module", params=LIGHTINGS)
def frames(device, request):
    """frames(view) renders one more frame with that view, and returns the renderer; of each lighting."""
    scene = room()
    path = cameras(scene, 200)
    with sv.Renderer(device, scene, SIZE, sv.Settings(**SETTINGS, lighting=request.param)) as renderer:
        for _ in range(4):
            renderer.render(next(path))

        def show(view):
            renderer.view = view
            renderer.render(next(path))
            return renderer

        yield show


def test_the_display_is_opaque_and_has_the_size_of_the_picture(frames):
    codes = frames("picture")["display"]
    assert codes.shape == (SIZE[1], SIZE[0], 4)
    assert codes.dtype == np.uint8
    assert (codes[..., 3] == 255).all()


def test_views_of_the_material_show_the_metal(frames):
    metal = frames("metallic")["display"][..., 0] == 255
    assert 5 < metal.sum() < metal.size / 4
    assert round(255 * 0.2) in frames("roughness")["display"][..., 0]


@pytest.mark.parametrize("frames", ["split"], indirect=True)
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


def test_the_debug_view_writes_only_the_display(frames):
    renderer = frames("cache_cells")
    rows = {row.name: row for row in renderer._frame.describe()}
    row = rows[debug_view_pass(renderer.settings.lighting)]
    assert row.writes == ("display",)
    assert "world_cache_checksums" in row.reads


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_views_change_no_frame(device, lighting):
    """A run that shows another view in each frame has the same radiance as a run that shows none."""
    runs = []
    for views in (views_of(lighting), ["picture"] * len(views_of(lighting))):
        scene = room()
        with sv.Renderer(device, scene, SIZE, sv.Settings(**SETTINGS, lighting=lighting)) as renderer:
            for view, camera in zip(views, cameras(scene, len(views)), strict=True):
                renderer.view = view
                renderer.render(camera)
            runs.append((renderer["radiance"], renderer["world_cache/active_cells"]))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1] > 10


def test_unknown_names_are_refused(frames):
    renderer = frames("picture")
    with pytest.raises(sv.SolariError, match=r"smell.*base_color"):
        renderer.view = "smell"
    with pytest.raises(sv.SolariError, match=r"fog.*reinhard"):
        renderer.tonemap = "fog"
    assert (renderer.view, renderer.tonemap) == ("picture", "agx")


def test_views_of_the_other_lighting_are_refused(device):
    """A view is "picture" again after the lighting has changed to one that lacks it."""
    scene, settings = room(), sv.Settings()
    with sv.Renderer(device, scene, SIZE, settings) as renderer:
        with pytest.raises(sv.SolariError, match="'di_light' needs the setting lighting=split, not paths"):
            renderer.view = "di_light"
        renderer.view = "paths_distance"
        settings.lighting = "split"
        for view in ("di_light", "depth"):
            renderer.render()
            assert renderer.view in ("picture", "di_light")
            renderer.view = view
        settings.lighting = "paths"
        renderer.render()
        assert renderer.view == "depth"
