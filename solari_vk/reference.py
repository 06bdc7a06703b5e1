"""The reference path tracer: the ground truth of every realtime test."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError, unknown_name
from solari_vk.frame import SceneFrame
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.passes import pathtracer
from solari_vk.rendered import PictureRenderer, RenderedFrame
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.projection import CameraUniforms, Projection

DISPATCH_MS = 100.0  # what a dispatch should take: far below any driver's watchdog, far above its overhead
MAX_SAMPLES = 64  # of a pixel in one dispatch


class PathTracer(PictureRenderer):
    """The reference path tracer: progressive, unbiased, the ground truth of every realtime test.

    size: (width, height) in pixels. max_bounces: how many surfaces a path may leave, 0 shows emission
    only. seed: another one gives other noise. light_strategy: "mis", or "nee" or "brdf" alone, which
    agree in the mean. pixel_filter: "box", or the wider "gaussian" or "blackman_harris". layering: how
    diffuse sits under specular, "conserving" or Solari's "fresnel_product".
    lambert: every surface is plain Lambert, for closed forms. Source: seed 004.

    The scene may be edited between calls of `render`. `close` frees what the device holds; closing the
    device does so too.
    """

    OUTPUTS = ("radiance", *pathtracer.AOVS)
    LARGEST_PIXEL_BYTES = pathtracer.LARGEST_PIXEL_BYTES
    IN_IMAGES = False

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        size: tuple[int, int],
        *,
        max_bounces: int = 16,
        seed: int = 0,
        light_strategy: str = "mis",
        pixel_filter: str = "box",
        layering: str = "conserving",
        lambert: bool = False,
    ) -> None:
        self.settings = pathtracer.Settings(max_bounces, seed, light_strategy, pixel_filter, layering, lambert)
        super().__init__(device, scene, size)
        try:
            self.samples = 0
            """Samples a pixel in the picture so far."""
            self._shown: tuple[Any, ...] | None = None  # what the picture shows: scene, size and camera
            self._begin_adapting(pathtracer.max_rows(self.size), 0)
            stages = self._stages(self.size)
            self._frame = self._own(SceneFrame(device, self.binder, stages, external=self._tables))
        except BaseException:
            self.close()
            raise

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        return [pathtracer.trace_stage(size, self._band_rows, self.settings)]

    def resize(self, size: tuple[int, int]) -> None:
        size = self._checked_size(size)
        rows = pathtracer.max_rows(size)
        self._frame.rebuild([pathtracer.trace_stage(size, rows, self.settings)])
        self.size = size
        self._begin_adapting(rows, self._frame.frame_count)
        self.reset()

    def _begin_adapting(self, rows: int, frame_count: int) -> None:
        """Forget what dispatches have taken so far; they begin with so many rows and one sample."""
        self._band_rows, self._batch = rows, 1
        self._next_look = frame_count + 4  # when `_adapt` looks; a driver may compile in the first frames
        # Rows times samples of the latest dispatches, with the timeline value of each.
        self._sizes: deque[tuple[int, int]] = deque(maxlen=4)

    def reload(self) -> None:
        super().reload()
        self.reset()

    def reset(self) -> None:
        """Have the next call of `render` or `advance` start the picture anew."""
        self._shown = self._latest = None

    # ---- rendering ----------------------------------------------------------------------------------

    def render(
        self,
        camera: Camera | None = None,
        samples: int = 256,
        *,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> RenderedFrame:
        """Refine the picture until it has `samples` samples a pixel, and return it.

        camera: by default the scene's. When the camera, the scene or the size has changed since the last call, the
        picture starts anew; otherwise its samples count. time_limit: stop after so many seconds. progress: called with
        the number of samples done. Raises SolariError for a sample count below 1.
        """
        camera = self._camera_or_default(camera)
        if not isinstance(samples, int) or samples < 1:
            raise SolariError(f"PathTracer.render: samples must be a whole number of at least 1, not {samples!r}")
        started = time.perf_counter()
        self._prepare(camera)
        while self.samples < samples:
            self.advance(camera, samples - self.samples)
            if progress is not None:
                progress(self.samples)
            if time_limit is not None and time.perf_counter() - started > time_limit:
                break
        assert self._latest is not None
        return self._latest

    def advance(self, camera: Camera | None = None, max_samples: int = MAX_SAMPLES) -> None:
        """Submit the next samples for every pixel, as many as make a short dispatch, and don't wait for them."""
        camera = self._camera_or_default(camera)
        self._prepare(camera)
        self._add_samples(camera, min(self._batch, max_samples))
        self._adapt()

    def _prepare(self, camera: Camera) -> None:
        """Take up edits of the scene, and start anew if anything differs from what the picture shows."""
        self.binder.update()
        view = (camera.transform.tobytes(), camera.vertical_fov, camera.near, *camera.jitter.tolist())
        shown = (self.binder.revision, self.size, *view)
        if shown != self._shown:
            self._shown = shown
            self._projection = Projection.of(camera, self.size)
            self.samples = 0
            CameraUniforms(self._frame.uniforms).write(camera, self.size)
            pathtracer.write_uniforms(self._frame.uniforms, self.settings)
            self._frame.uniforms["path_sampling.row_count"] = self._band_rows

    def _add_samples(self, camera: Camera, count: int) -> None:
        """Trace so many samples for every pixel, one band of rows after the other."""
        uniforms = self._frame.uniforms
        uniforms["path_sampling.sample_index"] = self.samples
        uniforms["path_sampling.samples_per_dispatch"] = count
        try:
            for row in range(0, self.size[1], self._band_rows):
                uniforms["path_sampling.first_row"] = row
                submission = self._frame.submit()
                self._sizes.append((submission, count * self._band_rows))
        except BaseException:
            self.reset()  # some bands have these samples and some have not: the next call starts anew
            raise
        self.samples += count
        self._latest = RenderedFrame(self, camera, self._projection, submission)

    def _adapt(self) -> None:
        """Choose the next dispatch's size from how long the latest finished one took.

        Only now and then: on some drivers reading a timestamp waits for the work in progress.
        """
        frame = self._frame
        if frame.frame_count < self._next_look:
            return
        self._next_look = 2 * frame.frame_count
        spent = frame.timings.get("pathtracer/trace", 0.0)
        size = dict(self._sizes).get(frame.timed_value, 0)
        if not spent or not size:
            return
        wanted = DISPATCH_MS / spent * size
        self._batch = max(1, min(int(wanted / self._band_rows), 4 * self._batch, MAX_SAMPLES))
        if wanted < self._band_rows / 4 and self._band_rows > 8:
            self._band_rows = max(int(wanted), 8)
            frame.rebuild(self._stages(self.size))
            frame.uniforms["path_sampling.row_count"] = self._band_rows

    # ---- results ------------------------------------------------------------------------------------

    def read(self, name: str) -> NDArray[Any]:
        if name == "radiance":
            return pathtracer.read_mean(self._frame, self.size)
        if name == "variance":
            return pathtracer.read_variance(self._frame, self.size, self.samples)
        if name not in self._frame:
            raise unknown_name("PathTracer: there is no result", name, self.OUTPUTS)
        return self._frame[name]

    @property
    def rays(self) -> int:
        """How many rays the picture has taken so far."""
        return int(self._frame["ray_count"].sum(dtype=np.uint64))
