"""The pictures that the viewer shows of a scene: the realtime renderer's and the path tracer's."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import DEBUG_VIEWS, PICTURE, views_of
from solari_vk.reference import MAX_SAMPLES
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings
from solari_vk.viewer.presenter import Part
from solari_vk.viewer.reference_picture import ReferencePicture

MODES = ("realtime", "reference", "split")
Build = tuple[tuple[int, int], bool]  # the size of the pictures, and whether the realtime renderer counts rays


class Pictures:
    """Renders what `mode`, one of MODES, shows. A renderer is made when a mode first needs it.

    view, tonemap: as in `Renderer`. divider: the share of the width, from the left, that shows the realtime picture in
    the mode "split". counts_rays: whether the realtime renderer counts its rays, which makes it a little slower. These
    and `mode` may be assigned at any time. `close` frees everything.
    """

    def __init__(self, device: Device, scene: Scene, settings: Settings, seed: int = 0, mode: str = "realtime") -> None:
        self.device, self.scene, self.settings, self.seed = device, scene, settings, seed
        self.mode, self.view, self.tonemap = mode, PICTURE, "agx"
        self.divider = 0.5
        self.counts_rays = False
        self.camera: Camera | None = None
        """The camera of the latest frame, None after a frame that failed."""
        self.is_short = True
        """Whether the latest frame took no more samples than it had to: its time then depends on its size alone."""
        self.binder = SceneBinder(device, scene)
        self.realtime: Renderer | None = None
        self.reference: ReferencePicture | None = None
        self._build: Build = (0, 0), False  # of the latest frame that was rendered
        self._refused: Build | None = None  # the requested build if it failed; `_build` then stays in use

    @property
    def view(self) -> str:
        """The view that was assigned, or "picture" while the lighting lacks it."""
        lacks = self._view in DEBUG_VIEWS and self._view not in views_of(self.settings.lighting)
        return PICTURE if lacks else self._view

    @view.setter
    def view(self, name: str) -> None:
        self._view = name

    @property
    def mode(self) -> str:
        return self._mode

    @mode.setter
    def mode(self, mode: str) -> None:
        if mode not in MODES:
            raise SolariError(f"the viewer's mode is one of {', '.join(MODES)}, not {mode!r}")
        self._mode = mode

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the latest pictures, in pixels."""
        return self._build[0]

    @property
    def refuses(self) -> bool:
        """Whether the latest frame had another size, or another choice of `counts_rays`, than was asked for."""
        return self._refused is not None

    # ---- rendering ----------------------------------------------------------------------------------

    def render(self, camera: Camera, size: tuple[int, int]) -> None:
        """Submit the next frame of the pictures that the mode shows.

        A size that can't be built, for example because a shader has an error, raises SolariError once. Further frames
        then keep the last size that could be built, until another size is asked for or `reload` is called.

        The path tracer adds one sample per pixel while the camera moves and in the mode "split", so that frames are
        short, and otherwise as many as fill a dispatch.
        """
        if self.view not in DEBUG_VIEWS or self.tonemap not in TONEMAPS:
            raise SolariError(f"the viewer has no view {self.view!r} or no tone mapping {self.tonemap!r}")
        self.binder.update()  # raises an error in the scene here, so that the size isn't taken for its cause
        moved = self.camera is None or (self.camera.transform != camera.transform).any()
        self.is_short = moved or self.mode != "reference"
        self.camera = None
        wanted = size, self.counts_rays and self.mode != "reference"
        build = self._build if wanted == self._refused else wanted
        failing = "realtime"
        try:
            if self.mode != "reference":
                self._render_realtime(camera, build)
            if self.mode != "realtime":
                failing = "reference"
                self._render_reference(camera, build[0])
        except SolariError:
            if self._built(failing, build) != build and self.size != (0, 0) and build != self._build:
                self._refused = wanted
            raise
        self._build = build
        if wanted == build:
            self._refused = None
        self.camera = dataclasses.replace(camera)

    def _built(self, name: str, build: Build) -> Build | None:
        """What the renderer "realtime" or "reference" was last built for; None if there is none yet."""
        if name == "reference":
            return None if self.reference is None else (self.reference.size, build[1])
        if self.realtime is None:
            return None
        display = self.realtime.resource("display")
        return (display.width, display.height), self.realtime.count_rays

    def _render_realtime(self, camera: Camera, build: Build) -> None:
        size, counts = build
        if self.realtime is None or self.realtime.count_rays != counts:
            made = Renderer(self.device, self.binder, size, self.settings, seed=self.seed, count_rays=counts)
            if self.realtime is not None:
                self.realtime.close()
            self.realtime = made
        if self.realtime.size != size:
            self.realtime.resize(size)
        self.realtime.view, self.realtime.tonemap = self.view, self.tonemap
        self.realtime.render(camera)

    def _render_reference(self, camera: Camera, size: tuple[int, int]) -> None:
        if self.reference is None:
            self.reference = ReferencePicture(self.device, self.binder, size, self.seed)
        self.reference.render(camera, size, self.tonemap, 1 if self.is_short else MAX_SAMPLES)

    def cut(self) -> None:
        """Drop the realtime renderer's history, because the next picture has nothing in common with the latest."""
        if self.realtime is not None:
            self.realtime.reset()

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipelines then stay in use."""
        self._refused = None
        for item in (self.realtime, self.reference):
            if item is not None:
                item.reload()

    # ---- results ------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether there is a picture to show in this mode."""
        realtime = self.realtime is not None and self.realtime.frame_count > 0
        reference = self.reference is not None and self.reference.tracer.samples > 0
        return {"realtime": realtime, "reference": reference, "split": realtime and reference}[self.mode]

    def parts(self) -> list[Part]:
        """The parts of images that make up the latest picture; an empty list before the first frame."""
        realtime = self.realtime.resource("display") if self.realtime and self.realtime.frame_count else None
        reference = self.reference.display if self.reference else None
        if self.mode == "split" and realtime is not None and reference is not None:
            return [Part(realtime, 0, self.divider), Part(reference, self.divider, 1)]
        shown = reference if self.mode == "reference" else realtime
        return [] if shown is None else [Part(shown)]

    def pixels(self) -> NDArray[np.uint8]:
        """The latest picture as it is shown, (height, width, 3), at the size that was rendered."""
        parts = self.parts()
        if not parts:
            raise SolariError("there is no picture yet")
        images = (part.image.read()[:, slice(*part.columns(part.image.width)), :3] for part in parts)
        return np.concatenate(list(images), axis=1)

    def radiance(self) -> NDArray[np.float32]:
        """Radiance (height, width, 3) of the latest picture, in cd/m^2; in the mode "split" of the realtime one."""
        source: Any = self.reference and self.reference.tracer if self.mode == "reference" else self.realtime
        if source is None:
            raise SolariError("there is no picture yet")
        found: NDArray[np.float32] = source["radiance"]
        return found

    def error(self) -> tuple[float, float] | None:
        """How far the realtime picture is from the path tracer's: (root of the mean squared difference of the shown
        pixels as a share of white, difference of the mean radiance as a share of the path tracer's).

        None unless the mode is "split" and the view is "picture", the only one that the path tracer has too.
        """
        if self.mode != "split" or self.view != "picture" or not self.ready:
            return None
        assert self.realtime is not None
        assert self.reference is not None
        shown = [image.read()[..., :3] / 255.0 for image in (self.realtime.resource("display"), self.reference.display)]
        found, truth = (float(r["radiance"].mean(dtype=np.float64)) for r in (self.realtime, self.reference.tracer))
        if shown[0].shape != shown[1].shape or not truth > 0:
            return None
        return float(np.sqrt(((shown[0] - shown[1]) ** 2).mean())), found / truth - 1

    def ray_count(self) -> int:
        """The number of rays traced so far for the pictures of the mode, where they are counted. A counter may restart
        from 0."""
        count = 0
        if self.realtime is not None and self.mode != "reference":
            count += int(self.realtime["ray_counts"].sum(dtype=np.uint64))
        if self.reference is not None and self.mode != "realtime":
            count += self.reference.tracer.rays
        return count

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each pass in the last finished frame."""
        realtime = self.realtime.timings if self.realtime is not None and self.mode != "reference" else {}
        reference = self.reference.tracer.timings if self.reference is not None and self.mode != "realtime" else {}
        return realtime | reference

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        for item in (self.realtime, self.reference):
            if item is not None:
                item.close()
        self.binder.destroy()
