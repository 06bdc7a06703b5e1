"""The reference path tracer: the ground truth of every realtime test."""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import CameraUniforms, Projection
from solari_vk.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.frame import SceneFrame
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.output import oidn
from solari_vk.output.error import ErrorEstimate
from solari_vk.passes import pathtracer
from solari_vk.picture_renderer import PictureRenderer
from solari_vk.rendered import RenderedFrame
from solari_vk.scene.model import Camera, Scene

DISPATCH_MS = 100.0  # aimed at: far shorter than any driver's watchdog allows, far longer than a dispatch's overhead
MAX_SAMPLES = 64  # per pixel in one dispatch
MIN_ROWS = 8  # of a band
FIRST_DENOISED_LOOK = 8  # samples of the first denoised picture whose error is estimated
_SEED_STEP = 0x9E3779B9  # odd, so that the seeds of 2^32 pictures differ


def numbered_seed(seed: int, number: int) -> int:
    """The seed of one of many pictures with independent noise; picture 0 has `seed` itself."""
    return (seed + number * _SEED_STEP) % 2**32


def numbered_seeds(seed: int, count: int) -> NDArray[np.uint32]:
    """`numbered_seed` of the pictures from 0 to count - 1."""
    return (seed + np.arange(count, dtype=np.uint64) * _SEED_STEP).astype(np.uint32)


class PathTracer(PictureRenderer):
    """The reference path tracer: progressive, unbiased, the ground truth of every realtime test.

    size: (width, height) in pixels. max_bounces: the number of surfaces at which a path may be scattered; 0 shows
    emission only. seed: a whole number; the same seed gives the same pictures, another seed gives independent noise.
    light_strategy: "nee" (light sampling), "brdf" (BRDF sampling) or "mis" (both, weighted by multiple importance
    sampling); all three have the same expectation. pixel_filter: "box", or the wider "gaussian" or "blackman_harris".
    layering: how the diffuse lobe is attenuated below the specular lobe, "conserving" or Solari's "fresnel_product".
    lambert: every surface is Lambertian, as closed forms need. first_sample: the number of the picture's first sample;
    samples of one seed are points of low-discrepancy sequences, so that pictures of the samples 0 to 63 and 64 to 127
    have together less noise than two seeds. Source: the document on the reference path tracer.

    The scene may be edited between calls of `render`. `close` frees the path tracer's memory on the device; closing the
    device frees it as well. Raises SolariError for a size that the device can't hold and for wrong options.
    """

    OUTPUTS = ("radiance", "raw_radiance", *pathtracer.AOVS)
    LARGEST_PIXEL_BYTES = pathtracer.LARGEST_PIXEL_BYTES
    IN_IMAGES = False

    @checked_keywords()
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
        first_sample: int = 0,
    ) -> None:
        self.samples: int
        """The number of samples per pixel in the picture so far."""
        self.settings = pathtracer.Settings(
            max_bounces, seed, light_strategy, pixel_filter, layering, lambert, first_sample
        )
        super().__init__(device, scene, size)
        try:
            self._shown: tuple[Any, ...] | None = None  # scene, size and camera of the picture
            self._begin_picture(denoises=False)
            self._pixel_ms = 0.0  # milliseconds of a sample of a pixel, 0 until they are measured
            self._begin_adapting(pathtracer.max_rows(self.size), 0)
            stages = self._stages(self.size)
            self._frame = self._owned.enter_context(SceneFrame(device, self.binder, stages, external=self._inputs()))
        except BaseException:
            self.close()
            raise

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        return [pathtracer.trace_stage(size, self._band_rows, self.settings)]

    def _inputs(self) -> dict[str, Any]:
        """What the stages' shaders are given beside the scene, by name."""
        return dict(self._tables)

    def resize(self, size: tuple[int, int]) -> None:
        size = self._checked_size(size)
        rows = pathtracer.max_rows(size)
        if self._pixel_ms:
            rows = max(min(rows, int(DISPATCH_MS / (self._pixel_ms * size[0]))), min(MIN_ROWS, rows))
        self._frame.rebuild([pathtracer.trace_stage(size, rows, self.settings)])
        self.size = size
        self._begin_adapting(rows, self._frame.frame_count)
        self.reset()

    def _begin_adapting(self, rows: int, frame_count: int) -> None:
        """Begin with dispatches of `rows` rows and one sample per pixel, and measure them from `frame_count` on."""
        self._band_rows, self._batch = rows, 1
        self._next_look = frame_count + 4  # when `_adapt` measures next; in the first frames drivers may compile
        # The timeline value of each of the latest dispatches, and its rows times samples.
        self._sizes: deque[tuple[int, int]] = deque(maxlen=4)

    @property
    def seed(self) -> int:
        """The seed of the noise. Assigning another one discards the picture's samples."""
        return self.settings.seed

    @seed.setter
    def seed(self, seed: int) -> None:
        self.settings = dataclasses.replace(self.settings, seed=seed)
        self.reset()

    @property
    def first_sample(self) -> int:
        """The number of the picture's first sample. Assigning another one discards the picture's samples."""
        return self.settings.first_sample

    @first_sample.setter
    def first_sample(self, number: int) -> None:
        self.settings = dataclasses.replace(self.settings, first_sample=number)
        self.reset()

    def reload(self) -> None:
        super().reload()
        self.reset()

    def reset(self) -> None:
        """Discard the picture's samples."""
        self._shown = self._latest = None
        self._begin_picture(self._denoises)

    def _begin_picture(self, denoises: bool) -> None:
        self.samples = 0
        self._begun = 0, 0  # samples that are being traced, and the row of the picture that comes next
        self._denoised: tuple[int, NDArray[np.float32]] | None = None  # number of samples, and the picture
        self._guides: list[NDArray[Any]] | None = None
        self._set_denoising(denoises)

    def _set_denoising(self, denoises: bool) -> None:
        self._denoises = denoises
        self._estimate = ErrorEstimate(FIRST_DENOISED_LOOK if denoises else 1)

    # ---- rendering ----------------------------------------------------------------------------------

    @checked_keywords()
    def render(
        self, camera: Camera | None = None, samples: int = 256, *, time_limit: float | None = None,
        progress: Callable[[int], None] | None = None, denoise: bool = False, target_error: float | None = None,
    ) -> RenderedFrame:  # fmt: skip
        """Refine the picture until it has `samples` samples per pixel, and return it.

        camera: by default the scene's. Samples of earlier calls count, unless the camera, the scene or the size has
        changed since then. time_limit: the time in seconds after which rendering stops early. progress: is called with
        the number of samples per pixel after each dispatch. denoise: `frame["radiance"]` is denoised when it is read,
        by Intel Open Image Denoise with the surfaces' albedo and normals; `frame["raw_radiance"]` is the mean of the
        samples. target_error: the `error` at which rendering stops early; without it the error isn't estimated. Raises
        SolariError for a sample count below 1, a negative target, and if OIDN isn't installed.
        """
        self._frame.check_open()
        camera = self._camera_or_default(camera)
        if not isinstance(samples, int) or samples < 1:
            raise SolariError(f"PathTracer.render: samples must be a whole number from 1 on, not {quoted(samples)}")
        if target_error is not None and not (isinstance(target_error, (int, float)) and target_error >= 0):
            raise SolariError(f"PathTracer.render: target_error must be at least 0, not {quoted(target_error)}")
        if denoise:
            oidn.check_installed()
        if denoise != self._denoises:
            self._set_denoising(denoise)
        started = time.perf_counter()
        self._prepare(camera)
        self._warn_of_darkness()
        if denoise:
            self.read_guides()  # now, because the scene may be edited before the picture is read
        while self.samples < samples:
            next_look = samples if target_error is None else min(samples, self._estimate.next_count)
            self.advance(camera, max(next_look - self.samples, 1))
            if target_error is not None and self._estimate_error() <= target_error:
                break
            if progress is not None:
                progress(self.samples)
            if time_limit is not None and time.perf_counter() - started > time_limit:
                break
        assert self._latest is not None
        return self._finish(self._latest)

    def _estimate_error(self) -> float:
        estimate, samples = self._estimate, self.samples
        if samples >= estimate.next_count:
            mean = self.read("raw_radiance")
            if self._denoises:
                estimate.look_at_other(samples, mean, lambda: self.read("radiance"))
            else:
                estimate.look_at_mean(samples, mean)
        return estimate.error

    def advance(self, camera: Camera | None = None, max_samples: int = MAX_SAMPLES, bands: int | None = None) -> None:
        """Submit a short dispatch with the next samples of all pixels, or of so many bands of rows below those of the
        latest call, without waiting for it. `samples` are those that all pixels have."""
        camera = self._camera_or_default(camera)
        self._prepare(camera)
        submission = self._add_samples(min(self._batch, max_samples), bands)
        self._latest = RenderedFrame(self, camera, self._projection, submission)
        if self._begun[0] == 0:
            self._adapt()

    @property
    def begun(self) -> tuple[int, float]:
        """The number of samples that `advance` traces by bands, and the share of the rows that have them already."""
        count, row = self._begun
        return count, min(row / self.size[1], 1.0)

    def _prepare(self, camera: Camera) -> None:
        """Apply edits of the scene; discard the samples if the scene, the size or the camera has changed."""
        self._note_camera(camera)
        self.binder.update()
        projection = Projection.of(camera, self.size)
        shown = (self.binder.revision, self.size, *projection.view)
        if shown != self._shown:
            self._shown, self._projection = shown, projection
            self._begin_picture(self._denoises)
            CameraUniforms(self._frame.uniforms).write(camera, self.size)
            pathtracer.write_uniforms(self._frame.uniforms, self.settings)
            self._frame.uniforms["path_sampling.row_count"] = self._band_rows

    def _add_samples(self, count: int, bands: int | None = None) -> int:
        """Trace `count` samples of all pixels, or what is left of the latest, in bands; returns the timeline value."""
        uniforms = self._frame.uniforms
        count, first = self._begun if self._begun[0] else (count, 0)
        uniforms["path_sampling.sample_index"] = self.samples
        uniforms["path_sampling.samples_per_dispatch"] = count
        try:
            for row in range(first, self.size[1], self._band_rows)[:bands]:
                uniforms["path_sampling.first_row"] = row
                submission = self._frame.submit()
                self._sizes.append((submission, count * self._band_rows))
                self._begun = count, row + self._band_rows
        except BaseException:
            self.reset()  # some bands have these samples and others don't
            raise
        if self._begun[1] >= self.size[1]:
            self._begun = 0, 0
            self.samples += count
        return submission

    def _adapt(self) -> None:
        """Choose the next dispatches' size by the time that the latest finished one took.

        This is done rarely, because on some drivers reading a timestamp waits for work in progress.
        """
        frame = self._frame
        if frame.frame_count < self._next_look:
            return
        self._next_look = 2 * frame.frame_count
        spent = sum(frame.timings.values())
        size = dict(self._sizes).get(frame.timed_value, 0)
        if not spent or not size:
            return
        wanted = DISPATCH_MS / spent * size
        self._pixel_ms = spent / (size * self.size[0])
        self._batch = max(1, min(int(wanted / self._band_rows), 4 * self._batch, MAX_SAMPLES))
        if wanted < self._band_rows / 4 and self._band_rows > MIN_ROWS:
            self._band_rows = max(int(wanted), MIN_ROWS)
            frame.rebuild(self._stages(self.size))
            frame.uniforms["path_sampling.row_count"] = self._band_rows

    # ---- results ------------------------------------------------------------------------------------

    def read(self, name: str) -> NDArray[Any]:
        if name == "radiance" and self._denoises:
            return self._read_denoised().copy()
        if name in ("radiance", "raw_radiance"):
            return pathtracer.read_mean(self._frame, self.size)
        if name == "variance":
            return pathtracer.read_variance(self._frame, self.size, self.samples)
        if name not in self._frame:
            raise unknown_name("PathTracer: there is no result", name, self.OUTPUTS)
        return self._frame[name]

    def read_guides(self) -> list[NDArray[Any]]:
        """What OIDN is guided by: means of the albedo and of the shading normal, (height, width, 3) each."""
        if self._guides is None:
            self._guides = self.first_hits.read_means(("albedo", "shading_normal"), self._projection, self.size)
        return self._guides

    def _read_denoised(self) -> NDArray[np.float32]:
        if self._denoised is None or self._denoised[0] != self.samples:
            self._denoised = self.samples, oidn.denoise(self.read("raw_radiance"), *self.read_guides())
        return self._denoised[1]

    @property
    def error(self) -> float:
        """The picture's estimated error relative to its luminance, 0.01 for 1 %: the root of relMSE.

        inf before there are enough samples, and if `render` is called without target_error. For a denoised picture, it
        is the error with at most half as many samples, and bias counts; the picture is compared with later samples.
        """
        return self._estimate.error

    @property
    def rays(self) -> int:
        """The number of rays traced for the picture so far."""
        return int(self._frame["ray_count"].sum(dtype=np.uint64))
