"""Pictures with a shutter: their samples show the scene at many times."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.projection import JITTERS, CameraUniforms, Projection
from solari_vk.errors import SolariError, quoted
from solari_vk.passes import pathtracer
from solari_vk.picture_renderer import PictureRenderer
from solari_vk.rendered import RenderedFrame
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.shutter import Moment, Shutter

GUIDES = ("albedo", "shading_normal")  # of OIDN
Pose = Callable[[float], Any]


def checked_pose(scene: Scene, shutter: Any, pose: Any) -> Pose:
    """What poses the scene during an exposure. Raises SolariError if nothing does, and for what is no shutter."""
    if not isinstance(shutter, Shutter):
        raise SolariError(
            f"PathTracer.render: shutter is a solari_vk.Shutter, not {quoted(shutter)}: Shutter(close=1/48) is one"
        )
    if pose is None and not len(scene.animations):
        raise SolariError(f"PathTracer.render: {scene.describe()} has no animations: give pose, a function that poses "
                          "the scene at a time, and may return the camera")  # fmt: skip
    if pose is not None and not callable(pose):
        raise SolariError(f"PathTracer.render: pose is a function of the time in seconds, not {quoted(pose)}")
    found: Pose = scene.animate if pose is None else pose
    return found


class ShutterRenderer(PictureRenderer):
    """A renderer that accumulates samples, each of which may show the scene at a time of its own."""

    settings: pathtracer.Settings
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
        self, camera: Camera, samples: int, shutter: Any, pose: Any, denoise: bool, time_limit: float | None,
        progress: Callable[[int], None] | None,
    ) -> RenderedFrame:  # fmt: skip
        """The picture of an exposure; the scene stays as in its middle. Arguments are those of `PathTracer.render`.

        What `progress` raises ends the exposure and is raised again, with the picture so far as the latest."""
        poses = checked_pose(self.binder.scene, shutter, pose)
        started, height, submission = time.perf_counter(), self.size[1], 0
        guides: list[NDArray[Any]] = []
        ended: BaseException | None = None
        try:
            for number, moment in enumerate(shutter.moments(samples, height, self.settings.seed)):
                shown = self._show(camera, poses, moment.time)
                if number == 0:
                    self._begin_picture()
                    self._frame.apply_edits()
                    pathtracer.write_uniforms(self._frame.uniforms, self.settings)
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
        frame = self._finish(RenderedFrame(self, shown, self._projection, submission))
        if ended is not None:
            raise ended
        return frame

    def _show(self, camera: Camera, pose: Pose, seconds: float) -> Camera:
        """Pose the scene, and take up its edits; returns the camera."""
        given = pose(seconds)
        shown = given if isinstance(given, Camera) else camera
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


def _raised_by(progress: Callable[[int], None], samples: int) -> BaseException | None:
    """What a call of `progress` raises, None if nothing."""
    try:
        progress(samples)
    except BaseException as error:
        return error
    return None
