"""The reference path tracer: the ground truth of every realtime test."""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.frame import PictureRenderer, SceneFrame
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Stage
from solari_vk.passes import brdf_table, pathtracer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.projection import CameraUniforms

AOVS = pathtracer.AOVS
DISPATCH_MS = 100.0  # what a dispatch should take: far below any driver's watchdog, far above its overhead
MAX_FIRST_PIXELS = 1 << 20  # of a first dispatch, before anything is measured
MAX_SAMPLES = 64  # of a pixel in one dispatch


class PathTracer(PictureRenderer):
    """The reference path tracer: progressive, unbiased, the ground truth of every realtime test.

    size: (width, height) in pixels. max_bounces: how many surfaces a path may leave, 0 shows emission
    only. seed: another one gives other noise. light_strategy: "mis", or "nee" or "brdf" alone, which
    agree in the mean. pixel_filter: "box", or the wider "gaussian" or "blackman_harris". layering: how
    diffuse sits under specular, "conserving", or Solari's "sum" (0.18) or "fresnel_product" (0.19).
    lambert: every surface is plain Lambert, for closed forms. Source: seed 004.

    The scene may be edited between calls of `render`. `close` frees what the device holds; closing the
    device does so too.
    """

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
            self._camera: Camera | None = None
            self._aovs: Frame | None = None  # made when first asked for
            self._owned.callback(self._drop_aovs)
            self._aovs_built: tuple[Any, ...] = ()  # what it was made for
            self._aovs_shown: tuple[Any, ...] | None = None
            self._begin_adapting(_max_rows(self.size), 0)
            table, self._table_buffers = brdf_table.compute(device)
            self._own(table)
            stages, external = self._stages(self.size), self._table_buffers
            self._frame = self._own(SceneFrame(device, self.binder, stages, external=external))
        except BaseException:
            self.close()
            raise

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        return [pathtracer.trace_stage(size, self._band_rows, self.settings)]

    def resize(self, size: tuple[int, int]) -> None:
        size = self._checked_size(size)
        rows = _max_rows(size)
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
        self._drop_aovs()
        self.reset()

    def reset(self) -> None:
        """Have the next call of `render` or `advance` start the picture anew."""
        self._shown = None

    def _drop_aovs(self) -> None:
        if self._aovs is not None:
            self._aovs.close()
            self._aovs = None

    # ---- rendering ----------------------------------------------------------------------------------

    def render(
        self,
        camera: Camera,
        samples: int = 256,
        *,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> NDArray[np.float32]:
        """Refine the picture until it has so many samples a pixel; returns linear radiance (height, width, 3).

        Starts anew when the camera, the scene or the size is another one than before, else goes on from
        the samples it has. time_limit: stop after so many seconds. progress: called with the samples done.
        """
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
        return self["radiance"]

    def advance(self, camera: Camera, max_samples: int = MAX_SAMPLES) -> None:
        """Submit the next samples for every pixel, as many as make a short dispatch, and don't wait for them."""
        self._prepare(camera)
        self._add_samples(min(self._batch, max_samples))
        self._adapt()

    def _prepare(self, camera: Camera) -> None:
        """Take up edits of the scene, and start anew if anything differs from what the picture shows."""
        self._checked_camera(camera)
        self.binder.update()
        view = (camera.transform.tobytes(), camera.vertical_fov, camera.near, *camera.jitter.tolist())
        shown = (self.binder.revision, self.size, *view)
        if shown != self._shown:
            self._shown = shown
            self._camera = copy.copy(camera)
            self.samples = 0
            CameraUniforms(self._frame.uniforms).write(self._camera, self.size)
            pathtracer.write_uniforms(self._frame.uniforms, self.settings)
            self._frame.uniforms["path_sampling.row_count"] = self._band_rows

    def _add_samples(self, count: int) -> None:
        """Trace so many samples for every pixel, one band of rows after the other."""
        uniforms = self._frame.uniforms
        uniforms["path_sampling.sample_index"] = self.samples
        uniforms["path_sampling.samples_per_dispatch"] = count
        try:
            for row in range(0, self.size[1], self._band_rows):
                uniforms["path_sampling.first_row"] = row
                self._sizes.append((self._frame.submit(), count * self._band_rows))
        except BaseException:
            self._shown = None  # some bands have these samples and some have not: the next call starts anew
            raise
        self.samples += count

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

    def __getitem__(self, name: str) -> NDArray[Any]:
        """An output as an array (height, width[, channels]): "radiance" or one of AOVS."""
        if self._shown is None or self.samples == 0:
            raise SolariError(f"PathTracer: render before asking for '{name}'")
        if name == "radiance":
            return pathtracer.read_mean(self._frame, self.size)
        if name == "variance":
            return pathtracer.read_variance(self._frame, self.size, self.samples)
        if name not in AOVS:
            raise SolariError(f"PathTracer has no output '{name}'; there are radiance, {', '.join(AOVS)}")
        return pathtracer.read_aov(self._first_hits(), name, self.size)

    def _first_hits(self) -> Frame:
        """The frame of the AOVs, run for what the picture shows."""
        rows = _max_rows(self.size)
        built = self.binder.version, self.size
        if self._aovs is None or self._aovs_built != built:
            self._drop_aovs()
            external = {**self.binder.resources, **self._table_buffers}
            self._aovs = Frame(self.device, [pathtracer.aov_stage(self.size, rows)], external=external)
            self._aovs_built, self._aovs_shown = built, None
        if self._aovs_shown != self._shown:
            self._aovs_shown = self._shown
            assert self._camera is not None
            CameraUniforms(self._aovs.uniforms).write(self._camera, self.size)
            self._aovs.uniforms["path_sampling.row_count"] = rows
            for row in range(0, self.size[1], rows):
                self._aovs.uniforms["path_sampling.first_row"] = row
                self._aovs.submit()
        return self._aovs

    @property
    def rays(self) -> int:
        """How many rays the picture has taken so far."""
        return int(self._frame["ray_count"].sum(dtype=np.uint64))


def _max_rows(size: tuple[int, int]) -> int:
    """Rows of a picture in the first dispatch, before anything is measured."""
    return min(size[1], max(MAX_FIRST_PIXELS // size[0], 1))
