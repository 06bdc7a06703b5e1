"""What everything that works on a scene shares: the scene on the device, lifetime, and the size of a picture."""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar, Protocol, Self, TypeVar

from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration.checks import check_kind
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Row, Stage
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Scene


class Closable(Protocol):
    """Something that frees what it holds."""

    def close(self) -> None: ...


Owned = TypeVar("Owned", bound=Closable)


class SceneUser:
    """Works on a scene that a SceneBinder holds on the device. A context manager.

    scene: a Scene, whose binder this object makes and frees; or a SceneBinder, which stays the caller's, so that
    several users of one scene hold it on the device once. The scene may be edited at any time.
    Raises SolariError for a device or a scene of the wrong type.
    """

    def __init__(self, device: Device, scene: Scene | SceneBinder) -> None:
        what = type(self).__name__
        self.device = _checked_device(device, what)
        check_kind(scene, (Scene, SceneBinder), f"{what}: the scene", "give a solari_vk.Scene, or a SceneBinder")
        self._owned = ExitStack()
        if isinstance(scene, SceneBinder):
            self.binder = scene
        else:
            self.binder = SceneBinder(device, scene)
            self._owned.callback(self.binder.destroy)

    def _own(self, item: Owned) -> Owned:
        """Have `close` close an object too, before those that it already owns; returns the object."""
        self._owned.callback(item.close)
        return item

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SceneFrame(SceneUser, Frame):
    """Passes of one's own over a scene: shaders that include "scene/bindings.glsl" find it in descriptor set 0.

    Each `submit` takes up the scene's edits first. `external` and all other options are those of `Frame`; glsl_root is
    the folder (or folders) of one's own shaders, which may include the package's by their paths.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        stages: Sequence[Stage],
        *,
        external: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        SceneUser.__init__(self, device, scene)
        try:
            self.binder.update()
            self._bound_version = self.binder.version
            Frame.__init__(self, device, stages, external={**self.binder.resources, **(external or {})}, **options)
        except BaseException:
            self._owned.close()
            raise

    def rebuild(self, stages: Sequence[Stage] | None = None, external: Mapping[str, Any] | None = None) -> None:
        """Do what `Frame.rebuild` does; external resources come on top of the scene's."""
        super().rebuild(stages, None if external is None else {**self.binder.resources, **external})

    def submit(self, before: Sequence[raw.CData] = ()) -> int:
        """Take up the scene's edits and run the next frame; returns the device's timeline value."""
        self.binder.update()
        if self.binder.version != self._bound_version:
            self._bound_version = self.binder.version
            self.bind(self.binder.resources)
        return super().submit(before)

    def close(self) -> None:
        """Free everything. Safe to call twice."""
        Frame.close(self)
        SceneUser.close(self)


class PictureRenderer(SceneUser, ABC):
    """Renders pictures of one size by a frame of stages.

    A subclass makes `_frame` in its constructor and says by `_stages` what the frame is for a size.
    size: (width, height) in pixels. Raises SolariError for a size that the device can't hold.
    """

    LARGEST_PIXEL_BYTES: ClassVar[int]  # of one pixel in any one buffer
    IN_IMAGES: ClassVar[bool]  # whether the picture is in images, whose width and height the device limits
    _frame: SceneFrame

    def __init__(self, device: Device, scene: Scene | SceneBinder, size: tuple[int, int]) -> None:
        self.device = _checked_device(device, type(self).__name__)
        self.size = self._checked_size(size)
        super().__init__(device, scene)
        try:
            self.binder.update()
        except BaseException:
            self._owned.close()
            raise

    @abstractmethod
    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        """What happens in a frame, in this order."""

    @abstractmethod
    def resize(self, size: tuple[int, int]) -> None:
        """Change the picture's size, (width, height) in pixels; the picture starts anew.

        Raises SolariError for a size that the device can't hold; the size then stays as it was.
        """

    def reload(self) -> None:
        """Take up changed shaders. Raises CompilationError when one can't be compiled; the old ones then stay."""
        self._frame.rebuild()

    @abstractmethod
    def reset(self) -> None:
        """Forget all earlier frames, as after a cut."""

    def resource(self, name: str) -> Any:
        """The Buffer or Image that a name of the shaders meant in the latest frame."""
        return self._frame.resource(name)

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each pass in the latest finished frame."""
        return self._frame.timings

    def describe(self) -> list[Row]:
        """The frame's passes: what they read and write, the barriers before them and why, and their GPU times."""
        return self._frame.describe()

    def _checked_camera(self, camera: Camera) -> Camera:
        if not isinstance(camera, Camera):
            raise SolariError(f"{type(self).__name__}: a Camera is needed, not {camera!r}")
        return camera

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        what = type(self).__name__
        try:
            width, height = (operator.index(n) for n in size)
        except (TypeError, ValueError):
            raise SolariError(f"{what}: size must be two whole numbers (width, height), not {size!r}") from None
        limits = self.device.properties.limits
        max_pixels = limits.maxStorageBufferRange // self.LARGEST_PIXEL_BYTES
        max_side = limits.maxImageDimension2D if self.IN_IMAGES else max_pixels
        if not (0 < width <= max_side and 0 < height <= max_side and width * height <= max_pixels):
            sides = f"{max_side} pixels a side and " if self.IN_IMAGES else ""
            raise SolariError(
                f"{what}: {width}x{height} is not between 1 pixel and what this device holds, {sides}{max_pixels:,} "
                "pixels in all"
            )
        return width, height


def _checked_device(device: Device, what: str) -> Device:
    check_kind(device, Device, f"{what}: the device", "give a solari_vk.Device")
    return device
