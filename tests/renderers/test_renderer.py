"""PathTracer as an object: what it refuses, and how it sizes its dispatches."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import choose_dispatches, leaves_nothing

import solari_vk as sv
from solari_vk.gpu.frame.in_parts import Interrupted
from solari_vk.passes import rows as threads_of


@pytest.fixture
def scene():
    return sv.builtin("cornell_box")


@pytest.mark.parametrize("kind", [sv.PathTracer, sv.Renderer])
def test_sizes_they_refuse(device, scene, kind):
    for size in (640, (1, 2, 3), (float("nan"), 2), (4.5, 4), (0, 5), (5, -1), (1 << 20, 1 << 20), ("a", 2), None):
        with leaves_nothing(device), pytest.raises(sv.SolariError, match=f"{kind.__name__}: "):
            kind(device, scene, size)


def test_what_it_refuses(device, scene):
    for name, value in (
        ("seed", "a"),
        ("seed", -1),
        ("max_bounces", 1.5),
        ("light_strategy", "x"),
        ("layering", "x"),
        ("pixel_filter", 3),
    ):
        with pytest.raises(sv.SolariError, match=name):
            sv.PathTracer(device, scene, (4, 4), **{name: value})
    with sv.PathTracer(device, scene, (4, 4), max_bounces=0) as renderer:
        for samples in (0, -1, 2.5, "4", None):
            with pytest.raises(sv.SolariError, match="samples"):
                renderer.render(scene.camera, samples=samples)
        with pytest.raises(sv.SolariError, match="Camera"):
            renderer.render(5)
        with pytest.raises(sv.SolariError, match="render before"):
            renderer["radiance"]


def test_whole_numbers_may_be_numpys(device, scene):
    """Those of few bits too, whose products would wrap around; and a subclass keeps its stages when it is resized."""

    class Own(sv.PathTracer):
        def _stages(self, size):
            return [*super()._stages(size), sv.Stage("own")]

    options = {"seed": np.uint8(200), "max_bounces": np.int64(3), "first_sample": np.int32(1)}
    pictures = []
    for kind, numbers in ((Own, options), (sv.PathTracer, {name: int(value) for name, value in options.items()})):
        with kind(device, scene, (4, 4), **numbers) as tracer:
            tracer.resize((8, 4))
            pictures.append(tracer.render(samples=np.uint8(3))["radiance"])
            assert ("own" in [stage.name for stage in tracer.stages]) == (kind is Own)
    np.testing.assert_array_equal(*pictures)
    for threads in (1, 70_000, 1 << 17, 131_073):
        assert np.prod(threads_of.rows(threads)) >= threads


def test_a_refused_resize_changes_nothing(device, scene):
    with sv.PathTracer(device, scene, (6, 4), max_bounces=1) as renderer:
        before = renderer.render(scene.camera, samples=2)["radiance"]
        with pytest.raises(sv.SolariError, match="16384"):
            renderer.resize((16384, 16384))
        np.testing.assert_array_equal(renderer.render(scene.camera, samples=2)["radiance"], before)


def test_a_resize_that_fails_on_the_device_changes_nothing(device, scene, monkeypatch):
    """Also the number of rows in a dispatch stays, which may have been reduced since the start."""
    other, size = sv.Camera.look_at((0.3, 1.2, 2.5), (0, 1, 0)), (8, 24)
    with (
        sv.PathTracer(device, scene, size, max_bounces=1) as renderer,
        sv.PathTracer(device, scene, size, max_bounces=1) as fresh,
    ):
        choose_dispatches(renderer, rows=8)
        renderer.render(scene.camera, samples=1)
        with monkeypatch.context() as patch:
            patch.setattr(renderer._frame, "rebuild", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                renderer.resize((9, 25))
        np.testing.assert_array_equal(renderer.render(other, samples=2), fresh.render(other, samples=2))


@pytest.mark.parametrize("bands", [1, 3])
def test_dispatches_grow_towards_their_time(device, scene, bands, monkeypatch):
    """With any number of bands, a dispatch takes more samples of pictures that are fast to trace."""
    monkeypatch.setattr("solari_vk.passes.reference.MAX_FIRST_PIXELS", 16 * 8)
    with sv.PathTracer(device, scene, (16, 8 * bands), max_bounces=0) as renderer:
        renderer.render(scene.camera, samples=200)
        assert renderer._dispatch.samples > 8


def test_dispatch_sizes_leave_the_picture_alone(device, scene, monkeypatch):
    """The picture has the same bits with samples one by one, in batches, in bands of rows, and where waves are few, so
    that one pass traces many paths to their ends."""
    pictures = []
    for batch, rows, waves in ((1, 21, 32), (7, 21, 32), (3, 8, 32), (2, 3, 32), (7, 21, 2)):
        monkeypatch.setattr("solari_vk.passes.reference.MAX_WAVES", waves)
        with sv.PathTracer(device, scene, (13, 21), seed=3) as renderer:
            choose_dispatches(renderer, rows, batch)
            pictures.append(renderer.render(scene.camera, samples=14)["radiance"])
            assert ("reference/finish" in renderer._frame.timings) == (waves == 2)
    for other in pictures[1:]:
        np.testing.assert_array_equal(other, pictures[0])


@pytest.mark.parametrize("made", [sv.PathTracer, sv.Renderer])
def test_the_largest_sizes_are_said_in_words(device, scene, made):
    """Before anything is compiled."""
    most = device.properties.limits.maxStorageBufferRange // made.pixel_bytes(device) + 8
    with pytest.raises(sv.SolariError, match=r"what this device holds|is wider than"):
        made(device, scene, (most, 1))
    width = 1 << (most.bit_length() // 2)
    with pytest.raises(sv.SolariError, match="what this device holds"):
        made(device, scene, (width, most // width + 8))


def test_interrupted_dispatches_leave_no_paths(device, scene):
    """Whatever pass a frame ends after, the next picture has each path once."""
    options = {"size": (13, 9), "max_bounces": 3, "seed": 3}
    with sv.PathTracer(device, scene, **options) as fresh:
        expected, rays = fresh.render(scene.camera, samples=4)["radiance"], fresh.rays
    with sv.PathTracer(device, scene, **options) as renderer:
        passes = sum(len(stage.passes) for stage in renderer._stages(renderer.size))
        for stop in range(1, passes):
            calls = iter(range(1, passes + 1))
            renderer.between = lambda calls=calls, stop=stop: next(calls) == stop
            with pytest.raises(Interrupted):
                renderer.advance(scene.camera, max_samples=1)
            renderer.between = None
            renderer.reset()
            np.testing.assert_array_equal(renderer.render(scene.camera, samples=4)["radiance"], expected)
            assert renderer.rays == rays


def test_short_dispatches_for_slow_pictures(device, scene, monkeypatch):
    """When a dispatch takes too long, the next covers fewer rows."""
    monkeypatch.setattr("solari_vk.passes.reference.DISPATCH_MS", 1e-3)
    with sv.PathTracer(device, scene, (64, 64)) as renderer:
        renderer.render(scene.camera, samples=12)
        assert renderer._dispatch.rows == 8
