"""The viewer in windows of an X server: they show the rendered picture, also after resizes, failures and closing."""

from __future__ import annotations

import time

import glfw
import numpy as np
import pytest
from PIL import Image, ImageGrab

import solari_vk as sv
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.swapchain import Swapchain
from solari_vk.viewer import Window, presenter
from solari_vk.viewer.presenter import Part


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


def no_memory(*_):
    raise sv.DeviceError("no more memory")


def test_the_screen_shows_the_rendered_picture(viewer, screen):
    shown = grab(viewer, screen)
    assert shown.shape == (64, 96, 3)
    assert shown.max() > 100
    assert (shown == viewer.pictures.pixels()).all()
    assert (viewer.capture() == shown).all()


@pytest.mark.parametrize("mode", ["realtime", "reference"])
def test_the_screen_shows_what_ray_pipelines_render(screen, mode):
    with (
        sv.Device(validation=True, rays="pipeline") as device,
        sv.Viewer(device, sv.builtin("cornell_box"), size=(96, 64), mode=mode, scale=1.0, overlay=False) as viewer,
    ):
        viewer.run(frames=4)
        shown = grab(viewer, screen)
        assert shown.max() > 100
        assert (shown == viewer.pictures.pixels()).all()


def test_small_pictures_are_stretched(open_viewer, screen):
    viewer = open_viewer(overlay=False, scale=0.25)
    viewer.run(frames=2)
    pixels = viewer.pictures.pixels()
    assert pixels.shape == (16, 24, 3)
    assert grab(viewer, screen) == pytest.approx(stretched(pixels, (96, 64)), abs=1.0)


def test_parts_side_by_side_are_where_they_are_in_the_whole(open_viewer):
    viewer = open_viewer(overlay=False, scale=0.37)
    viewer.run(frames=2)
    [whole] = viewer.pictures.parts()
    assert whole.image.width == 36
    shown = viewer._presenter.capture([whole], viewer._draw)
    for divider in (0.0, 0.01, 0.02, 0.4, 0.5, 0.99, 1.0):
        parts = [Part(whole.image, 0, divider), Part(whole.image, divider, 1)]
        assert (viewer._presenter.capture(parts, viewer._draw) == shown).all(), divider


def test_the_window_waits_for_the_picture(open_viewer, monkeypatch):
    viewer = open_viewer(overlay=False)
    barriers = []
    for name in ("full_barrier", "layout_barrier"):
        make = getattr(presenter, name)
        monkeypatch.setattr(presenter, name, lambda *given, n=name, f=make: (barriers.append(n), f(*given))[1])
    viewer.run(frames=1)
    assert barriers[:2] == ["full_barrier", "layout_barrier"], "a barrier of the window's image orders no other memory"


def test_windows_are_resized(viewer, screen):
    for size in ((150, 40), (33, 71), (1, 1), (200, 150)):
        glfw.set_window_size(viewer.window.handle, *size)
        viewer.run(frames=3)
        assert viewer.pictures.size == size
        assert viewer.capture().shape == (size[1], size[0], 3)
    assert (grab(viewer, screen) == viewer.pictures.pixels()).all()


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


@pytest.mark.parametrize("function", ["vkAcquireNextImageKHR", "vkQueuePresentKHR", "vkCreateSwapchainKHR"])
@pytest.mark.parametrize("failure", ["VK_ERROR_SURFACE_LOST_KHR", "VK_ERROR_OUT_OF_DATE_KHR", "VK_SUBOPTIMAL_KHR"])
def test_failures_that_need_a_new_swapchain_are_no_errors(viewer, monkeypatch, function, failure):
    """The function is called, but reported as failed, which is the harder case: the image is then acquired."""
    before = viewer._swapchain.generation
    look_up = raw.lib.vkGetInstanceProcAddr
    left = [function]

    class Lib:
        def __getattr__(self, name):
            return getattr(raw_lib, name)

        @staticmethod
        def vkGetInstanceProcAddr(instance, name):
            pointer = look_up(instance, name)
            if left and name.decode() == function:
                left.clear()
                call = raw.ffi.cast("PFN_" + function, pointer)
                fakes.append(raw.ffi.callback(raw.ffi.typeof(call), lambda *arguments: fail(call, arguments)))
                return raw.ffi.cast("PFN_vkVoidFunction", fakes[-1])
            return pointer

    def fail(call, arguments):
        if function != "vkCreateSwapchainKHR":
            call(*arguments)
        return getattr(raw, failure)

    fakes, raw_lib = [], raw.lib
    if function == "vkCreateSwapchainKHR":
        viewer._swapchain.stale = True
    monkeypatch.setattr(raw, "lib", Lib())
    viewer.run(frames=1)
    monkeypatch.undo()
    assert not left, "the call failed once"
    viewer.run(frames=3)
    assert viewer._swapchain.generation > before
    assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_other_failures_are_errors(viewer, monkeypatch):
    failure = raw.VK_ERROR_OUT_OF_DEVICE_MEMORY
    monkeypatch.setattr(Swapchain, "_call", lambda *_: raw.check(failure, "vkQueuePresentKHR"))
    with pytest.raises(sv.DeviceError, match="out of memory"):
        viewer.step()
    monkeypatch.undo()
    viewer.run(frames=2)
    assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_a_swapchain_that_could_not_be_made_is_made_later(viewer, monkeypatch):
    for name in ("_create", "_take_images"):
        size = (70, 40) if name == "_create" else (50, 60)
        monkeypatch.setattr(Swapchain, name, no_memory)
        glfw.set_window_size(viewer.window.handle, *size)
        with pytest.raises(sv.DeviceError, match="memory"):
            viewer.run(frames=20)
        monkeypatch.undo()
        viewer.run(frames=2)
        assert viewer.capture().shape == (size[1], size[0], 3)


def test_capture_makes_several_attempts(viewer, monkeypatch):
    acquire, refused = viewer._swapchain.acquire, [None, None]
    monkeypatch.setattr(viewer._swapchain, "acquire", lambda: refused.pop() if refused else acquire())
    assert (viewer.capture() == viewer.pictures.pixels()).all()
    monkeypatch.setattr(viewer._swapchain, "present", no_memory)
    with pytest.raises(sv.DeviceError, match="memory"):  # `open_viewer` checks that this leaves nothing on the device
        viewer.capture()


def test_a_viewer_of_a_lost_device_closes_its_surface_before_the_window(screen, monkeypatch):
    device = sv.Device(validation=True)
    viewer = sv.Viewer(device, sv.builtin("cornell_box"), size=(64, 48), mode="reference", scale=0.5)
    viewer.run(frames=2)
    device.wait_idle()
    device.lost = True
    order = []
    window, destroy = glfw.destroy_window, viewer._swapchain._destroy
    monkeypatch.setattr(glfw, "destroy_window", lambda handle: (order.append("window"), window(handle)))
    monkeypatch.setattr(viewer._swapchain, "_destroy", lambda: (order.append("surface"), destroy()))
    viewer.close()
    assert order == ["surface", "window"]
    device.close()


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_closing_at_any_moment(open_viewer, frames):
    viewer = open_viewer()
    viewer.run(frames=frames)
    viewer.close()
    viewer.close()


def test_closing_in_the_middle_of_a_frame(open_viewer):
    viewer = open_viewer()

    def on_frame(viewer, seconds):
        assert seconds >= 0
        if viewer.frame_count == 2:
            viewer.window.wants_to_close = True

    viewer.run(on_frame)
    assert viewer.frame_count == 2

    def fail(viewer, seconds):
        raise RuntimeError("raised by the caller")

    viewer.window.wants_to_close = False
    with pytest.raises(RuntimeError, match="caller"):
        viewer.run(fail)


def test_closed_viewers_raise_clear_errors(open_viewer):
    viewer = open_viewer()
    viewer.run(lambda viewer, seconds: viewer.close(), frames=3)
    assert (viewer.frame_count, viewer.window.pixels, viewer.window.wants_to_close) == (0, (0, 0), True)
    viewer.run()
    for call in (viewer.step, viewer.capture, lambda: viewer.window.size, lambda: viewer.window.clipboard):
        with pytest.raises(sv.SolariError, match="closed"):
            call()


def test_the_device_may_close_first(screen):
    device = sv.Device(validation=True)
    viewer = sv.Viewer(device, sv.builtin("cornell_box"), size=(64, 48), mode="reference", scale=0.5)
    viewer.run(frames=2)
    device.close()
    viewer.close()


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
    sizes = ((-1, 5), (0, 0), (64.5, 3), (64,), 5, (2**31, 2), None)
    wrong = [({"mode": "fast"}, "mode"), ({"scale": 3}, "scale"), ({"fps": 0}, "fps")]
    for options, words in (*wrong, *(({"size": size}, "whole numbers") for size in sizes)):
        with pytest.raises(sv.SolariError, match=words):
            sv.Viewer(device, sv.builtin("cornell_box"), **{"size": (64, 64), **options})


def test_no_screen_is_a_plain_error(device, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":9999")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(sv.SolariError, match="no window can be opened"):
        sv.Viewer(device, sv.builtin("cornell_box"))
