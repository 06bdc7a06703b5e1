"""Realtime frames with a shutter: ramps of moving edges, slanted edges, and the path tracer's exposures."""

from __future__ import annotations

import numpy as np
import pytest
from proofs.frame.test_realtime_depth_of_field import relative_error
from proofs.path_tracer.test_motion_blur import PIXEL, SIZE, WRONG, edge_scene, move, ramp
from support.scenes import bent_joints, tube
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place
from solari_vk.scene.shutter import between

BOX = (64, 64)


def expose(renderer, shutter, pose, frames, camera=None):
    """The picture of an exposure."""
    for _ in range(frames):
        frame = renderer.render(camera, shutter=shutter, pose=pose)
    return np.asarray(frame, np.float64)


def test_a_moving_edge_is_a_ramp(device):
    """A moving edge is a ramp. What moves leaves a still picture as it is, and the next exposure begins anew."""
    scene, instance = edge_scene()
    shutter, speed = sv.Shutter(open=1.0, close=1.5), 24 * PIXEL / 0.5

    def pose(seconds):
        instance.position = ((seconds - 1.0) * speed - 24 * PIXEL, 0, 0)

    with sv.Renderer(device, scene, SIZE) as renderer:
        for shift in (0.0, 0.125):  # 6 pixels
            found = expose(renderer, shutter.at(shift), pose, 48)[..., 0].mean(axis=0)
            moved = np.roll(ramp(), round(48 * shift))
            moved[: round(48 * shift)] = 0.0
            np.testing.assert_allclose(found, moved, atol=0.03)
            assert np.abs(found - moved).mean() < 0.006
    assert instance.position[0] == pytest.approx(-6 * PIXEL)


def test_long_exposures_are_plain_means(device):
    """All of 200 frames count the same, or of a rolling shutter those that expose a row: a lamp that is there in their
    first half alone gives half of its light."""
    scene, instance = edge_scene()
    for readout, apart in ((0.0, 1e-3), (1.0, 0.05)):
        shown = []

        def pose(seconds, shown=shown):
            shown.append(seconds)  # twice a frame
            instance.position = (0 if len(shown) <= 200 else 100, 0, 0)

        with sv.Renderer(device, scene, (16, 16)) as renderer:
            lit = expose(renderer, sv.Shutter(close=1e-3, readout=readout, row_bands=16), pose, 200)[..., 0]
        np.testing.assert_allclose(lit.mean(axis=1), 0.25, atol=apart)


def test_a_rolling_shutter_slants_edges(device):
    """The last row is exposed 0.1 s after the first, in which the edge moves by 16 pixels."""
    scene, instance = edge_scene()
    with sv.Renderer(device, scene, SIZE) as renderer:
        for readout, slant in ((0.1, 16.0), (0.0, 0.0), (-0.1, -16.0)):
            shutter = sv.Shutter(close=1e-4, readout=readout, row_bands=SIZE[1] // 2)
            lit = expose(renderer, shutter, move(instance, -160 * PIXEL), 128)[..., 0].sum(axis=1)
            expected = SIZE[0] / 2 + slant * (np.arange(SIZE[1]) + 0.5) / SIZE[1]
            np.testing.assert_allclose(lit, expected, atol=0.7)  # a band has 1 pixel of motion
            assert abs((lit - expected).mean()) < 0.15


def moving_box():
    """A ball that passes, a turning block, a skin that bends, a lamp that moves and a camera that turns: the scene, and
    what poses it from 0 to 1."""
    scene = sv.builtin("cornell_box")
    ball = scene.add(sv.Instance(shapes.sphere(0.25, 24), matte((0.2, 0.6, 0.3))))
    mesh, rest = tube(joints=3)
    skin = scene.add(sv.Instance(mesh, matte((0.7, 0.4, 0.2)), joint_matrices=bent_joints(rest, 0.0)))
    skin.transform = place(0.35, (1.6, 0.05, 0.4))
    light = scene.add(shapes.sphere(0.12, 16), lamp(40.0))  # above the picture
    block, exposure = scene.instances["short block"], scene.camera.ev100
    start = block.transform
    cameras = [sv.Camera.look_at((x, 1.0, -2.6), (1, 0.9, 1), vertical_fov=0.8, ev100=exposure) for x in (0.95, 1.05)]

    def pose(seconds):
        ball.position = (0.4 + 0.5 * seconds, 1.2, 0.4)
        block.transform = start @ place(1.0, turn=0.3 * seconds)
        skin.joint_matrices = bent_joints(rest, 0.5 * seconds)
        light.position = (0.4 + 0.6 * seconds, 2.3, -0.3)
        return between(*cameras, seconds)

    return scene, pose


@pytest.mark.slow
def test_denoised_frames_converge_as_sharp_ones_do(device):
    """The mean of exposures is within 2 % of the path tracer's, sixteenths nearly as that of sharp pictures; the error
    of frame 32 is at most twice a sharp picture's, from a cold start and in the next exposure."""
    scene, pose = moving_box()
    errors, worst = {}, {}
    for kind, shutters in (
        ("sharp", [sv.Shutter(open=0.5, close=0.5, time_samples=1)]),
        ("blurred", [sv.Shutter(close=1.0, time_samples=256, row_bands=bands) for bands in (1, 2)]),
    ):
        with sv.PathTracer(device, scene, BOX, seed=3) as tracer:
            truth = np.asarray(tracer.render(samples=1024, shutter=shutters[0], pose=pose), np.float64)
        with sv.Renderer(device, scene, BOX) as renderer:
            if kind == "blurred":
                found = [expose(renderer, shutter, pose, 32) for shutter in shutters]
            else:
                camera = pose(0.5)
                found = [np.asarray([renderer.render(camera) for _ in range(32)][-1], np.float64) for _ in range(2)]
        errors[kind] = [relative_error(picture, truth) for picture in found]
        mean = np.mean(found, axis=0)
        off = mean.mean() / truth.mean() - 1
        tiles = [picture.reshape(4, 16, 4, 16, 3).mean(axis=(1, 3, 4)) for picture in (mean, truth)]
        worst[kind] = np.abs(tiles[0] / tiles[1] - 1).max()
        print(f"{kind}: relMSE {np.round(errors[kind], 5)}, mean {off:+.2%}, tiles {worst[kind]:.2%}")
        assert abs(off) < 0.02
    assert max(errors["blurred"]) <= 2 * errors["sharp"][0]
    assert worst["blurred"] < worst["sharp"] + 0.04


def test_what_is_beside_the_picture(device):
    """Results at pixels' centers and picks show the middle of the exposure; the scene is there; a picture without a
    shutter is sharp again; the same calls give the same bits."""
    pictures = []
    for _ in range(2):
        scene, instance = edge_scene()
        pose, shutter = move(instance, 20 * PIXEL), sv.Shutter(close=1.0)
        with sv.Renderer(device, scene, SIZE) as renderer:
            for _ in range(12):
                frame = renderer.render(shutter=shutter, pose=pose)
            assert np.isfinite(frame["depth"])[16].tolist() == (np.arange(64) >= 42).tolist()
            assert frame.pick(45, 16) is instance
            assert frame.pick(38, 16) is None
            frame = renderer.render(shutter=shutter, pose=pose)
            assert instance.position[0] == 10 * PIXEL
            pictures.append(frame["radiance"])
            for _ in range(12):
                frame = renderer.render()
            sharp = frame["radiance"][..., 0]
            assert np.abs(sharp - (np.arange(64) >= 42)).max() < 0.02
    np.testing.assert_array_equal(*pictures)


def test_a_camera_that_moves_begins_a_new_exposure(device):
    scene, instance = edge_scene()
    pose, shutter = move(instance, 4 * PIXEL), sv.Shutter(close=1.0)
    with sv.Renderer(device, scene, SIZE) as renderer:
        expose(renderer, shutter, pose, 24)
        scene.camera.position = (8 * PIXEL, 0, 0)
        found = expose(renderer, shutter, pose, 24)[..., 0].mean(axis=0)
    assert (found[:23] < 0.02).all()
    assert (found[29:] > 0.98).all()


def test_another_pose_begins_a_new_exposure(device):
    scene, instance = edge_scene()
    shutter = sv.Shutter(close=1.0)
    with sv.Renderer(device, scene, SIZE) as renderer:
        expose(renderer, shutter, move(instance, 24 * PIXEL), 24)
        again = expose(renderer, shutter, move(instance, 0.0), 24)
    with sv.Renderer(device, scene, SIZE) as renderer:
        alone = expose(renderer, shutter, move(instance, 0.0), 24)
    assert np.abs(again - alone).mean() < 0.01


def test_a_failed_pose_leaves_the_middle(device):
    scene, instance = edge_scene()
    calls = []

    def pose(seconds):
        calls.append(seconds)
        if len(calls) == 3:
            raise OSError("lost")
        instance.position = (seconds, 0, 0)

    with sv.Renderer(device, scene, SIZE) as renderer:
        renderer.render(shutter=sv.Shutter(close=1.0), pose=pose)
        with pytest.raises(OSError, match="lost"):
            renderer.render(shutter=sv.Shutter(close=1.0), pose=pose)
        assert instance.position[0] == 0.5
        for options, said in WRONG:
            with pytest.raises(SolariError, match=f"Renderer.render: .*{said}"):
                renderer.render(**options)


def test_the_exposure_of_cameras_that_move_is_chosen_once(device):
    """It is that of the first four frames, and not metered anew for each camera that `pose` makes."""
    cameras = []

    def pose(seconds):
        cameras.append(sv.Camera(position=(0.01 * seconds, 0, 4), auto_exposure=True))
        return cameras[-1]

    with sv.Renderer(device, edge_scene()[0], SIZE) as renderer, sv.PathTracer(device, renderer.binder, SIZE) as tracer:
        frames = [renderer.render(shutter=sv.Shutter(close=1.0), pose=pose) for _ in range(6)]
        assert [frame.camera.auto_exposure for frame in frames] == [True] * 3 + [False] * 3
        assert frames[3].camera.ev100 != 0
        assert {camera.ev100 for camera in cameras[-4:]} == {frames[3].camera.ev100}
        pictures = [tracer.render(samples=2, shutter=sv.Shutter(close=1.0), pose=pose) for _ in range(2)]
        assert pictures[1].camera.ev100 == pictures[0].camera.ev100 != 0
        assert not cameras[-1].auto_exposure


@pytest.mark.parametrize("close", [0.0, 1.0])
def test_a_readout_of_no_time_exposes_all_rows(close):
    for readout in (5e-324, -5e-324):
        shutter = sv.Shutter(close=close, readout=readout)
        assert {shutter.frame(number, 48)[1] for number in range(64)} <= {(0, 48)}


@pytest.mark.parametrize("readout", [0.3, -0.3, 0.0])
def test_times_cover_the_exposure_of_each_row(readout):
    """As the path tracer's moments do."""
    shutter, height = sv.Shutter(open=2.0, close=2.1, readout=readout), 48
    times = [[] for _ in range(height)]
    for number in range(4096):
        time, (first, end) = shutter.frame(number, height)
        for row in range(first, end):
            times[row].append(time)
    opens = 2.0 + readout * (np.arange(height) + 0.5) / height
    for row, found in zip(opens, times, strict=True):
        assert len(found) == pytest.approx(4096 * 0.1 / (0.1 + abs(readout)), rel=0.03)
        np.testing.assert_allclose(np.quantile(found, (0, 0.5, 1)), row + np.array((0, 0.05, 0.1)), atol=0.002)
    for start in (0, 7919 * 2**32):  # the largest seed's
        assert len({shutter.frame(start + number, height)[0] for number in range(4096)}) == 4096


RESOLVE = "passes/taa/resolve.comp"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "rows without their time": (test_a_rolling_shutter_slants_edges, Bug(RESOLVE, "is_exposed", "return true;")),
        "an exposure that goes on in the next": (
            test_a_moving_edge_is_a_ramp,
            Bug("scene/camera_records.glsl", "FIRST_OF_EXPOSURE", "4u"),
        ),
        "an exposure that follows motion": (
            test_a_moving_edge_is_a_ramp,
            Bug("scene/camera_records.glsl", "LATER_OF_EXPOSURE", "4u"),
        ),
        "an exposure that forgets": (
            test_long_exposures_are_plain_means,
            Bug(
                "passes/taa/history.glsl",
                "load_exposure",
                "HistorySample found = correct(index); found.weight = min(found.weight, 63.0); return found;",
            ),
        ),
    }
)
