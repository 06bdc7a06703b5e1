"""Pictures with a shutter: ramps of moving edges, slanted edges of a rolling shutter, and means of still pictures."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import choose_dispatches, uniforms_of
from support.scenes import bent_joints, tube

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte
from solari_vk.scene.matrices import rotation
from solari_vk.scene.shutter import between

SIZE = (64, 32)
PIXEL = 1 / 16  # meters


def edge_scene():
    """A lamp that covers all right of its left edge, which is at the picture's middle, seen by parallel rays."""
    scene = sv.Scene(sv.Camera(orthographic_height=SIZE[1] * PIXEL))
    return scene, scene.add(shapes.quad((50, 0, -2), (50, 0, 0), (0, 50, 0)), lamp(1.0))


def expose(device, scene, pose, shutter, samples=64, camera=None, **options):
    with sv.PathTracer(device, scene, SIZE, seed=3, **options) as tracer:
        return np.asarray(tracer.render(camera, samples, shutter=shutter, pose=pose), np.float64)


def ramp():
    """What each column (64,) of an edge shows that moves from 24 pixels left of the middle to it."""
    edge = SIZE[0] / 2 - 24 + 24 * np.linspace(0, 1, 20001)
    return np.clip(np.arange(SIZE[0])[:, None] + 1 - edge, 0, 1).mean(axis=1)


def move(instance, speed):
    def pose(seconds):
        instance.position = (speed * seconds, 0, 0)

    return pose


def test_a_moving_edge_is_a_ramp(device):
    scene, instance = edge_scene()
    instance.position = (-24 * PIXEL, 0, 0)
    shutter, speed = sv.Shutter(open=1.0, close=1.5, time_samples=64), 24 * PIXEL / 0.5

    def pose(seconds):
        instance.position = ((seconds - 1.0) * speed - 24 * PIXEL, 0, 0)

    found = expose(device, scene, pose, shutter, 128, max_bounces=0)[..., 0]
    np.testing.assert_allclose(found.mean(axis=0), ramp(), atol=0.01)
    assert 0.2 < ramp()[20] < 0.9
    assert instance.position[0] == pytest.approx(-12 * PIXEL)


def test_a_rolling_shutter_slants_edges(device):
    """The last row is exposed 0.1 s after the first, in which the edge moves by 16 pixels; in a global one it is
    upright."""
    for readout, slant in ((0.1, 16.0), (0.0, 0.0)):
        scene, instance = edge_scene()
        shutter = sv.Shutter(close=1e-4, readout=readout, row_bands=SIZE[1], time_samples=2)
        found = expose(device, scene, move(instance, -160 * PIXEL), shutter, 16, max_bounces=0)[..., 0]
        lit = found.sum(axis=1)
        expected = SIZE[0] / 2 + slant * (np.arange(SIZE[1]) + 0.5) / SIZE[1]
        np.testing.assert_allclose(lit, expected, atol=0.25)


def test_skins_lights_and_cameras_are_blurred(device):
    """The mean of still pictures at many times: a skin bends, a lamp moves, and the camera turns and zooms."""
    mesh, rest = tube(joints=3)
    scene = sv.Scene(sv.Instance(mesh, matte((0.7, 0.4, 0.2)), joint_matrices=bent_joints(rest, 0.0)))
    scene.add(shapes.quad((0, -0.1, 0), (0, 0, 3), (3, 0, 0)), matte((0.5, 0.5, 0.5)))
    light = scene.add(shapes.sphere(0.3, 12), lamp(20.0))
    cameras = [sv.Camera.look_at((x, 1.2, 4), (0, 0.9, 0), fov=fov) for x, fov in ((-0.5, 45), (0.8, 60))]

    def pose(seconds):
        scene.instances[0].joint_matrices = bent_joints(rest, 0.5 * seconds)
        light.position = (-1 + 2 * seconds, 2.2, 1)
        return between(*cameras, seconds)

    blurred = expose(device, scene, pose, sv.Shutter(close=1.0, time_samples=64), 256)
    mean = np.zeros_like(blurred)
    with sv.PathTracer(device, scene, SIZE, seed=11) as tracer:
        for time in (np.arange(64) + 0.5) / 64:
            mean += np.asarray(tracer.render(pose(time), samples=8)) / 64
        sharp = np.asarray(tracer.render(pose(0.5), samples=256))
    of_blocks = [picture.reshape(16, 2, 32, 2, 3).mean(axis=(1, 3)) for picture in (blurred, sharp, mean)]
    error, blur = (np.mean((picture - of_blocks[2]) ** 2 / (of_blocks[2] ** 2 + 1e-2)) for picture in of_blocks[:2])
    print(f"relMSE of 2 x 2 pixels: of the exposure {error:.4f}, of the sharp picture {blur:.4f}")
    assert error < 0.01
    assert blur > 15 * error
    assert abs(blurred.mean() / mean.mean() - 1) < 0.01


def test_what_is_beside_the_picture(device):
    """Results at pixels' centers show the middle of the exposure; the next picture is sharp; guides are blurred."""
    pytest.importorskip("pyoidn")
    scene, instance = edge_scene()
    instance.material = sv.Material(base_color=0.8)
    scene.environment = sv.Environment(np.ones((2, 4, 3), np.float32))
    pose, shutter = move(instance, 20 * PIXEL), sv.Shutter(close=1.0, time_samples=16)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        frame = tracer.render(samples=32, shutter=shutter, pose=pose, denoise=True)
        seen = np.isfinite(frame["depth"])[16]
        assert seen.tolist() == (np.arange(64) >= 42).tolist()
        assert frame["radiance"].shape == (32, 64, 3)
        albedo = tracer.read_guides()[0][16, :, 0]
        np.testing.assert_allclose(albedo[33:51], 0.8 * np.clip((np.arange(33, 51) - 31.5) / 20, 0, 1), atol=0.09)
        still = tracer.render(samples=2, denoise=False)["radiance"][16, :, 0]
        assert np.ptp(still[:41]) < 1e-5


def test_an_exposure_is_reproducible(device):
    scene, instance = edge_scene()
    shutter = sv.Shutter(close=0.1, readout=0.05, row_bands=4, time_samples=5)
    one, other = (expose(device, scene, move(instance, 3.0), shutter, 12, max_bounces=0) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_what_progress_raises_keeps_the_picture(device):
    """It is the picture that `time_limit` ends as early."""
    scene, instance = edge_scene()
    pose, shutter = move(instance, 3.0), sv.Shutter(close=1.0)

    def stop(samples):
        raise InterruptedError

    with sv.PathTracer(device, scene, SIZE) as tracer:
        expected = tracer.render(samples=64, shutter=shutter, pose=pose, time_limit=0)["radiance"]
        instance.position = (9, 0, 0)
        with pytest.raises(InterruptedError):
            tracer.render(samples=64, shutter=shutter, pose=pose, progress=stop)
        assert (tracer.samples, instance.position[0]) == (4, 1.5)
        np.testing.assert_array_equal(tracer["radiance"], expected)


def test_a_failed_exposure_leaves_the_middle(device):
    scene, instance = edge_scene()
    calls = []

    def pose(seconds):
        calls.append(seconds)
        if len(calls) == 2:
            raise OSError("lost")
        instance.position = (seconds, 0, 0)

    with sv.PathTracer(device, scene, SIZE) as tracer:
        with pytest.raises(OSError, match="lost"):
            tracer.render(samples=16, shutter=sv.Shutter(close=1.0), pose=pose)
        with pytest.raises(SolariError, match="render before"):
            tracer["radiance"]
    assert instance.position[0] == 0.5


def test_dispatches_of_an_exposure_are_measured(device):
    """They begin with a sample of each pixel, and grow while they are fast; the picture's bits stay."""
    scene, instance = edge_scene()
    pose, shutter = move(instance, 3.0), sv.Shutter(close=1.0, time_samples=4)
    with sv.PathTracer(device, scene, SIZE, max_bounces=0) as tracer:
        counts = []
        submit = tracer._frame.submit
        uniforms = uniforms_of(tracer)
        tracer._frame.submit = lambda: counts.append(uniforms["path_sampling.samples_per_dispatch"]) or submit()
        measured = tracer.render(samples=128, shutter=shutter, pose=pose)["radiance"]
        assert counts[0] == 1
        assert max(counts) > 1
    with sv.PathTracer(device, scene, SIZE, max_bounces=0) as tracer:
        choose_dispatches(tracer, samples=32)
        np.testing.assert_array_equal(tracer.render(samples=128, shutter=shutter, pose=pose)["radiance"], measured)


def test_moments_share_the_samples():
    shutter = sv.Shutter(open=2.0, close=3.0, time_samples=8)
    moments = list(shutter.moments(20, 32, 0))
    assert moments[0].samples[0] == 0
    assert sum(m.samples[1] - m.samples[0] for m in moments) == 20
    assert sorted(int(8 * (m.time - 2)) for m in moments) == list(range(8))
    assert [int(8 * (m.time - 2)) for m in moments][:4] == [0, 4, 2, 6]
    assert len(list(shutter.moments(3, 32, 0))) == 3
    rolling = list(sv.Shutter(close=0.0, readout=1.0, time_samples=1, row_bands=4).moments(1, 32, 0))
    assert [(m.rows, m.time) for m in rolling] == [((8 * n, 8 * n + 8), (n + 0.5) / 4) for n in range(4)]


def test_cameras_between():
    first = sv.Camera.look_at((0, 0, 5), (0, 0, 0), fov=40)
    second = sv.Camera.look_at((5, 1, 0), (0, 1, 0), fov=60, ev100=3)
    middle = between(first, second, 0.5)
    np.testing.assert_allclose(middle.position, (2.5, 0.5, 2.5))
    np.testing.assert_allclose(-middle.rotation[:, 2], (-(0.5**0.5), 0, -(0.5**0.5)), atol=1e-9)
    assert middle.fov == pytest.approx(50)
    for share, end in ((0, first), (1, second)):
        np.testing.assert_allclose(between(first, second, share).transform, end.transform, atol=1e-9)
    opposite = sv.Camera(transform=np.diag((-1.0, 1, -1, 1)))
    quarter = between(sv.Camera(), opposite, 0.5).rotation
    np.testing.assert_allclose(np.abs(quarter), [(0, 0, 1), (0, 1, 0), (1, 0, 0)], atol=1e-9)
    np.testing.assert_allclose(between(sv.Camera(), opposite, 1).transform, opposite.transform, atol=1e-9)
    for angle in (1e-7, 2.0, np.pi - 1e-7):  # beyond the end, by the smallest and the largest angles
        turned = [np.eye(4), np.eye(4)]
        for matrix, times in zip(turned, (1, 3), strict=True):
            matrix[:3, :3] = rotation((1, -2, 0.5), times * angle)
        further = between(sv.Camera(), sv.Camera(transform=turned[0]), 3)
        np.testing.assert_allclose(further.transform, turned[1], atol=1e-9)


WRONG = (  # options of both renderers' `render`, for a scene without animations
    ({"shutter": sv.Shutter(close=1)}, "has no animations: give pose"),
    ({"shutter": 0.5, "pose": print}, "shutter is a solari_vk.Shutter, not 0.5"),
    ({"shutter": sv.Shutter(close=1), "pose": 3}, "pose is a function of the time"),
    ({"pose": id}, "shutter is a solari_vk.Shutter, not None"),
)


def test_wrong_shutters(device):
    with pytest.raises(SolariError, match=r"must open, at 2 s, before it closes, at 1 s"):
        sv.Shutter(open=2, close=1)
    with pytest.raises(SolariError, match="time_samples is a whole number from 1"):
        sv.Shutter(close=1, time_samples=0)
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        target = {"shutter": sv.Shutter(close=1), "pose": id, "target_error": 0.1}, "have no target_error"
        for options, message in (*WRONG, target):
            with pytest.raises(SolariError, match=message):
                tracer.render(samples=1, **options)
