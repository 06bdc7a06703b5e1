"""The reference path tracer: the ground truth of every realtime test."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import JITTERS, CameraUniforms, Projection
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.output import oidn
from solari_vk.passes import reference
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.passes.reference import MAX_SAMPLES
from solari_vk.renderers.dispatch_size import DispatchSize
from solari_vk.renderers.motion_blur import CallbackCameras, PoseCallback, checked_pose, pose_after_error
from solari_vk.renderers.renderer_base import RendererBase, by_pixel
from solari_vk.renderers.results import RenderedFrame
from solari_vk.renderers.sample_counts import SampleCounts, check_target
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.shutter import Moment, Shutter

OIDN_GUIDES = ("albedo", "shading_normal")


class PathTracer(RendererBase):
    """The reference path tracer: progressive, unbiased, the ground truth of every realtime test.

    size: (width, height) in pixels. max_bounces: the number of surfaces at which a path may be scattered; 0 shows
    emission only. seed: a whole number; the same seed gives the same pictures, another seed gives independent noise.
    light_strategy: "nee" (light sampling), "brdf" (BRDF sampling) or "mis" (both, weighted by multiple importance
    sampling); all three have the same expectation. pixel_filter: "box", or the wider "gaussian" or "blackman_harris".
    layering: how the diffuse lobe is attenuated below the specular lobe, "conserving" or Solari's "fresnel_product",
    where films dim no diffuse light. lambert: all surfaces are Lambertian, as closed forms need. first_sample: number
    of the picture's first sample; samples of one seed are points of low-discrepancy sequences, so that pictures of the
    samples 0 to 63 and 64 to 127 have less noise than two seeds. Source: document on the reference path tracer.

    The scene may be edited between calls of `render`. `close` frees the path tracer's memory on the device; closing the
    device frees it as well. Raises SolariError for a size that the device can't hold and for wrong options.
    """

    OUTPUTS = ("radiance", "raw_radiance", *FIRST_HITS, "variance")
    unfinished_bands = 0, 0
    """While `advance` traces some samples in bands of rows: their number per pixel, and the row that comes next. 0, 0
    when all rows have the same samples."""
    LARGEST_PIXEL_BYTES = reference.LARGEST_PIXEL_BYTES
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
        self.settings = reference.Settings(
            max_bounces, seed, light_strategy, pixel_filter, layering, lambert, first_sample
        )
        super().__init__(device, scene, size)
        try:
            self._accumulation_key: tuple[Any, ...] | None = None  # scene, size and camera of the picture
            self._callback_cameras = CallbackCameras()
            properties = device.properties
            max_paths = reference.max_paths(properties.kind, properties.limits.maxStorageBufferRange)
            self._dispatch = DispatchSize(self.size, max_paths)
            stages = self._all_stages(self.size)
            self._frame = self._owned.enter_context(SceneFrame(device, self.binder, stages, external=self._inputs()))
            self._sample_counts = SampleCounts(self._frame, self.size, self.read)
            self._begin_picture()
        except BaseException:
            self.close()
            raise

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        width, height = super()._checked_size(size)
        most = reference.max_width(self.device.properties.limits.maxStorageBufferRange)
        if width > most:
            raise SolariError(f"PathTracer: {width}x{height} is wider than {most:,} pixels: render parts of it")
        return width, height

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        return [reference.trace_stage(size, self._dispatch.rows, self._dispatch.max_paths, self.settings)]

    def _inputs(self) -> dict[str, Any]:
        """What the stages' shaders are given beside the scene, by name."""
        return dict(self._lookup_tables)

    def resize(self, size: tuple[int, int]) -> None:
        size = self._checked_size(size)
        before = self._dispatch
        self._dispatch = DispatchSize(size, before.max_paths, self._frame.frame_count, before.pixel_ms)
        try:
            self._frame.rebuild(self._all_stages(size))
        except BaseException:
            self._dispatch = before
            raise
        # Nothing may have changed if the device has no memory for this size, so all else follows the rebuild.
        self._size = size
        self._sample_counts = SampleCounts(self._frame, size, self.read)
        self.reset()

    def _rebuild(self) -> None:
        self._frame.rebuild(self._all_stages(self.size))
        self.reset()

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
        self._accumulation_key = None
        self._latest = None
        self._begin_picture()

    def _begin_picture(self) -> None:
        self._sample_counts.begin()
        self.unfinished_bands = 0, 0
        self._denoised: tuple[int, NDArray[np.float32]] | None = None  # number of samples, and the picture
        self._guides: list[NDArray[Any]] | None = None

    @property
    def samples(self) -> int:
        """The number of samples per pixel in the picture so far, of the pixel that has most."""
        return self._sample_counts.samples

    # ---- rendering ----------------------------------------------------------------------------------

    @checked_keywords()
    def render(
        self,
        camera: Camera | None = None,
        samples: int = 256,
        *,
        time_limit: float | None = None,
        progress: Callable[[int], None] | None = None,
        denoise: bool = False,
        target_error: float | None = None,
        shutter: Shutter | None = None,
        pose: Callable[[float], Any] | None = None,
    ) -> RenderedFrame:
        """Refine the picture until it has `samples` samples per pixel, and return it.

        camera: by default the scene's. Samples of earlier calls count, unless the camera, the scene or the size has
        changed since then. time_limit: the time in seconds after which rendering stops early. progress: is called with
        the number of samples per pixel after each dispatch. denoise: `frame["radiance"]` is denoised when it is read,
        by Intel Open Image Denoise with the surfaces' albedo and normals; `frame["raw_radiance"]` is the mean of the
        samples. target_error: the `error` at which rendering stops early; None estimates none. Unless denoised, easy
        pixels get fewer samples, which biases those in which bright samples are rarer than one in a few thousand.

        shutter: exposes a new picture at its times, for which `pose(seconds)`, by default `scene.animate`, poses the
        scene, and may return the camera. The scene stays as in the middle of the exposure, which results at pixels'
        centers show. Raises SolariError for a sample count below 1, a negative target or one with a shutter, a shutter
        without a pose in a scene without animations, and if OIDN isn't installed.
        """
        self._frame.check_open()
        camera = self._camera_or_default(camera)
        exposes = shutter is not None or pose is not None
        self._check_request(samples, target_error, exposes, denoise)
        samples = int(samples)  # numpy's would wrap around
        started = time.perf_counter()

        def is_late() -> bool:
            return time_limit is not None and time.perf_counter() - started > time_limit

        if exposes:
            return self._render_exposed(camera, samples, shutter, pose, denoise, is_late, progress)
        self._prepare(camera)
        # Before the target is known, so that all pixels have equally many samples when the first error is estimated.
        if self.unfinished_bands[0]:
            self._add_samples(0)  # the rest of what `advance` has begun
        self._sample_counts.set_target(target_error, denoise, samples)
        self._warn_of_darkness()
        if denoise:
            self.read_guides()  # now, because the scene may be edited before the picture is read
        while wanted := self._sample_counts.samples_to_take(samples):
            self.advance(camera, wanted)
            if progress is not None:
                progress(self.samples)
            if is_late():
                break
        assert self._latest is not None
        self._latest.camera = camera  # another one, perhaps with another exposure, where no sample was missing
        return self._finish(self._latest)

    def _check_request(self, samples: Any, target_error: Any, exposes: bool, denoise: bool) -> None:
        """Raise SolariError for a number of samples or a target that no picture can have."""
        if not isinstance(samples, Integral) or samples < 1:
            raise SolariError(f"PathTracer.render: samples must be a whole number from 1 on, not {quoted(samples)}")
        check_target(target_error, "PathTracer.render")
        if denoise:
            oidn.check_installed()
        if exposes and target_error is not None:
            raise SolariError("PathTracer.render: pictures with a shutter have no target_error: leave it out")

    def advance(self, camera: Camera | None = None, max_samples: int = MAX_SAMPLES, bands: int | None = None) -> None:
        """Submit a short dispatch with the next samples of all pixels. With `bands`, only of so many bands of rows,
        below those of the call before."""
        camera = self._camera_or_default(camera)
        self._prepare(camera)
        self._sample_counts.demand_more()
        count = self._sample_counts.limited(min(self._dispatch.samples, max_samples))
        timeline_value = self._add_samples(count, bands)
        self._latest = RenderedFrame(self, camera, self._projection, timeline_value)
        self._adapt_dispatches()

    def _prepare(self, camera: Camera) -> None:
        """Apply edits of the scene; discard the samples if the scene, the size or the camera has changed."""
        self._prepare_lens(camera)
        self.binder.update()
        self._back_sides.count_and_look(self.binder, camera, self.size)
        projection = Projection.of(camera, self.size)
        # Samples of earlier calls count only for the same scene through the same camera.
        key = (self.binder.scene_revision, self.size, *projection.view)
        if key != self._accumulation_key:
            self._accumulation_key = key
            self._projection: Projection = projection
            self._begin_picture()
            CameraUniforms(self._frame.uniforms, self.binder.origin).write(camera, self.size)
            reference.write_uniforms(self._frame.uniforms, self.settings)

    def _add_samples(self, count: int, bands: int | None = None) -> int:
        """Trace `count` samples of all pixels, or of so many bands of rows; where earlier samples lack rows, trace
        these first. Returns the device's timeline value."""
        first = self._sample_counts.first
        height = self.size[1]
        top = 0
        if self.unfinished_bands[0]:
            count, top = self.unfinished_bands
        # A picture that `advance` has begun goes on with the samples and the row at which it stopped.
        below = height if bands is None else min(top + bands * self._dispatch.rows, height)
        try:
            timeline_value = self._trace_rows(top, below, first, first + count)
        except BaseException:
            self.reset()  # some bands have these samples and others don't
            raise
        self.unfinished_bands = (count, below) if below < height else (0, 0)
        return timeline_value

    def _trace_rows(self, top: int, below: int, first: int, end: int) -> int:
        """Trace the samples from `first` up to `end` of the rows from `top` up to `below`, which have those before;
        returns the device's timeline value. Samples count when the last row has them."""
        uniforms = self._frame.uniforms
        timeline_value = 0
        for sample in range(first, end, self._dispatch.samples):
            count = min(end - sample, self._dispatch.samples)
            uniforms["path_sampling.sample_index"] = sample
            uniforms["path_sampling.samples_per_dispatch"] = count
            # Bands of rows, because a dispatch over the whole picture may take longer than a watchdog allows.
            for row in range(top, below, self._dispatch.rows):
                rows = min(self._dispatch.rows, below - row)
                uniforms["path_sampling.first_row"] = row
                uniforms["path_sampling.row_count"] = rows
                timeline_value = self._frame.submit()
                self._dispatch.record(timeline_value, count, rows)
        if below == self.size[1]:
            self._sample_counts.record_samples(end - self._sample_counts.first)
        return timeline_value

    def _adapt_dispatches(self) -> None:
        """Choose the next dispatches' size by the time of the latest ones, where these tell what a sample costs."""
        if self.unfinished_bands[0] or self._sample_counts.is_uneven:
            return
        if self._dispatch.adapt(self._frame):
            self._frame.rebuild(self._all_stages(self.size))

    # ---- pictures with a shutter ----------------------------------------------------------------------

    def _render_exposed(
        self,
        camera: Camera,
        samples: int,
        shutter: Any,
        pose: Any,
        denoise: bool,
        is_late: Callable[[], bool],
        progress: Callable[[int], None] | None,
    ) -> RenderedFrame:
        """A new picture whose samples show the scene at the times of an exposure; the scene stays as in its middle.

        What `progress` raises ends the exposure and is raised again, with the picture so far as the latest."""
        self._sample_counts.set_target(None, denoise)
        pose = checked_pose(self.binder.scene, shutter, pose, type(self).__name__)
        guides: list[NDArray[Any]] = []
        timeline_value = 0
        raised: BaseException | None = None
        try:
            for number, moment in enumerate(shutter.moments(samples, self.size[1], self.settings.seed)):
                shown = self._pose_scene(camera, pose, moment.time)
                if number == 0:
                    self._begin_picture()
                    self._frame.apply_edits()
                    reference.write_uniforms(self._frame.uniforms, self.settings)
                # Without a history: each time has a camera of its own, and the samples add up to one mean.
                CameraUniforms(self._frame.uniforms, self.binder.origin).write(shown, self.size)
                timeline_value = self._trace_rows(*moment.rows, *moment.samples)
                if denoise:
                    self._add_guides(guides, moment, samples)
                # Only between samples of all rows, since a picture can't end with rows that have more.
                if moment.rows[1] == self.size[1]:
                    raised = _raised_by(progress, self.samples)
                    if raised or is_late():
                        break
                self._adapt_dispatches()
            shown = self._pose_scene(camera, pose, shutter.middle)
        except BaseException:
            self.reset()
            pose_after_error(pose, shutter)
            raise
        self._accumulation_key = None  # so that the next picture is a new one
        # Guides are means over all samples that were asked for, and the picture may have ended early.
        self._guides = [mean * np.float32(samples / self.samples) for mean in guides] or None
        frame = RenderedFrame(self, shown, self._projection, timeline_value, exposed=True)
        self._callback_cameras.remember(shown, camera)
        self._finish(frame)
        if raised is not None:
            raise raised
        return frame

    def _pose_scene(self, camera: Camera, pose: PoseCallback, seconds: float) -> Camera:
        """PoseCallback the scene and apply its edits; returns the camera."""
        shown = self._callback_cameras.pose(pose, seconds, camera)
        self._prepare_lens(shown)
        self.binder.update()
        self._back_sides.count_and_look(self.binder, shown, self.size)
        self._warn_of_darkness()
        self._projection = Projection.of(shown, self.size)
        return shown

    def _add_guides(self, guides: list[NDArray[Any]], moment: Moment, samples: int) -> None:
        """Add a ray of each pixel at the time of a moment, weighted with its share of the samples, in its rows."""
        top, below = moment.rows
        offset = JITTERS[moment.samples[0] % len(JITTERS)]
        found = self.first_hits.read_at(OIDN_GUIDES, self._projection, self.size, offset)
        if not guides:
            guides += [np.zeros_like(values) for values in found]
        share = np.float32((moment.samples[1] - moment.samples[0]) / samples)
        for mean, values in zip(guides, found, strict=True):
            mean[top:below] += share * values[top:below]

    # ---- results ------------------------------------------------------------------------------------

    def read(self, name: str) -> NDArray[Any]:
        if name == "radiance" and self._sample_counts.denoises:
            return self._read_denoised().copy()
        if name in ("radiance", "raw_radiance"):
            return reference.read_mean(self._frame, self.size)
        if name == "variance":
            return reference.read_variance(self._frame, self.sample_counts)
        if name not in self._frame:
            raise unknown_name("PathTracer: there is no result", name, self.outputs)
        return by_pixel(self._frame[name], [self.size])

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        if (name == "radiance" and self._sample_counts.denoises) or name == "variance":
            raise SolariError(f"PathTracer: '{name}' is made on the host: there is no tensor of it on the device")
        known = ("radiance", "raw_radiance", *self._own_stages.outputs(self._frame))
        if name not in known:
            raise unknown_name("PathTracer: there is no tensor", name, known)
        resource = "radiance_mean" if name in ("radiance", "raw_radiance") else name
        return by_pixel(self._frame.tensor(resource), [self.size])

    def read_guides(self) -> list[NDArray[Any]]:
        """What OIDN is guided by: means of the albedo and of the shading normal, (height, width, 3) each."""
        if self._guides is None:
            self._guides = self.first_hits.read_means(OIDN_GUIDES, self._projection, self.size)
        return self._guides

    def _read_denoised(self) -> NDArray[np.float32]:
        # Denoising takes longer than many samples, and a picture may be read several times.
        if self._denoised is None or self._denoised[0] != self.samples:
            self._denoised = self.samples, oidn.denoise(self.read("raw_radiance"), *self.read_guides())
        return self._denoised[1]

    @property
    def error(self) -> float:
        """The picture's estimated error relative to its luminance, 0.01 for 1 %: the root of relMSE.

        inf before there are enough samples, and without target_error, of which 0 takes all samples. Of a denoised one
        it is noise and bias of an earlier one with at most half the samples, which the samples since then show."""
        return self._sample_counts.error

    @property
    def sample_counts(self) -> NDArray[np.int64]:
        """The number of samples (height, width) of each pixel; they differ where `target_error` chose them."""
        return self._sample_counts.counts

    @property
    def rays(self) -> int:
        """The number of rays traced for the picture so far."""
        return int(self._frame["ray_count"].sum(dtype=np.uint64))


def _raised_by(progress: Callable[[int], None] | None, samples: int) -> BaseException | None:
    """What a call of `progress` raises, None if nothing."""
    try:
        if progress is not None:
            progress(samples)
    except BaseException as error:
        return error
    return None
