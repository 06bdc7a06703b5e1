"""Pictures with a shutter: their samples show the scene at many times."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.bound.projection import JITTERS, SEED_STRIDE, CameraUniforms, Projection
from solari_vk.passes import reference
from solari_vk.renderers.renderer_base import METERING_FRAMES, RendererBase
from solari_vk.renderers.results import RenderedFrame
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.shutter import Moment, Shutter

GUIDES = ("albedo", "shading_normal")  # of OIDN
Pose = Callable[[float], Any]
FIRST, LATER, AFTER = 1, 2, 3  # as in glsl/scene/camera_records.glsl


class Exposed(NamedTuple):
    """A realtime frame's part in an exposure."""

    state: int
    """FIRST, LATER or AFTER: of an exposure, or without a shutter after one."""
    rows: tuple[int, int]
    """Those that it exposes: the first one, and the one after the last."""


def checked_pose(scene: Scene, shutter: Any, pose: Any, who: str) -> Pose:
    """What poses the scene during an exposure. Raises SolariError if nothing does, and for what is no shutter."""
    if not isinstance(shutter, Shutter):
        raise SolariError(
            f"{who}.render: shutter is a solari_vk.Shutter, not {quoted(shutter)}: Shutter(close=1/48) is one"
        )
    if pose is None and not len(scene.animations):
        raise SolariError(
            f"{who}.render: {scene.describe()} has no animations: give pose, a function that poses "
            "the scene at a time, and may return the camera"
        )
    if pose is not None and not callable(pose):
        raise SolariError(f"{who}.render: pose is a function of the time in seconds, not {quoted(pose)}")
    found: Pose = scene.animate if pose is None else pose
    return found


class PosingRenderer(RendererBase):
    """A renderer of cameras that a function of the time gives."""

    _metered_camera: Camera | None = None  # of such a function: the latest one whose exposure was chosen

    def _posed(self, pose: Pose, seconds: float, camera: Camera) -> Camera:
        """The camera at a time, at which the scene then is. What was chosen for one camera that `pose` gave is the
        exposure of the others with auto_exposure."""
        given, metered = pose(seconds), self._metered_camera
        if not isinstance(given, Camera) or given is camera:
            return camera
        if given.auto_exposure and metered is not None and given is not metered:
            given.update(ev100=metered.ev100, auto_exposure=metered.auto_exposure)
        return given

    def _finish_posed(self, frame: RenderedFrame, camera: Camera, metered: int = 1) -> RenderedFrame:
        """`_finish`; camera: the one that `render` was given."""
        if frame.camera.auto_exposure and frame.camera is not camera:
            self._metered_camera = frame.camera
        return self._finish(frame, metered)


class ShutterRenderer(PosingRenderer):
    """A renderer that accumulates samples, each of which may show the scene at a time of its own."""

    settings: reference.Settings
    _projection: Projection
    _shown: tuple[Any, ...] | None
    _guides: list[NDArray[Any]] | None

    @property
    @abstractmethod
    def samples(self) -> int:
        """The samples per pixel of all rows."""

    @abstractmethod
    def _begin_picture(self) -> None:
        """Discard all samples."""

    @abstractmethod
    def _trace_rows(self, top: int, below: int, first: int, end: int) -> int:
        """Trace the samples from `first` up to `end` of the rows from `top` up to `below`, of which those before are
        there; returns the device's timeline value."""

    @abstractmethod
    def _adapt(self) -> None:
        """Choose the next dispatches' size by the time that the latest finished one took."""

    def _expose(
        self,
        camera: Camera,
        samples: int,
        shutter: Any,
        pose: Any,
        denoise: bool,
        time_limit: float | None,
        progress: Callable[[int], None] | None,
    ) -> RenderedFrame:
        """The picture of an exposure; the scene stays as in its middle. Arguments are those of `PathTracer.render`.

        What `progress` raises ends the exposure and is raised again, with the picture so far as the latest."""
        poses = checked_pose(self.binder.scene, shutter, pose, type(self).__name__)
        started, height, submission = time.perf_counter(), self.size[1], 0
        guides: list[NDArray[Any]] = []
        ended: BaseException | None = None
        try:
            for number, moment in enumerate(shutter.moments(samples, height, self.settings.seed)):
                shown = self._show(camera, poses, moment.time)
                if number == 0:
                    self._begin_picture()
                    self._frame.apply_edits()
                    reference.write_uniforms(self._frame.uniforms, self.settings)
                CameraUniforms(self._frame.uniforms).write(shown, self.size)
                submission = self._trace_rows(*moment.rows, *moment.samples)
                if denoise:
                    self._add_guides(guides, moment, samples)
                if moment.rows[1] == height:
                    ended = None if progress is None else _raised_by(progress, self.samples)
                    if ended or (time_limit is not None and time.perf_counter() - started > time_limit):
                        break
                self._adapt()
            shown = self._show(camera, poses, shutter.middle)
        except BaseException:
            self.reset()
            with suppress(Exception):  # the error that is raised is the first one
                poses(shutter.middle)
            raise
        # The next picture is a new one. This one may have ended early.
        self._shown, self._guides = None, [mean * np.float32(samples / self.samples) for mean in guides] or None
        frame = self._finish_posed(RenderedFrame(self, shown, self._projection, submission), camera)
        frame.exposed = True
        if ended is not None:
            raise ended
        return frame

    def _show(self, camera: Camera, pose: Pose, seconds: float) -> Camera:
        """Pose the scene, and take up its edits; returns the camera."""
        shown = self._posed(pose, seconds, camera)
        self._note_camera(shown)
        self.binder.update()
        self._warn_of_darkness()
        self._projection = Projection.of(shown, self.size)
        return shown

    def _add_guides(self, guides: list[NDArray[Any]], moment: Moment, samples: int) -> None:
        """A ray of each pixel at each time, of rows of the moment."""
        top, below = moment.rows
        offset = JITTERS[moment.samples[0] % len(JITTERS)]
        found = self.first_hits.read_at(GUIDES, self._projection, self.size, offset)
        if not guides:
            guides += [np.zeros_like(values) for values in found]
        share = np.float32((moment.samples[1] - moment.samples[0]) / samples)
        for mean, values in zip(guides, found, strict=True):
            mean[top:below] += share * values[top:below]


class ExposureRenderer(PosingRenderer):
    """A realtime renderer. With a shutter each frame shows the scene at one time of the exposure, so that surfaces are
    sharp for the denoiser, and the picture is the mean of the frames: Haeberli and Akeley, "The Accumulation Buffer"
    (1990)."""

    frame_count: int
    seed: int
    _exposure: tuple[Any, ...] | None = None  # what the latest frames' exposure is of
    _moved = False  # whether the scene on the device is at another time than the latest frame's first hits

    @abstractmethod
    def _submit(self, camera: Camera, exposed: Exposed | None = None) -> tuple[Projection, int]:
        """Submit a frame of the scene as it is; returns its projection, and the device's timeline value."""

    @checked_keywords()
    def render(
        self,
        camera: Camera | None = None,
        *,
        shutter: Shutter | None = None,
        pose: Callable[[float], Any] | None = None,
    ) -> RenderedFrame:
        """Submit the next frame and return it, without waiting for it; its results are read by name.

        camera: by default the scene's. Light accumulates over frames; the picture of a still camera settles after about
        24 frames. Call `reset` at a cut. shutter: the frame shows one time of the exposure, for which `pose(seconds)`,
        by default `scene.animate`, poses the scene, and may return the camera; `radiance` is the mean of the successive
        frames given this shutter, pose and camera, and another one begins a new picture. The scene stays as in
        the middle of the exposure, which results at pixels' centers show. Raises SolariError for a wrong camera, a
        shutter without a pose in a scene without animations, or an invalid scene.
        """
        camera = camera if isinstance(camera, Camera) else self._camera_or_default(camera)
        if shutter is None and pose is None:
            # After an exposure the picture begins anew.
            after = None if self._exposure is None else Exposed(AFTER, (0, self.size[1]))
            frame = RenderedFrame(self, camera, *self._submit(camera, after))
            self._exposure, self._moved = None, False
        else:
            frame = self._expose(camera, shutter, pose)
        return self._finish_posed(frame, camera, METERING_FRAMES)

    def _expose(self, camera: Camera, shutter: Any, pose: Any) -> RenderedFrame:
        """The next frame of an exposure; the scene stays as in its middle."""
        poses = checked_pose(self.binder.scene, shutter, pose, type(self).__name__)
        seconds, rows = shutter.frame(self.frame_count + SEED_STRIDE * self.seed, self.size[1])
        before, self._exposure = self._exposure, None
        exposure = shutter, poses, Projection.of(camera, self.size).view
        state = LATER if before == exposure else FIRST
        try:
            _, submission = self._submit(self._posed(poses, seconds, camera), Exposed(state, rows))
            middle = self._posed(poses, shutter.middle, camera)
        except BaseException:
            self.reset()  # what the device has is the mean of an exposure
            with suppress(Exception):  # the error that is raised is the first one
                poses(shutter.middle)
            raise
        self._exposure, self._moved = exposure, True
        frame = RenderedFrame(self, middle, Projection.of(middle, self.size), submission)
        frame.exposed = True
        return frame

    def check_latest(self, frame: RenderedFrame, name: str) -> None:
        super().check_latest(frame, name)
        if self._moved and name in reference.FIRST_HIT_AOVS:
            self.binder.update()
            self._moved = False


def _raised_by(progress: Callable[[int], None], samples: int) -> BaseException | None:
    """What a call of `progress` raises, None if nothing."""
    try:
        progress(samples)
    except BaseException as error:
        return error
    return None
