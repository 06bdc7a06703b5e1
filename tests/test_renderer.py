"""PathTracer as an object: what it refuses, and how it sizes its dispatches."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv


@pytest.mark.parametrize("size", [640, (1, 2, 3), (float("nan"), 2), (0, 5), (5, -1), (16384, 16384), ("a", 2), None])
def test_sizes_it_refuses(device, size):
    live = device.live_objects
    with pytest.raises(sv.SolariError, match="PathTracer"):
        sv.PathTracer(device, sv.builtin("cornell_box"), size)
    assert device.live_objects == live


BAD_SETTINGS = [
    {"seed": "a"},
    {"seed": -1},
    {"max_bounces": 1.5},
    {"light_strategy": "x"},
    {"layering": "x"},
    {"pixel_filter": 3},
]


@pytest.mark.parametrize("options", BAD_SETTINGS)
def test_settings_it_refuses(device, options):
    with pytest.raises(sv.SolariError, match=next(iter(options))):
        sv.PathTracer(device, sv.builtin("cornell_box"), (4, 4), **options)


def test_what_render_refuses(device):
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (4, 4), max_bounces=0)
    for samples in (0, -1, 2.5, "4", None):
        with pytest.raises(sv.SolariError, match="samples"):
            renderer.render(scene.camera, samples=samples)
    with pytest.raises(sv.SolariError, match="Camera"):
        renderer.render(5)
    with pytest.raises(sv.SolariError, match="render before"):
        renderer["radiance"]
    renderer.render(scene.camera, samples=1)
    with pytest.raises(sv.SolariError, match="depth"):
        renderer["smell"]
    renderer.close()


def test_a_refused_resize_changes_nothing(device):
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (6, 4), max_bounces=1)
    before = renderer.render(scene.camera, samples=2)["radiance"]
    with pytest.raises(sv.SolariError, match="16384"):
        renderer.resize((16384, 16384))
    np.testing.assert_array_equal(renderer.render(scene.camera, samples=2)["radiance"], before)
    renderer.close()


def test_a_resize_that_fails_on_the_device_changes_nothing(device, monkeypatch):
    """Also the number of rows in a dispatch stays, which may have been reduced since the start."""
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (8, 24), max_bounces=1)
    renderer._band_rows = 8
    renderer._frame.rebuild(renderer._stages(renderer.size))
    renderer.render(scene.camera, samples=1)

    def fail(*_):
        raise sv.DeviceError("out of memory")

    with monkeypatch.context() as patch:
        patch.setattr(renderer._frame, "rebuild", fail)
        with pytest.raises(sv.DeviceError):
            renderer.resize((9, 25))
    other = sv.Camera.look_at((0.3, 1.2, 2.5), (0, 1, 0))
    fresh = sv.PathTracer(device, scene, (8, 24), max_bounces=1)
    np.testing.assert_array_equal(renderer.render(other, samples=2), fresh.render(other, samples=2))
    renderer.close()
    fresh.close()


@pytest.mark.parametrize("bands", [1, 3, 7])
def test_dispatches_grow_towards_their_time(device, bands, monkeypatch):
    """With any number of bands, a dispatch takes more samples of pictures that are fast to trace."""
    monkeypatch.setattr("solari_vk.passes.pathtracer.MAX_FIRST_PIXELS", 16 * 8)
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (16, 8 * bands), max_bounces=0)
    renderer.render(scene.camera, samples=200)
    assert renderer._batch > 8
    renderer.close()


def test_dispatch_sizes_leave_the_picture_alone(device):
    """The picture has the same bits with samples one by one, in batches, and in bands of rows."""
    scene = sv.builtin("cornell_box")
    pictures = []
    for batch, rows in ((1, 21), (7, 21), (3, 8)):
        renderer = sv.PathTracer(device, scene, (16, 21), seed=3)
        renderer._band_rows = rows
        renderer._frame.rebuild(renderer._stages(renderer.size))
        renderer._next_look = 10**9
        renderer._batch = batch
        pictures.append(renderer.render(scene.camera, samples=14)["radiance"])
        renderer.close()
    for other in pictures[1:]:
        np.testing.assert_array_equal(other, pictures[0])


def test_short_dispatches_for_slow_pictures(device, monkeypatch):
    """When a dispatch takes too long, the next covers fewer rows."""
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (64, 64))
    monkeypatch.setattr("solari_vk.reference.DISPATCH_MS", 1e-3)
    renderer.render(scene.camera, samples=12)
    assert renderer._band_rows == 8
    renderer.close()
