"""The renderers of a batch's views: the stages of `PathTracer` and `Renderer` over the pictures of all views."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.batch.light_changes import LightChanges, LightState
from solari_vk.batch.view_buffer import ViewBuffer, sample_fields
from solari_vk.batch.view_cameras import ViewCameras
from solari_vk.batch.worlds import Worlds
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.lights.index_translation import with_decayed
from solari_vk.bound.lights.recent_changes import RecentEdits
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.gpu.shaders.spirv import Binding
from solari_vk.passes import reference, world_cache
from solari_vk.passes.many_views import grid, over_views, tiled
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import THIS_FRAME, Renderer
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Scene

Size = tuple[int, int]


class WorldBindings:
    """The worlds' resources, as frames have them bound."""

    def __init__(self, worlds: Worlds) -> None:
        self.worlds = worlds
        self._version = worlds.bindings_version  # of the resources that the frame has

    def show(self, frame: SceneFrame) -> None:
        """Have a frame, which has the scene's edits already, show what the worlds are now."""
        version = self.worlds.update()
        if version != self._version:
            frame.bind(self.worlds.resources)
            self._version = version


class BatchPathTracer(PathTracer):
    """The path tracer over a strip of views, whose result is `radiance_mean`."""

    TAKES_LISTS = True

    def __init__(
        self, device: Device, binder: SceneBinder, strip: Size, views: Buffer, worlds: Worlds, options: dict[str, Any]
    ) -> None:
        self._views = views
        self._worlds = worlds
        self._bindings = WorldBindings(worlds)
        super().__init__(device, binder, strip, **options)

    @property
    def frame(self) -> SceneFrame:
        """What has the results."""
        return self._frame

    @property
    def _dark_scenes(self) -> list[Scene]:
        return [] if self._worlds.may_add_light else super()._dark_scenes

    def _stages(self, size: Size) -> list[Stage]:
        return over_views(super()._stages(size))

    def _inputs(self) -> dict[str, Any]:
        return super()._inputs() | {"views": self._views, **self._worlds.resources}

    def trace(self, samples: int) -> None:
        """Trace new pictures with this many samples per pixel."""
        self._begin_picture()
        self._warn_of_darkness()
        self._frame.apply_edits()
        self._bindings.show(self._frame)
        reference.write_uniforms(self._frame.uniforms, self.settings)
        while self.samples < samples:
            self._add_samples(min(self._dispatch.samples, samples - self.samples))
            self._adapt_dispatches()


class BatchRenderer(Renderer):
    """The realtime renderer over a grid of views. Views share lights and the world cache, and nothing else."""

    TAKES_LISTS = True

    def __init__(
        self,
        device: Device,
        binder: SceneBinder,
        size: Size,
        count: int,
        views_binding: Binding,
        worlds: Worlds,
        options: dict[str, Any],
    ) -> None:
        self._grid = grid(size, count, device.properties.limits.maxImageDimension2D)
        self._worlds = worlds
        self._world_count = worlds.count
        self._bindings = WorldBindings(worlds)
        self._change = np.zeros(count)  # LightChanges.change, as each view has seen it
        self._camera_jitter = np.zeros((count, 2))  # of the latest frame's cameras
        self._shifts = np.zeros((2, 2, count))  # their jitter and principal_shift, as x and y in rendered pixels
        self._jitter_begins = np.zeros(count, np.int64)  # where each view begins in the sequence of jitter
        self._view_edits = RecentEdits()  # as each view has seen them, with histories of its own
        # Made before the frame that reads them, and freed here if that can't be made: `_owned` doesn't exist yet.
        owned: list[ViewBuffer | Buffer] = []
        try:
            self.views = ViewBuffer(
                device, worlds.port, views_binding, count, self._grid[0], world_cache.parts(worlds.count)
            )
            owned.append(self.views)
            self._changes = LightChanges(device, worlds.count)
            owned.append(self._changes.buffer)
            super().__init__(device, binder, size, **options)
        except BaseException:
            for one in owned:
                one.destroy()
            raise
        for one in owned:
            self._owned.callback(one.destroy)
        self._all_views = self._frame.uniforms.writer("all_views", THIS_FRAME[:6])

    @property
    def frame(self) -> SceneFrame:
        """What has the results."""
        return self._frame

    @property
    def _dark_scenes(self) -> list[Scene]:
        return [] if self._worlds.may_add_light else super()._dark_scenes

    @property
    def gbuffer(self) -> str:
        """How the surface of a pixel is found: raster draws one view at a time."""
        return "traced"

    def _checked_size(self, size: Size) -> Size:
        super()._checked_size(tiled(size, self._grid))
        return size

    def _stages(self, picture: Size) -> list[Stage]:
        settings = self.settings
        needed = {
            "lighting=paths": settings.lighting == "paths",
            "gbuffer=traced": settings.gbuffer != "raster",
            "restir=off where there are several worlds": not (settings.restir and self._worlds.has_tables),
            "frame_ms=0": settings.frame_ms <= 0,
        }
        for setting, is_met in needed.items():
            if not is_met:
                raise SolariError(f"Batch: views are rendered with the setting {setting}")
        return over_views(super()._stages(picture))

    def _inputs(self) -> dict[str, Any]:
        of_views = {"views": self.views.buffer, "world_changes": self._changes.buffer}
        return super()._inputs() | of_views | dict(self._worlds.resources)

    def _remember_build(self) -> None:
        super()._remember_build()
        # The sequence stands there twice, so that the offsets of a whole period follow on each place of the first one.
        self._offsets = np.array(2 * self._jitters).T

    def _write_settings(self) -> None:
        super()._write_settings()
        # Each world has cells of its own, of which as many are updated as of a single one.
        cap = self.settings.world_cache_update_cap * self._world_count
        self._frame.uniforms["world_cache_settings.update_cap"] = min(cap, 0xFFFFFFFF)

    def render_views(
        self, cameras: ViewCameras, reset: NDArray[np.bool_], seeds: NDArray[np.uint32], keeps_cache: bool
    ) -> None:
        """Render the next frame. reset, (N,) or one for all: views without a history. keeps_cache: whether the world
        cache is that of earlier frames."""
        self._needs_traced_camera = bool(cameras.lenses)
        self._prepare()
        self._bindings.show(self._frame)
        states = self._worlds.light_states or [LightState.of(self.binder.lights)]
        self._changes.update(states, self.settings.world_cache_cell_size)
        if not self._has_history:
            reset = np.ones_like(reset)
            keeps_cache = False
        try:
            self._write_views(cameras, reset, seeds)
            self._write_shared(keeps_cache, has_history=keeps_cache or not reset.all())
            self._has_history = True
            self._frame.submit_applied()
        except BaseException:
            self.reset()
            raise
        self.frame_count += 1

    def _write_views(self, cameras: ViewCameras, reset: NDArray[np.bool_], seeds: NDArray[np.uint32]) -> None:
        views = self.views
        # A view that is reset has no history that changes of light could shorten.
        if self._change.any() or not self._changes.is_still:
            change = with_decayed(self._change, self._of_views(self._changes.newest))
            self._change = np.where(reset, 0.0, change)
        counts = self._worlds.edit_counts
        self._edits.update(counts)
        self._view_edits.update(self._of_views(counts))
        self._view_edits.forget(reset)
        blended = self._view_edits.blended
        expected = np.maximum(self._view_edits.share, self._change)
        # In most frames of a batch only transforms and jitter change, which `upload_frame` uploads.
        sources = cameras.records, cameras.jitter, seeds, self._change, self._camera_jitter, self._offsets
        size = self._built_render_size
        if views.must_write(sources, (size, *self._worlds.assignment_key, blended.tobytes(), expected.tobytes())):
            self._write_records(cameras, seeds, {"blended_changed": blended, "expected_change": expected})
        offsets = np.zeros((2, 1))
        if self.settings.jitter:
            offsets = self._offsets[:, self.frame_count % len(self._jitters) :].take(self._jitter_begins, axis=1)
        views.offsets[0] = self._shifts[0] + offsets + self._shifts[1]
        views.offsets[1] = offsets
        self._camera_jitter = cameras.jitter
        views.upload_frame(cameras, reset, self.frame_count & 0xFFFFFFFF)

    def _of_views(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of each world, or one of all, for each view."""
        return np.repeat(values, len(self._change) // values.shape[-1], axis=-1)

    def _write_records(self, cameras: ViewCameras, seeds: NDArray[np.uint32], edits: Mapping[str, Any]) -> None:
        """Write what changes seldom. edits: what FrameValues says of edits of the scenes."""
        views = self.views
        size = self._built_render_size
        samples = sample_fields(cameras, self.size, size, self.frame_count, seeds)
        views.write_cameras(cameras, samples)
        self._worlds.assign_views(views)
        frame = views.records["frame"]
        frame["seed"] = seeds
        frame["exposure"] = cameras.exposure
        frame["lighting_change"] = self._change
        for name, values in edits.items():
            frame[name] = values
        frame["user_jitter_change"] = cameras.jitter - self._camera_jitter
        shifts = cameras.jitter * np.divide(size, self.size), samples["principal_shift"]
        self._shifts = np.array([shift.T for shift in shifts], order="C")
        # As `Renderer` does for its seed, so that a view has the jitter of a renderer of its own.
        self._jitter_begins = 7 * seeds.astype(np.int64) % len(self._jitters)

    def _write_shared(self, keeps_cache: bool, has_history: bool) -> None:
        """Write the uniforms of passes that go over all views at once, such as those of the world cache. has_history:
        whether the cache, or a view, has light of earlier frames, which changes of lights outdate."""
        if not has_history:
            self._changes.clear()
            self._edits.forget()
        self._changes.upload(self._edits.share)
        change = self._changes.change.max()
        expected = max(change, self._edits.share.max())
        self._all_views.write(self.frame_count & 0xFFFFFFFF, self.seed, keeps_cache, 0.0, change, expected)

    def picture_of(self, values: NDArray[Any]) -> NDArray[Any]:
        """The pictures (N, height, width, channels) of an image that has them in the grid."""
        columns, rows = self._grid
        width, height = self.size
        apart = values.reshape(rows, height, columns, width, -1).swapaxes(1, 2)
        return apart.reshape(rows * columns, height, width, -1)[: len(self.views.records)]
