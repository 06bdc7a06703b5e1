"""The viewer in windows of an X server: they show the rendered picture, also after resizes, failures and closing."""

from __future__ import annotations

import time
from contextlib import nullcontext
from unittest.mock import MagicMock

import glfw
import numpy as np
import pytest
from PIL import Image, ImageGrab

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.gpu.device import raw
from solari_vk.studio.viewer import presenter
from solari_vk.studio.viewer.layout import Layout
from solari_vk.studio.viewer.presenter import Part
from solari_vk.studio.viewer.window import Window

ACQUIRE = "vkAcquireNextImageKHR"
PRESENT = "vkQueuePresentKHR"
CREATE = "vkCreateSwapchainKHR"


class Vulkan:
    """Stands for raw.lib. Notes which functions a swapchain calls, and lets those in `failures` fail once."""

    def __init__(self, lib):
        self.lib = lib
        self.calls = []
        self.failures = {}
        self._kept = []

    def __getattr__(self, name):
        return getattr(self.lib, name)

    def fail(self, function, result, *, happens=False):
        """The next call reports this result. happens: the function is called all the same."""
        self.failures[function] = result, happens

    def vkGetInstanceProcAddr(self, instance, name):
        pointer, function = self.lib.vkGetInstanceProcAddr(instance, name), name.decode()
        self.calls.append(function)
        if function not in self.failures:
            return pointer
        result, happens = self.failures.pop(function)
        call = raw.ffi.cast("PFN_" + function, pointer)

        def fail(*arguments):
            if happens:
                call(*arguments)
            return result

        self._kept.append(raw.ffi.callback(raw.ffi.typeof(call), fail))
        return raw.ffi.cast("PFN_vkVoidFunction", self._kept[-1])


@pytest.fixture
def vulkan(monkeypatch):
    made = Vulkan(raw.lib)
    monkeypatch.setattr(raw, "lib", made)
    return made


def grab(viewer, screen):
    """The pixels of the screen in the window's area."""
    viewer.device.wait_idle()
    time.sleep(0.3)  # the server draws asynchronously
    x, y = glfw.get_window_pos(viewer.window.handle)
    width, height = viewer.window.size
    return np.asarray(ImageGrab.grab(bbox=(x, y, x + width, y + height), xdisplay=screen))


def stretched(pixels, size):
    """Bilinear filtering with texel centers at + 0.5 and clamped edges, which is how Vulkan's linear blits filter."""
    channels = np.moveaxis(pixels.astype(np.float32), -1, 0)
    return np.stack([np.asarray(Image.fromarray(c).resize(size, Image.Resampling.BILINEAR)) for c in channels], axis=-1)


def test_the_screen_shows_the_rendered_picture(viewer, screen):
    shown = grab(viewer, screen)
    assert shown.shape == (64, 96, 3)
    assert shown.max() > 100
    assert (shown == viewer.pictures.pixels()).all()
    assert (viewer.capture() == shown).all()
    for size in ((150, 40), (1, 1), (200, 150)):
        glfw.set_window_size(viewer.window.handle, *size)
        viewer.run(frames=3)
        assert viewer.pictures.size == size
        assert viewer.capture().shape == (size[1], size[0], 3)
    assert (grab(viewer, screen) == viewer.pictures.pixels()).all()


@pytest.mark.slow  # they are compiled for half a minute
def test_the_screen_shows_what_ray_pipelines_render(screen):
    with (
        sv.Device(validation=True, rays="pipeline") as device,
        sv.Viewer(device, sv.builtin("cornell_box"), size=(96, 64), scale=1.0, overlay=False) as viewer,
    ):
        for viewer.pictures.mode in ("realtime", "reference"):
            viewer.run(frames=3)
            shown = grab(viewer, screen)
            assert shown.max() > 100
            assert (shown == viewer.pictures.pixels()).all()


@pytest.mark.parametrize("by_command", [False, True])
def test_objects_are_framed_for_the_picture_beside_the_panels(open_viewer, monkeypatch, tmp_path, by_command):
    def wide():
        return sv.Scene(sv.Instance(sv.shapes.box((-2, 0, -1), (2, 1, 1))))

    if by_command:
        wide().save(tmp_path / "wide.glb")
        given = {}
        monkeypatch.setattr(sv, "Viewer", lambda *_, **options: given.update(options) or nullcontext(MagicMock()))
        assert main(["view", str(tmp_path / "wide.glb"), "--size", "320x180", "--frames", "1"]) == 0
        camera = given["camera"]
    else:
        scene = wide()
        camera = open_viewer(scene, size=(320, 180)).camera
        assert camera.transform.tolist() == scene.camera.transform.tolist()
    area = Layout.of((320, 180), panels=True).picture
    assert area.width < 1.2 * area.height
    np.testing.assert_allclose(camera.transform, wide().camera_for(area.width / area.height).transform, atol=1e-6)


def test_small_pictures_are_stretched(open_viewer, screen):
    viewer = open_viewer(overlay=False, scale=0.25)
    viewer.run(frames=2)
    pixels = viewer.pictures.pixels()
    assert pixels.shape == (16, 24, 3)
    assert grab(viewer, screen) == pytest.approx(stretched(pixels, (96, 64)), abs=1.0)


def test_parts_side_by_side_are_where_they_are_in_the_whole(open_viewer, monkeypatch):
    viewer = open_viewer(overlay=False, scale=0.37)
    viewer.run(frames=2)
    [whole] = viewer.pictures.parts()
    assert whole.image.width == 36
    shown = viewer.capture()
    for divider in (0.0, 0.01, 0.02, 0.4, 0.5, 0.99, 1.0):
        parts = [Part(whole.image, 0, divider), Part(whole.image, divider, 1)]
        monkeypatch.setattr(viewer.pictures, "parts", lambda parts=parts: parts)
        assert (viewer.capture() == shown).all(), divider


def test_the_window_waits_for_the_picture(open_viewer, monkeypatch):
    viewer = open_viewer(overlay=False)
    barriers = []
    for name in ("full_barrier", "layout_barrier"):
        make = getattr(presenter, name)
        monkeypatch.setattr(presenter, name, lambda *given, n=name, f=make: (barriers.append(n), f(*given))[1])
    viewer.run(frames=1)
    assert barriers[:2] == ["full_barrier", "layout_barrier"], "a barrier of the window's image orders no other memory"


def test_hidden_windows_wait(viewer, monkeypatch):
    monkeypatch.setattr(Window, "pixels", (0, 0))
    assert not viewer.step()
    viewer.run(frames=2)
    assert viewer.frame_count == 2
    with pytest.raises(sv.SolariError, match="shows no frame"):
        viewer.capture()
    monkeypatch.undo()
    viewer.run(frames=2)
    assert (viewer.capture() == viewer.pictures.pixels()).all()


# ---- failures ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [ACQUIRE, PRESENT, CREATE])
def test_failures_that_need_a_new_swapchain_are_no_errors(viewer, vulkan, function):
    """What acquires or presents is called, but reported as failed, which is the harder case."""
    for width, failure in enumerate(("SURFACE_LOST_KHR", "OUT_OF_DATE_KHR", "SUBOPTIMAL_KHR"), 100):
        result = getattr(raw, f"VK_ERROR_{failure}" if failure != "SUBOPTIMAL_KHR" else f"VK_{failure}")
        vulkan.fail(function, result, happens=function != CREATE)
        if function == CREATE:
            glfw.set_window_size(viewer.window.handle, width, 50)
            viewer.run(frames=20)
        viewer.run(frames=1)
        assert not vulkan.failures, "the call failed once"
        vulkan.calls.clear()
        viewer.run(frames=3)
        assert CREATE in vulkan.calls or function == CREATE, failure
        assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_other_failures_are_errors_and_the_next_frames_are_shown(viewer, vulkan, monkeypatch):
    for width, function in enumerate((ACQUIRE, PRESENT, CREATE, "vkGetSwapchainImagesKHR"), 100):
        glfw.set_window_size(viewer.window.handle, width, 50)
        with monkeypatch.context() as patch:
            if function in (ACQUIRE, PRESENT, CREATE):
                vulkan.fail(function, raw.VK_ERROR_OUT_OF_DEVICE_MEMORY)
            else:
                vk = viewer._presenter.device.vk
                patch.setattr(vk, function, lambda *_: raw.check(raw.VK_ERROR_OUT_OF_DEVICE_MEMORY, ""))
            with pytest.raises(sv.DeviceError, match="out of memory"):
                viewer.run(frames=20)
        viewer.run(frames=2)
        assert viewer.capture().shape == (50, width, 3)
        assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_capture_makes_several_attempts(viewer, vulkan, monkeypatch):
    vulkan.fail(ACQUIRE, raw.VK_TIMEOUT)
    assert (viewer.capture() == viewer.pictures.pixels()).all()
    assert vulkan.calls.count(ACQUIRE) == 2
    vulkan.fail(PRESENT, raw.VK_ERROR_OUT_OF_DEVICE_MEMORY)
    with pytest.raises(sv.DeviceError, match="memory"):  # `open_viewer` checks that this leaves nothing on the device
        viewer.capture()


def test_a_picture_that_stays_is_copied_once(viewer, device, monkeypatch):
    if device.properties.kind != "cpu":
        pytest.skip("a graphics card draws the window itself")
    copied = []
    copy = presenter.pixels_of
    monkeypatch.setattr(presenter, "pixels_of", lambda parts: copied.append(parts) or copy(parts))
    viewer.run(frames=2)
    rendered = len(copied)
    assert rendered > 0
    for _ in range(3):
        viewer._presenter.show(viewer._renderer.parts(), viewer._draw)
    assert len(copied) == rendered
    viewer.run(frames=1)
    assert len(copied) == rendered + 1


@pytest.mark.parametrize("lost", [False, True])
def test_the_device_may_close_or_be_lost_before_the_viewer(screen, monkeypatch, lost):
    """The surface of a lost device is destroyed before its window."""
    device = sv.Device(validation=True)
    viewer = sv.Viewer(device, sv.builtin("cornell_box"), size=(64, 48), mode="reference", scale=0.5)
    viewer.run(frames=2)
    order = []
    window_device = viewer._presenter.device  # on a processor another one
    for owner, name in ((glfw, "destroy_window"), (window_device.instance_vk, "vkDestroySurfaceKHR")):
        call = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *given, n=name, f=call: (order.append(n), f(*given)))
    if lost:
        for each in (device, window_device):
            each.wait_idle()
            each.lost = True
    else:
        device.close()
    viewer.close()
    device.close()
    assert order == ["vkDestroySurfaceKHR", "destroy_window"]


# ---- closing ----------------------------------------------------------------------------------------


def test_closing_at_any_moment(open_viewer):
    for frames in (0, 1, 2):
        viewer = open_viewer()
        viewer.run(frames=frames)
        viewer.close()
        viewer.close()


def test_closing_in_the_middle_of_a_frame(open_viewer):
    viewer = open_viewer()

    def on_frame(viewer, seconds):
        assert seconds >= 0
        viewer.window.wants_to_close = viewer.frame_count == 2

    viewer.run(on_frame)
    assert viewer.frame_count == 2
    viewer.window.wants_to_close = False
    with pytest.raises(ZeroDivisionError):
        viewer.run(lambda viewer, seconds: 1 / 0)
    viewer.run(lambda viewer, seconds: viewer.close(), frames=3)
    assert (viewer.frame_count, viewer.window.pixels, viewer.window.wants_to_close) == (2, (0, 0), True)
    viewer.run()
    for call in (viewer.step, viewer.capture, lambda: viewer.window.size, lambda: viewer.window.clipboard):
        with pytest.raises(sv.SolariError, match="closed"):
            call()


def test_two_viewers_at_a_time(open_viewer):
    first, second = open_viewer(overlay=False), open_viewer(size=(64, 64))
    for _ in range(3):
        first.step()
        second.step()
    assert (first.capture() == first.pictures.pixels()).all()
    second.close()
    first.run(frames=1)


def test_fullscreen(open_viewer, screen):
    viewer = open_viewer(overlay=False, scale=0.1)
    for size in ((480, 360), (96, 64)):
        viewer.act("fullscreen")
        viewer.run(frames=4)
        assert viewer.window.pixels == size
        assert viewer.capture().shape == (size[1], size[0], 3)


def test_wrong_options_are_refused(device, screen):
    sizes = ((-1, 5), (64.5, 3), (64,), 5, (2**31, 2))
    wrong = [({"mode": "fast"}, "mode"), ({"scale": 3}, "scale"), ({"fps": 0}, "fps")]
    for options, words in (*wrong, *(({"size": size}, "whole numbers") for size in sizes)):
        with pytest.raises(sv.SolariError, match=words):
            sv.Viewer(device, sv.builtin("cornell_box"), **{"size": (64, 64), **options})


def test_no_screen_is_a_plain_error(device, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9999")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(sv.SolariError, match="no window can be opened"):
        sv.Viewer(device, sv.builtin("cornell_box"))
