"""The swapchain of a window: images are acquired, presented, and made again when they no longer fit the window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.submission import Submission

FRAMES = 2  # maximum number of frames in flight
_ACQUIRE_TIMEOUT = 100_000_000  # nanoseconds: a hidden window may get no image for a long time
# The pictures are already encoded as sRGB, so formats that would encode them again don't fit.
_FORMATS = (raw.VK_FORMAT_B8G8R8A8_UNORM, raw.VK_FORMAT_R8G8B8A8_UNORM)
_USAGE = raw.VK_IMAGE_USAGE_TRANSFER_DST_BIT | raw.VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT


class Swapchain:
    """The images of a window's surface. A context manager; `close` it before the window.

    create_surface: makes a VkSurfaceKHR of the window from a VkInstance; called again when the surface is lost.
    get_size: returns the window's size in pixels, (0, 0) while the window is minimized.
    Raises DeviceError if the device can't present to this window.

    `acquire` returns the index of an image to draw; `present` must follow. `generation` is incremented when `images`,
    `views` and `extent` are replaced; no work uses the old ones then.
    """

    def __init__(
        self, device: Device, create_surface: Callable[[raw.CData], raw.CData], get_size: Callable[[], tuple[int, int]]
    ) -> None:
        if "VK_KHR_swapchain" not in device.extensions:
            raise DeviceError(f"{device.name} can't show pictures in windows: it has no VK_KHR_swapchain")
        self.device = device
        self.generation = 0
        self.extent = (0, 0)
        self.images: list[raw.CData] = []
        self.views: list[raw.CData] = []
        self.stale = True
        """Whether the next `acquire` makes the images again."""
        self._create_surface = create_surface
        self._get_size = get_size
        self._surface: raw.CData = None
        self._surface_lost = False
        self._made_for = (0, 0)
        self._handle: raw.CData = raw.NULL
        self._index = raw.ffi.new("uint32_t*")
        self._acquired: list[raw.CData] = []  # per frame in flight: signaled when its image may be drawn
        self._drawn: list[raw.CData] = []  # per image: signaled when it may be presented
        # The commands of a frame may be recorded again once the frame before that used the slot is done.
        self._values = [0] * FRAMES  # timeline values of the frames in flight
        self._frame = 0
        self._submissions: dict[Any, Submission] = {}
        self._token = device.register(self._destroy)
        try:
            self._make_surface()
        except BaseException:
            self.close()
            raise

    # ---- a frame ------------------------------------------------------------------------------------

    @property
    def slot(self) -> int:
        """The number, below FRAMES, of the frame that `acquire` began. The earlier frames of this number are done."""
        return self._frame

    def acquire(self) -> int | None:
        """The index of an image to draw, or None while the window can't show one."""
        if self._surface_lost:
            self._make_surface()
        if self.stale or self._get_size() != self._made_for:
            self._make()
        if self._handle == raw.NULL:
            return None
        self._frame = (self._frame + 1) % FRAMES
        self.device.await_value(self._values[self._frame])
        result = self._call(
            "vkAcquireNextImageKHR",
            self.device.handle,
            self._handle,
            _ACQUIRE_TIMEOUT,
            self._acquired[self._frame],
            raw.NULL,
            self._index,
        )
        # A suboptimal image is acquired and must be presented; the next frame makes the swapchain again.
        if result not in (raw.VK_SUCCESS, raw.VK_SUBOPTIMAL_KHR):
            return None
        return int(self._index[0])

    def present(self, index: int, commands: Sequence[raw.CData]) -> int:
        """Submit the commands that draw an acquired image, and present it; returns the timeline value of the drawing.

        When the commands start, the image is in an undefined layout and unused; they must leave it in PRESENT_SRC.
        """
        # One semaphore an image, not a frame: only the acquisition of the same image tells that its presentation no
        # longer waits for it (Khronos' guide "Swapchain Semaphore Reuse").
        wait, signal = self._acquired[self._frame], self._drawn[index]
        key = index, self._frame, *(int(raw.ffi.cast("uintptr_t", item)) for item in commands)
        if key not in self._submissions:
            self._submissions[key] = self.device.submission(commands, waits=[wait], signals=[signal])
        value = self._values[self._frame] = self.device.submit_prepared(self._submissions[key])
        info = raw.struct(
            "VkPresentInfoKHR",
            waitSemaphoreCount=1,
            pWaitSemaphores=[signal],
            swapchainCount=1,
            pSwapchains=[self._handle],
            pImageIndices=[index],
        )
        self._call("vkQueuePresentKHR", self.device.queue, info)
        return value

    def _call(self, name: str, *arguments: Any) -> int:
        """Call a function; returns its VkResult. An outdated or lost surface only makes the swapchain stale."""
        pointer = raw.lib.vkGetInstanceProcAddr(self.device.instance, name.encode())
        result: int = raw.ffi.cast("PFN_" + name, pointer)(*arguments)
        if result in (raw.VK_ERROR_OUT_OF_DATE_KHR, raw.VK_SUBOPTIMAL_KHR):
            self.stale = True
        elif result == raw.VK_ERROR_SURFACE_LOST_KHR:
            self.stale = self._surface_lost = True
        elif result == raw.VK_ERROR_DEVICE_LOST:
            self.device.lost = True
            raw.check(result, name)
        else:
            raw.check(result, name)
        return result

    # ---- making -------------------------------------------------------------------------------------

    def _make_surface(self) -> None:
        """Make the surface, in place of a lost one; the next `acquire` makes the swapchain."""
        self._destroy()
        device = self.device
        self._surface = self._create_surface(device.instance)
        supported = raw.ffi.new("VkBool32*")
        device.instance_vk.vkGetPhysicalDeviceSurfaceSupportKHR(
            device.physical_device, device.queue_family, self._surface, supported
        )
        if not supported[0]:
            raise DeviceError(f"{device.name} can't present to this window: choose another device")
        self.stale = True
        self._surface_lost = False

    def _make(self) -> None:
        """Make the images for the window's current size; none while its size is zero."""
        device = self.device
        self.stale = True  # until all succeeded: after a failure the next `acquire` tries again
        capabilities = raw.ffi.new("VkSurfaceCapabilitiesKHR*")
        query = "vkGetPhysicalDeviceSurfaceCapabilitiesKHR"
        if self._call(query, device.physical_device, self._surface, capabilities) != raw.VK_SUCCESS:
            return
        size = self._made_for = self._get_size()
        # Wayland gives this extent, which means that the swapchain decides; elsewhere the surface does.
        current = capabilities.currentExtent
        if current.width != 0xFFFFFFFF and 0 not in size:
            size = (current.width, current.height)
        low, high = capabilities.minImageExtent, capabilities.maxImageExtent
        extent = min(max(size[0], low.width), high.width), min(max(size[1], low.height), high.height)
        # The new swapchain takes over from the old one, so that the window doesn't flicker. Its creation retires the
        # old one even if it fails, so the old one is destroyed in any case.
        old, self._handle = self._handle, raw.NULL
        try:
            if 0 not in size and 0 not in extent:
                self._create(capabilities, extent, old)
        finally:
            self._destroy_images(old)
        if self._handle != raw.NULL:
            self._create_views()
            self.extent = extent
            self.generation += 1
            self.stale = False

    def _create(self, capabilities: raw.CData, extent: tuple[int, int], old: raw.CData) -> None:
        device = self.device
        if not capabilities.supportedUsageFlags & raw.VK_IMAGE_USAGE_TRANSFER_DST_BIT:
            raise DeviceError(f"{device.name} can't copy pictures to this window: choose another device")
        self.format, color_space = self._choose_format()
        self.readable = bool(capabilities.supportedUsageFlags & raw.VK_IMAGE_USAGE_TRANSFER_SRC_BIT)
        # One more than the presentation engine may hold, so that acquiring doesn't wait for the display. A maximum of
        # 0 means that there is none.
        count = max(capabilities.minImageCount, FRAMES) + 1
        opaque = raw.VK_COMPOSITE_ALPHA_OPAQUE_BIT_KHR
        alphas = capabilities.supportedCompositeAlpha
        create = raw.struct(
            "VkSwapchainCreateInfoKHR",
            surface=self._surface,
            minImageCount=min(count, capabilities.maxImageCount or count),
            imageFormat=self.format,
            imageColorSpace=color_space,
            imageExtent={"width": extent[0], "height": extent[1]},
            imageArrayLayers=1,
            imageUsage=_USAGE | (raw.VK_IMAGE_USAGE_TRANSFER_SRC_BIT if self.readable else 0),
            imageSharingMode=raw.VK_SHARING_MODE_EXCLUSIVE,
            preTransform=capabilities.currentTransform,
            compositeAlpha=opaque if alphas & opaque else alphas & -alphas,  # or the lowest bit that is set
            # The one mode that all devices have; it waits for the display, and so limits the frame rate.
            presentMode=raw.VK_PRESENT_MODE_FIFO_KHR,
            clipped=1,
            oldSwapchain=old,
        )
        out = raw.ffi.new("VkSwapchainKHR*")
        if self._call("vkCreateSwapchainKHR", device.handle, create, raw.NULL, out) == raw.VK_SUCCESS:
            self._handle = out[0]

    def _choose_format(self) -> tuple[int, int]:
        device = self.device
        arguments = (device.physical_device, self._surface)
        function = device.instance_vk.vkGetPhysicalDeviceSurfaceFormatsKHR
        items = raw.enumerate_items(function, "VkSurfaceFormatKHR", *arguments)
        offered = {(item.format, item.colorSpace) for item in items}
        for format in _FORMATS:
            if (format, raw.VK_COLOR_SPACE_SRGB_NONLINEAR_KHR) in offered:
                return format, raw.VK_COLOR_SPACE_SRGB_NONLINEAR_KHR
        raise DeviceError(f"{device.name}: this window has no 8-bit sRGB format: choose another device")

    def _create_views(self) -> None:
        """Create a view and a semaphore of each of the new swapchain's images."""
        device = self.device
        function = device.vk.vkGetSwapchainImagesKHR
        self.images = raw.enumerate_items(function, "VkImage", device.handle, self._handle)
        whole = {"aspectMask": raw.VK_IMAGE_ASPECT_COLOR_BIT, "levelCount": 1, "layerCount": 1}
        semaphore = raw.struct("VkSemaphoreCreateInfo")
        for index, image in enumerate(self.images):
            create = raw.struct(
                "VkImageViewCreateInfo",
                image=image,
                viewType=raw.VK_IMAGE_VIEW_TYPE_2D,
                format=self.format,
                subresourceRange=whole,
            )
            self.views.append(device.create("VkImageView", create, f"window {index}"))
            self._drawn.append(device.create("VkSemaphore", semaphore, f"window {index} drawn"))
        for frame in range(FRAMES):
            self._acquired.append(device.create("VkSemaphore", semaphore, f"window frame {frame} acquired"))

    # ---- lifetime -----------------------------------------------------------------------------------

    def _destroy_images(self, handle: raw.CData) -> None:
        """Destroy a swapchain, its images' views and all semaphores, after waiting for the work that uses them."""
        device = self.device
        if handle == raw.NULL:
            return
        with suppress(DeviceError):  # Vulkan ends this wait on a lost device too, by an error
            device.vk.vkQueueWaitIdle(device.queue)
        for view in self.views:
            device.vk.vkDestroyImageView(device.handle, view, raw.NULL)
        for semaphore in (*self._drawn, *self._acquired):
            device.vk.vkDestroySemaphore(device.handle, semaphore, raw.NULL)
        device.vk.vkDestroySwapchainKHR(device.handle, handle, raw.NULL)
        self.images = []
        self.views = []
        self._drawn = []
        self._acquired = []
        self._submissions.clear()
        self._values = [0] * FRAMES
        self.extent = (0, 0)

    def _destroy(self) -> None:
        handle, self._handle = self._handle, raw.NULL
        self._destroy_images(handle)
        if self._surface is not None:
            self.device.instance_vk.vkDestroySurfaceKHR(self.device.instance, self._surface, raw.NULL)
            self._surface = None

    def close(self) -> None:
        """Wait for the device and destroy everything, including the surface. Safe to call twice."""
        if self.device.lost:
            self._destroy()  # a lost device releases nothing until it closes, which is too late for the window
        elif not self.device.closed:
            self.device.vk.vkQueueWaitIdle(self.device.queue)
        self.device.release(self._token)

    def __enter__(self) -> Swapchain:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
