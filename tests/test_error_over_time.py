"""Quality per time: the errors of frames, the frames of a moving camera, and the script's settings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.measure.frame.error import Errors
from solari_vk.measure.frame.error_over_time import HEAD, read_settings, row
from solari_vk.measure.frame.reprojection import Movement
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

SIZE, WARM_UP, OBSERVED = (48, 48), 2, 12


@pytest.fixture(scope="module")
def see(device):
    """see(cameras, name) -> a result of what each of the cameras sees, and a binder of the same scene."""
    scene = builtin("cornell_box")
    binder = SceneBinder(device, scene)
    with Renderer(device, binder, SIZE, Settings(jitter=False)) as renderer:
        yield lambda cameras, name: [renderer.render(camera)[name] for camera in cameras], binder
    binder.destroy()


def test_frames_of_a_moving_camera_are_reprojected(device, see):
    """Frames that show what their samples hit become what the last camera's samples hit. Bilinear interpolation of
    positions on planes is off by little. No pixel mixes instances unless its samples do."""
    see, binder = see
    last = binder.scene.camera
    movement = Movement(device, binder, last, SIZE, WARM_UP, OBSERVED, step=0.01)
    cameras = movement.cameras[WARM_UP:]
    jittered = [Camera(transform=last.transform, vertical_fov=last.vertical_fov, jitter=item.jitter)
                for item in cameras]  # fmt: skip
    assert ((last.transform - cameras[0].transform)[:3, 3] @ last.transform[:3, 0]) > 0.1, "it moves to the right"

    frames, expected = see(cameras, "position"), np.mean(see(jittered, "position"), axis=0)
    pixel = 2 * np.tan(last.vertical_fov / 2) * 2.9 / SIZE[1]
    off = np.abs(movement.mean(frames) - expected).max(axis=-1)
    assert np.abs(np.mean(frames, axis=0) - expected).mean() > pixel, "the frames alone would do"
    assert np.median(off) < 0.01 * pixel
    assert np.quantile(off, 0.75) < 0.5 * pixel  # the others are at edges, and where frames don't see the surface

    expected = np.array(see(jittered, "instance_id"), np.float32)
    whole = (expected == expected[0]).all(axis=0) & (expected[0] < 1000)
    colored = [np.repeat(frame.astype(np.float32)[..., None], 3, axis=-1) for frame in see(cameras, "instance_id")]
    assert whole.mean() > 0.5
    assert np.allclose(movement.mean(colored)[whole, 0], expected[0][whole], atol=1e-5)


def test_frames_of_a_still_camera_are_averaged(device, see):
    see, binder = see
    still = Movement(device, binder, binder.scene.camera, SIZE, WARM_UP, OBSERVED, step=0.0)
    frames = see(still.cameras[WARM_UP:], "position")
    assert np.allclose(still.mean(frames), np.mean(frames, axis=0), atol=1e-4)


def test_pixels_with_mirrors_do_not_count(device):
    scene = builtin("mirror_hall")
    binder = SceneBinder(device, scene)
    rough = Movement(device, binder, scene.camera, SIZE, 0, 3).rough
    with Renderer(device, binder, SIZE, Settings(jitter=False)) as renderer:
        frame = renderer.render(scene.camera)
        mirrors = np.any([frame.mask(item) for item in scene if item.name in ("mirror", "gold")], axis=0)
        walls = frame.mask("room")
    binder.destroy()
    assert rough[mirrors].mean() < 0.1  # at edges, no sample of a pixel may hit what is at its center
    assert rough[walls].mean() > 0.8


def test_errors_of_runs():
    """Runs share a bias of 0.3 and have noise of standard deviation 0.1."""
    truth, rng = np.ones((200, 200, 3)), np.random.default_rng(1)
    runs = [1.3 + 0.1 * rng.standard_normal(truth.shape) for _ in range(4)]
    times = {"wall": [1.0, 3.0, 20.0], "cpu": [4.0, 5.0, 6.0]}
    found = Errors(truth, singles=[truth - 1, truth + 2], means=runs, rays=2.5, **times)
    assert np.isclose(found.many, 0.1 / 1.01, rtol=0.01)
    assert np.isclose(found.noise, 0.01 / 1.01, rtol=0.02)
    base = Errors(truth, singles=[truth + 5**0.5], means=[truth + 1], wall=[1.5], cpu=[10.0])
    cells = dict(zip(HEAD, row("a", found, base), strict=True))
    assert (cells["one"], cells["ms"], cells["cpu ms"], cells["rays"]) == ("2.48", "3.00", "5.00", "2.50")
    assert (cells["one / PT"], cells["one / PT, cpu"]) == ("1.00", "0.25")
    assert (cells["mean / PT"], cells["mean / PT, cpu"]) == ("0.20", "0.05")
    runs[0][:100] = 9.0
    assert np.isclose(replace(found, pixels=np.arange(200)[:, None] * np.ones(200) >= 100).many, 0.1 / 1.01, rtol=0.01)
    assert row("b", base, base)[HEAD.index("noise of it")] == ""


def test_settings_of_the_script():
    assert read_settings([]) == Settings()
    expected = Settings.preset("solari")
    expected.di = False
    assert read_settings(["solari", "di=off"]) == expected
    with pytest.raises(SolariError, match="name=value"):
        read_settings(["di=off", "solari"])
