"""Antialiasing where nothing is seen: what moves over the background leaves nothing there."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv


@pytest.mark.parametrize("upscale", [1.0, 2.0])
def test_a_camera_that_moves_leaves_no_edges_behind(device, upscale):
    """The background doesn't move with the camera, but what is seen before it does."""
    scene = sv.builtin("cornell_box")
    camera = sv.Camera(transform=scene.camera.transform, vertical_fov=scene.camera.vertical_fov)
    settings = sv.Settings(denoise=True, antialiasing=True, upscale=upscale)
    with sv.Renderer(device, scene, (96, 54), settings) as renderer:
        for step in range(10):
            if step > 3:
                transform = camera.transform.copy()
                transform[0, 3] += 0.25
                camera.transform = transform
            frame = renderer.render(camera)
        picture, empty = frame["radiance"].max(axis=2), ~np.isfinite(frame["depth"])
    shapes = [np.roll(empty, (down, right), (0, 1)) for down in range(-3, 4) for right in range(-3, 4)]
    far = np.logical_and.reduce(shapes)  # from all edges
    assert far.mean() > 0.2
    typical = np.median(picture[~empty])
    print(picture[far].max() / typical)
    assert picture[far].max() < 0.05 * typical
