"""The base of the renderers of pictures, and the frame that `render` returns."""

from __future__ import annotations

import operator
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import Projection
from solari_vk.errors import SolariError, quoted
from solari_vk.first_hits import FirstHits
from solari_vk.frame import SceneFrame, SceneUser, checked_device
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Row, Stage
from solari_vk.output.picture import png_bytes, save_image, write_png
from solari_vk.output.tone_mapping import auto_exposure, encode_picture
from solari_vk.passes import brdf_table, pathtracer
from solari_vk.scene.model import Camera, Instance, Scene

# Medians of the lit pixels after exposure, where 1 is shown as white. Outside this range little can be seen.
DARKEST, BRIGHTEST = 1e-4, 30.0
METERING_FRAMES = 4  # realtime frames that choose the exposure of a camera with auto_exposure


class RenderedFrame:
    """The results of one frame as numpy arrays, by name, until the renderer renders its next frame.

    `frame["radiance"]` is linear radiance (height, width, 3) in cd/m^2; `np.asarray(frame)` is the same. With
    the setting `upscale`, parts of the light and guides of the realtime renderer have the size that was rendered.
    `frame["depth"]` and the other names of `pathtracer.FIRST_HIT_AOVS` describe what is visible at the center of each
    pixel; they are computed on demand. `keys()` lists all of these names. Buffers and images of the renderer's shaders
    can be read by their names too. Reading a result waits for the frame and returns a copy.

    Raises SolariError for an unknown name, after a later frame has been rendered, and after the renderer was closed.
    """

    __slots__ = ("_projection", "_renderer", "_submission", "camera", "size")

    def __init__(self, renderer: PictureRenderer, camera: Camera, projection: Projection, submission: int) -> None:
        self._renderer = renderer
        self._projection = projection
        self._submission = submission
        self.camera = camera
        """The camera object that the frame was rendered with. It may have been changed since then."""
        self.size = renderer.size
        """Width and height in pixels."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        renderer = self._renderer
        renderer.check_latest(self, name)
        if name in pathtracer.FIRST_HIT_AOVS:
            return renderer.first_hits.read(name, self._projection, self.size, renderer.gbuffer == "traced")
        return renderer.read(name)

    def keys(self) -> list[str]:
        """The names of the results."""
        return list(self._renderer.outputs)

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __contains__(self, name: object) -> bool:
        return name in self._renderer.outputs

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self["radiance"], dtype)

    def wait(self) -> Self:
        """Wait until the device has finished the frame; returns the frame."""
        self._renderer.device.await_value(self._submission)
        return self

    def resource(self, name: str) -> Any:
        """The Buffer or Image that a name of the shaders means in this frame."""
        self._renderer.check_latest(self, name)
        return self._renderer.resource(name)

    @property
    def instances(self) -> dict[int, Instance]:
        """The scene's instances by the numbers in `frame["instance_id"]`."""
        return self._renderer.binder.instances

    def mask(self, instance: Instance | str) -> NDArray[np.bool_]:
        """Whether pixels show an instance at their center, (height, width). instance: the object or its name."""
        if isinstance(instance, str):
            instance = self._renderer.binder.scene.instances[instance]
        ids = [number for number, other in self.instances.items() if other is instance]
        return np.isin(self["instance_id"], ids)

    def _repr_png_(self) -> bytes:
        """The picture as notebooks show it: what `save` writes as a .png, without its warnings."""
        renderer = self._renderer
        if renderer.view != "picture":
            codes = self["display"][..., :3]
        else:
            codes = encode_picture(self["radiance"], exposure=self.camera.exposure, curve=renderer.tonemap)
        return png_bytes(codes)

    def save(
        self,
        path: str | os.PathLike[str],
        layers: str | Sequence[str] = (),
        *,
        exposure: float | str | None = None,
        tonemap: str | None = None,
    ) -> None:
        """Write the picture as a .png, or radiance in cd/m^2 as an .exr or .npy.

        layers: the name of a further result, or several, which become channels of an .exr, otherwise .npy files beside
        the picture.
        exposure: the factor by which the .png multiplies radiance, by default the camera's; "auto" chooses it by the
        picture. tonemap: the tone curve of the .png, by default the renderer's. While the renderer shows a debug view,
        a .png holds `frame["display"]`. Warns of a .png in which nothing can be seen. Raises SolariError for an unknown
        name or suffix, and for a file that can't be written.
        """
        renderer, layers = self._renderer, (layers,) if isinstance(layers, str) else layers
        is_png = Path(path).suffix.lower() == ".png"
        if renderer.view != "picture" and is_png:
            write_png(Path(path), self["display"][..., :3])
            return
        radiance = self["radiance"]
        if exposure == "auto":
            exposure = Camera(ev100=renderer.auto_exposure(radiance)).exposure
        elif isinstance(exposure, str):
            raise SolariError(f"{path}: exposure is a factor or 'auto', not {quoted(exposure)}")
        exposure = self.camera.exposure if exposure is None else exposure
        if is_png:
            _warn_of_exposure(radiance * exposure)
        save_image(
            path,
            radiance,
            exposure=exposure,
            tonemap=tonemap or renderer.tonemap,
            layers={name: self[name] for name in layers if name != "radiance"},
        )


def _warn_of_exposure(picture: NDArray[Any]) -> None:
    """Warn if nothing can be seen in a picture after exposure."""
    if not picture.any():
        text = "is black: the scene's lights don't reach it. Lights are those of scene.lights, instances with an "
        warnings.warn(f"the picture {text}emissive material, scene.environment, and studio_lights(scene)", stacklevel=3)
    elif not DARKEST < (typical := float(np.median(picture[picture > 0]))) < BRIGHTEST:
        text = f"the picture is far too {'bright' if typical > 1 else 'dark'}"
        warnings.warn(f'{text}: set camera.ev100, or save it with exposure="auto"', stacklevel=3)


class PictureRenderer(SceneUser, ABC):
    """Renders pictures of a size with a frame of stages.

    Subclasses make `_frame` in their constructors; `_stages` gives the frame's stages for a size.
    size: (width, height) in pixels. Raises SolariError for a size that the device can't hold.
    """

    OUTPUTS: ClassVar[tuple[str, ...]]
    """The names of all results that frames may have."""
    LARGEST_PIXEL_BYTES: ClassVar[int]  # the largest size of a pixel in any one buffer
    IN_IMAGES: ClassVar[bool]  # whether results are in images, whose sides the device limits
    view: str = "picture"
    tonemap: str = "agx"
    """The tone curve of saved pictures: "none", "reinhard", "aces" or "agx"."""
    _frame: SceneFrame
    _latest: RenderedFrame | None = None
    _closed = False
    _looked_for_light = False
    _metered = 0  # pictures that chose an exposure

    def __init__(self, device: Device, scene: Scene | SceneBinder, size: tuple[int, int]) -> None:
        self.device = checked_device(device, type(self).__name__)
        self.size = self._checked_size(size)
        super().__init__(device, scene)
        try:
            self.binder.update()
            table, self._tables = brdf_table.compute(device)
            self._owned.enter_context(table)
            self.first_hits = self._owned.enter_context(closing(FirstHits(device, self.binder, self._tables)))
        except BaseException:
            self._owned.close()
            raise

    @abstractmethod
    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        """The stages of a frame, in order."""

    @property
    def gbuffer(self) -> str:
        """How the surface of a pixel is found: "traced", or "raster", which shows meshes that rays don't hit."""
        return "traced"

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the results that the frame has."""
        return self.OUTPUTS

    @abstractmethod
    def resize(self, size: tuple[int, int]) -> None:
        """Change the picture's size to (width, height) in pixels. What was accumulated is discarded.

        Raises SolariError for a size that the device can't hold; the size then stays as it was.
        """

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old shaders then stay in use."""
        self._frame.rebuild()
        self.first_hits.close()

    @abstractmethod
    def reset(self) -> None:
        """Discard what earlier frames accumulated."""

    def resource(self, name: str) -> Any:
        """The Buffer or Image that had this name in the shaders of the latest frame."""
        return self._frame.resource(name)

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each pass in the latest finished frame."""
        return self._frame.timings

    @property
    def memory(self) -> dict[str, int]:
        """The bytes of the frame's buffers and images on the device, by name; a history counts twice.

        The scene is not included. `device.memory.bytes_reserved` is what is reserved for everything, without what the
        driver itself needs.
        """
        return self._frame.memory

    @property
    def stages(self) -> list[Stage]:
        """The frame's stages, in order."""
        return self._frame.stages

    def describe(self) -> list[Row]:
        """The frame's passes: what they read and write, the barriers before them and why, and their GPU times."""
        return self._frame.describe()

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A result of the latest frame, as RenderedFrame has it. Raises SolariError if there is no frame."""
        if self._latest is None:
            raise SolariError(f"{type(self).__name__}: render before asking for '{name}'")
        return self._latest[name]

    @abstractmethod
    def read(self, name: str) -> NDArray[Any]:
        """A result of the latest frame that isn't in pathtracer.FIRST_HIT_AOVS."""

    def auto_exposure(self, radiance: NDArray[Any] | None = None) -> float:
        """The EV100 that suits the latest picture: surfaces count, and an environment behind them doesn't.

        radiance (height, width, 3): another picture of the same view, such as the mean of several frames.
        """
        radiance = self["radiance"] if radiance is None else radiance
        surfaces = None if self.binder.scene.environment is None else np.isfinite(self["depth"])
        return auto_exposure(radiance, surfaces)

    def meter(self, camera: Camera, pictures: int = 1) -> None:
        """Give a camera with auto_exposure the EV100 that suits the latest picture; `pictures` of them choose."""
        if camera.auto_exposure:
            self._metered += 1
            camera.update(ev100=self.auto_exposure(), auto_exposure=self._metered % pictures != 0)

    def _warn_of_darkness(self) -> None:
        """Warn before the first picture of a scene in which nothing emits light. `binder` is up to date."""
        if self._looked_for_light:
            return
        self._looked_for_light = True
        scene = self.binder.scene
        shown = [instance.material for instance in scene if instance.visible]
        if shown and not len(self.binder.lights.ids) and not any(material.unlit for material in shown):
            warnings.warn(
                f"{scene.describe()} has no light, so pictures are black: load files with solari_vk.open, call "
                "studio_lights(scene), set scene.environment = Sky(), or add a light", stacklevel=3,
            )  # fmt: skip

    def check_latest(self, frame: RenderedFrame, name: str) -> None:
        """Raise SolariError if a frame's results are no longer on the device. name: the result that is asked for."""
        if self._latest is frame:
            return
        what = "was closed" if self._closed else "has rendered a later frame"
        raise SolariError(f"'{name}' must be read earlier: this frame's {type(self).__name__} {what}")

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        self._latest, self._closed = None, True
        super().close()

    def _camera_or_default(self, camera: Camera | None) -> Camera:
        if camera is None:
            return self.binder.scene.camera_for(self.size[0] / self.size[1])
        if not isinstance(camera, Camera):
            raise SolariError(f"{type(self).__name__}: camera must be a Camera, not {quoted(camera)}")
        return camera

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        what = type(self).__name__
        try:
            width, height = (operator.index(n) for n in size)
        except (TypeError, ValueError):
            raise SolariError(f"{what}: size must be two whole numbers (width, height), not {quoted(size)}") from None
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
