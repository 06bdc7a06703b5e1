"""What the realtime renderer and the path tracer share: a size, a frame of stages, a latest result."""

from __future__ import annotations

import operator
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import (
    Hints,
    SolariError,
    checked_keywords,
    is_name,
    quoted,
    unknown_attribute,
    unknown_name,
    warn,
)
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.features import LENSES
from solari_vk.bound.projection import Projection
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Row, Stage
from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.output.tone_mapping import TONEMAPS, auto_exposure
from solari_vk.output.transparency import backdrop, premultiplied
from solari_vk.passes import brdf_table, paths
from solari_vk.passes.debug_views import DEBUG_VIEWS, PICTURE
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.renderers.back_sides import BackSides
from solari_vk.renderers.first_hit_reader import FirstHitReader
from solari_vk.renderers.own_stages import AnyStage, OwnStages
from solari_vk.renderers.results import RenderedFrame
from solari_vk.renderers.scene_frame import SceneFrame, bind_scene, checked_device
from solari_vk.scene.model import Camera, Instance, Scene

METERING_FRAMES = 4  # realtime frames that choose the exposure of a camera with auto_exposure


Values = TypeVar("Values", NDArray[Any], NDArray[Any] | CudaTensor)


def by_pixel(values: Values, sizes: Iterable[tuple[int, int]]) -> Values:
    """Values (N, ...) as (height, width, ...), if they are one for each pixel of one of the sizes, (width, height)."""
    for width, height in sizes:
        if values.shape[:1] == (width * height,):
            return values.reshape(height, width, *values.shape[1:])
    return values


class RendererBase(Hints):
    """Renders pictures of a size with a frame of stages. A context manager.

    Subclasses make `_frame` in their constructors; `_stages` gives the frame's stages for a size.
    size: (width, height) in pixels. Raises SolariError for a size that the device can't hold.
    """

    OUTPUTS: ClassVar[tuple[str, ...]]
    """The names of all results that frames may have."""
    TAKES_LISTS: ClassVar[bool] = False  # whether it renders a SceneBinder of a list of scenes
    LARGEST_PIXEL_BYTES: ClassVar[int]  # the largest size of a pixel in any one buffer
    APART_PIXEL_BYTES: ClassVar[int] = 0  # the same where the rays of paths are traced apart, if that is more
    IN_IMAGES: ClassVar[bool]  # whether results are in images, whose sides the device limits
    _frame: SceneFrame
    _view = PICTURE
    _tonemap = "agx"
    _latest: RenderedFrame | None = None
    _motion: tuple[Projection, Projection] | None = None  # realtime: of the latest two frames, without a shutter
    _closed = False
    _needs_traced_camera = False  # whether the latest camera has a lens model or an aperture, which raster can't draw
    warned_of_darkness: bool | None = None  # whether the scene had no light in the first picture
    _metering_frame_count = 0  # that chose the exposure of a camera

    def __init__(self, device: Device, scene: Scene | SceneBinder, size: tuple[int, int]) -> None:
        self.device = checked_device(device, type(self).__name__)
        self._size = self._checked_size(size)
        self._own_stages = OwnStages(type(self).__name__)
        self._owned = ExitStack()
        self.binder = bind_scene(device, scene, type(self).__name__, self._owned, many=self.TAKES_LISTS)
        try:
            # The tables and the subclasses' frames need to know the scene's features.
            self.binder.update()
            self._back_sides = BackSides(device)
            self._needs_traced_camera = any(camera.has_lens or camera.aperture for camera in self.binder.scene.cameras)
            table_frame, self._lookup_tables = brdf_table.compute(device)
            self._owned.enter_context(table_frame)
            self.first_hits = self._owned.enter_context(
                closing(FirstHitReader(device, self.binder, self._lookup_tables))
            )
        except BaseException:
            self._owned.close()
            raise

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse names that nothing reads, or a misspelled one would go unnoticed."""
        # Constructors set new names until they have made the frame.
        is_made = "_frame" in self.__dict__ and not name.startswith("_")
        if is_made and name not in self.__dict__ and not hasattr(type(self), name):
            raise unknown_attribute(f"{type(self).__name__} has no attribute", name, lambda: dir(self))
        super().__setattr__(name, value)

    @abstractmethod
    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        """The renderer's stages of a frame, in order."""

    def _all_stages(self, size: tuple[int, int]) -> list[Stage]:
        """The stages of a frame, with the user's own."""
        return self._own_stages.inserted(self._stages(size), self._picture_sizes(size))

    def _picture_sizes(self, size: tuple[int, int]) -> tuple[tuple[int, int], ...]:
        """The sizes of a frame's pictures, of which the first is the result's."""
        return (size,)

    @abstractmethod
    def _rebuild(self) -> None:
        """Rebuild the frame."""

    @property
    def gbuffer(self) -> str:
        """How the surface of a pixel is found: "traced", or "raster", which shows meshes that rays don't hit."""
        return "traced"

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the results that the frame has."""
        return (*self.OUTPUTS, *self._own_stages.outputs(self._frame))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in pixels. Assigning others is `resize`."""
        return self._size

    @size.setter
    def size(self, size: tuple[int, int]) -> None:
        self.resize(size)

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
    def between(self) -> Callable[[], bool] | None:
        """Called after each pass of a frame, which then waits for the device; True gives the frame up: see `Frame`."""
        return self._frame.between

    @between.setter
    def between(self, between: Callable[[], bool] | None) -> None:
        self._frame.between = between

    @property
    def meanwhile(self) -> Callable[[], object] | None:
        """With `between`: called again and again while a pass runs. It must not use the renderer."""
        return self._frame.meanwhile

    @meanwhile.setter
    def meanwhile(self, meanwhile: Callable[[], object] | None) -> None:
        self._frame.meanwhile = meanwhile

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

    @checked_keywords()
    def add_stage(self, stage: AnyStage, *, after: str) -> None:
        """Add a stage of your own to the frame, which runs in every frame from now on.

        stage: a Stage whose shaders are below its `glsl_root`, or a function that makes one for the picture's (width,
        height) and is called again when that changes. after: the name of the stage that it follows, of `stages`. Its
        shaders read and write the frame's resources by their names; the buffers and images that it declares are results
        of the frame. Raises SolariError for a name that is taken or missing, and a CompilationError; the frame then
        stays as it was. The path tracer's picture begins anew. Source: docs/guides/passes.md.
        """
        taken = {*self.OUTPUTS, *FIRST_HITS, *DEBUG_VIEWS, "image"}
        self._change_stages(self._own_stages.plus(stage, after, self._frame, self._picture_sizes(self.size), taken))

    @checked_keywords()
    def remove_stage(self, name: str) -> None:
        """Remove a stage of your own. Raises SolariError for any other name; the frame then stays as it was."""
        self._change_stages(self._own_stages.without(name))

    def _change_stages(self, changed: OwnStages) -> None:
        self._frame.check_open()
        before, stages = self._own_stages, self._frame.stages
        self._own_stages = changed
        try:
            self._rebuild()
        except BaseException:
            self._own_stages = before
            if self._frame.stages is not stages:  # it failed once the frame had the changed ones
                self._rebuild()
            raise

    @property
    def view(self) -> str:
        """What `display` shows from the next frame on: "picture", a debug view (`solari-vk views` lists them), or an
        output of a stage of your own; the path tracer has "picture" alone.

        Some views need one of the values of the setting `lighting`. It is "picture" again after a change to another.
        """
        return self._view

    @view.setter
    def view(self, name: str) -> None:
        try:
            self._check_view(name)
        except SolariError as error:
            raise SolariError(f"{type(self).__name__}: {error}") from None
        self._own_stages = self._own_stages.showing(self._own_views.get(name, ""))
        self._view = name

    def _check_view(self, name: str) -> None:
        """Raise SolariError for what `view` can't be."""
        if not is_name(name, self.known_views):
            raise unknown_name("there is no view", name, self.known_views)

    @property
    def known_views(self) -> dict[str, str]:
        """The names that `view` takes, with what each shows."""
        return {PICTURE: DEBUG_VIEWS[PICTURE]} | dict.fromkeys(self._own_views, "An output of a stage of your own.")

    @property
    def _own_views(self) -> dict[str, str]:
        """The outputs of the user's stages that can be shown, each with its header: see `OwnStages.views`."""
        return {}

    @property
    def tonemap(self) -> str:
        """The tone curve of `display` and of saved pictures, from the next frame on: "none", "reinhard", "aces" or
        "agx"."""
        return self._tonemap

    @tonemap.setter
    def tonemap(self, name: str) -> None:
        if not is_name(name, TONEMAPS):
            raise unknown_name(f"{type(self).__name__}: there is no tone mapping", name, TONEMAPS)
        self._tonemap = name

    @property
    def uniforms(self) -> Uniforms:
        """The frame's uniform blocks. Those of your own stages keep what you assign, the others are written anew."""
        return self._frame.uniforms

    def describe(self) -> list[Row]:
        """The frame's passes: what they read and write, the barriers before them and why, and their GPU times."""
        return self._frame.describe()

    @property
    def has_frame(self) -> bool:
        """Whether there is a latest frame, whose results can be asked for."""
        return self._latest is not None

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A result of the latest frame, as RenderedFrame has it. Raises SolariError if there is no frame."""
        if self._latest is None:
            raise SolariError(f"{type(self).__name__}: render before asking for '{name}'")
        return self._latest[name]

    def pick(self, x: int, y: int) -> Instance | None:
        """What the latest frame shows at a pixel: see `RenderedFrame.pick`."""
        if self._latest is None:
            raise SolariError(f"{type(self).__name__}: render before picking")
        return self._latest.pick(x, y)

    def __repr__(self) -> str:
        width, height = self.size
        state = "closed" if self._closed else f"of {self.binder.scene!r}, on {self.device.name}"
        return f"<{type(self).__name__} {width}x{height}, {state}>"

    @abstractmethod
    def read(self, name: str) -> NDArray[Any]:
        """A result of the latest frame that isn't in `first_hits.FIRST_HITS`."""

    @abstractmethod
    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        """What `read` returns, as a tensor that stays on the device; see `RenderedFrame.tensor`."""

    def auto_exposure(self, radiance: NDArray[Any] | None = None) -> float:
        """The EV100 that suits the latest picture: surfaces count, and an environment behind them doesn't.

        radiance (height, width, 3): another picture of the same view, such as the mean of several frames.
        """
        radiance = self["radiance"] if radiance is None else radiance
        # Without an environment, pixels without a surface are black, which the exposure doesn't count anyway.
        surfaces = None if self.binder.scene.environment is None else np.isfinite(self["depth"])
        return auto_exposure(radiance, surfaces)

    def cut_out(self, radiance: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The light of the surfaces in the latest picture, without what is behind them, (height, width, 3), and the
        share of each pixel that they cover, (height, width), from 64 rays each.

        radiance (height, width, 3): the picture, such as the mean of several frames. Raises SolariError for a frame
        with an aperture or a shutter, whose blur these rays don't have.
        """
        frame = self._latest
        if frame is None:
            raise SolariError(f"{type(self).__name__}: render before asking for a transparent background")
        if frame.camera.aperture or frame.exposed:
            blurs = "an aperture: set that to 0" if frame.camera.aperture else "a shutter: leave it out"
            raise SolariError(
                f"a transparent background: blurred edges have no alpha here, and {frame.camera.describe()} has {blurs}"
            )
        moved = Projection.of(frame.camera, frame.size).view != frame._projection.view
        if moved or self.size != frame.size:
            changed = "camera" if moved else "size"
            raise SolariError(
                f"a transparent background: the {changed} has changed since the picture was rendered; render again"
            )
        coverage = self.first_hits.read_coverage(frame._projection, self.size)
        # What is behind the surfaces is taken away in the share of each pixel that they leave open.
        environment = self.binder.scene.environment
        behind = 0.0 if environment is None else backdrop(environment, frame.camera, self.size)
        return premultiplied(radiance, coverage, behind), coverage

    def check_latest(self, frame: RenderedFrame, name: str) -> None:
        """Raise SolariError if a frame's results are no longer on the device. name: the result that is asked for."""
        if self._latest is frame:
            return
        what = "was closed" if self._closed else "has rendered a later frame"
        raise SolariError(f"'{name}' must be read earlier: this frame's {type(self).__name__} {what}")

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        self._latest = None
        self._closed = True
        self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- for subclasses ------------------------------------------------------------------------------

    def _finish(self, frame: RenderedFrame, metering_frames: int = 1) -> RenderedFrame:
        """Make a frame the latest and return it. A camera with auto_exposure gets the EV100 that suits the frame, until
        as many frames as `metering_frames` have chosen it."""
        self._latest = frame
        if frame.camera.auto_exposure:
            # The first frames of a realtime renderer are noisy, and their exposures a little off.
            self._metering_frame_count += 1
            chooses_again = self._metering_frame_count % metering_frames != 0
            frame.camera.update(ev100=self.auto_exposure(), auto_exposure=chooses_again)
        return frame

    @property
    def _dark_scenes(self) -> list[Scene]:
        return self.binder.dark_scenes

    def _warn_of_darkness(self) -> None:
        """Warn before the first picture of a scene in which nothing emits light. `binder` is up to date."""
        if self.warned_of_darkness is not None:
            return
        self.warned_of_darkness = bool(self._dark_scenes)
        for scene in self._dark_scenes:
            warn(
                f"{scene.describe()} has no light, so pictures are black: load files with solari_vk.open, call "
                "studio_lights(scene), set scene.environment = Sky(), or add a light"
            )

    def _camera_or_default(self, camera: Camera | None) -> Camera:
        if camera is None:
            return self.binder.scene.camera_for(self.size[0] / self.size[1])
        if not isinstance(camera, Camera):
            why = ""
            if isinstance(camera, int):
                why = "; the number of samples is given by its name, samples="
            elif isinstance(camera, Scene):
                why = "; the scene was given when the renderer was made"
            raise SolariError(f"{type(self).__name__}: camera must be a Camera, not {quoted(camera)}{why}")
        return camera

    def _prepare_lens(self, camera: Camera, rasters: bool = False) -> None:
        """Have the shaders trace a camera's lens, which is a feature of theirs, before a picture is made with it.

        Raises SolariError for a lens if the picture is rastered."""
        needs_traced_camera = camera.has_lens or camera.aperture > 0
        if needs_traced_camera and rasters:
            raise SolariError(f"{camera.describe()}: raster draws no lenses: leave the setting gbuffer at auto")
        self._needs_traced_camera = needs_traced_camera
        # The scene's own cameras are known to the binder; this one may be another.
        if camera.has_lens and LENSES not in self.binder.features:
            self.binder.mark_changed(camera)

    def _center_motion(
        self, size: tuple[int, int], rendered: tuple[int, int], read: Callable[[Frame, str], Values]
    ) -> Values:
        """The latest frame's motion at the centers of what was rendered, where depth and position are. The denoiser's
        own image has that of the jittered samples. read: Frame.tensor, or what copies a result."""
        assert self._motion is not None
        instances = self._frame.resource("older_instances")
        found = self.first_hits.motion(self._motion, (size, rendered), instances, self.gbuffer == "traced")
        return by_pixel(read(found, "aov_motion_vectors"), [rendered])

    @contextmanager
    def _keeps_size(self, size: tuple[int, int]) -> Iterator[None]:
        """Go back to a size if what follows fails, such as for lack of memory."""
        try:
            yield
        except BaseException:
            self._size = size
            raise

    @classmethod
    def pixel_bytes(cls, device: Device) -> int:
        """The largest size of a pixel in any one buffer."""
        apart = paths.apart_bytes(device.rays, device.properties) > 0
        return max(cls.LARGEST_PIXEL_BYTES, cls.APART_PIXEL_BYTES if apart else 0)

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        what = type(self).__name__
        try:
            width, height = (operator.index(n) for n in size)
        except (TypeError, ValueError):
            raise SolariError(f"{what}: size must be two whole numbers (width, height), not {quoted(size)}") from None
        # A size is refused here, in words, since an allocation would fail much later.
        limits = self.device.properties.limits
        max_pixels = limits.maxStorageBufferRange // self.pixel_bytes(self.device)
        max_side = limits.maxImageDimension2D if self.IN_IMAGES else max_pixels
        if not (0 < width <= max_side and 0 < height <= max_side and width * height <= max_pixels):
            sides = f"{max_side} pixels a side and " if self.IN_IMAGES else ""
            raise SolariError(
                f"{what}: {width}x{height} is not between 1 pixel and what this device holds, {sides}{max_pixels:,} "
                "pixels in all; solari_vk.render_large renders larger pictures, by the path tracer in bands"
            )
        return width, height


def checked_seed(seed: Any) -> int:
    """A seed of noise; raises SolariError for anything but whole numbers from 0 to 2^32 - 1."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < 2**32:
        raise SolariError(f"Renderer: seed must be a whole number from 0 to 2^32 - 1, not {quoted(seed)}")
    return number
