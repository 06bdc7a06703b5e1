"""The realtime renderer. `render` is a frame on the host, `_stages` is what it runs on the device, top to bottom."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, is_name, quoted, unknown_name
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.features import ABSORPTION, LOBES
from solari_vk.bound.lights.index_translation import IndexTranslation
from solari_vk.bound.lights.recent_changes import RecentChanges, RecentEdits
from solari_vk.bound.projection import SEED_STRIDE, CameraUniforms, Projection, jitters, lens_point
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Stage
from solari_vk.gpu.tensors.exports import CudaTensor
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes import display, gbuffer, guides, lighting, paths, solari019, taa
from solari_vk.passes.debug_views import DEBUG_VIEWS, PICTURE, check_view, views_of
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.passes.many_views import tiled, upload_rows
from solari_vk.renderers.frame_budget import FrameBudget, check_frame_ms
from solari_vk.renderers.motion_blur import (
    CallbackCameras,
    ShutterAccumulation,
    ShutterUniforms,
    checked_pose,
    pose_after_error,
)
from solari_vk.renderers.renderer_base import METERING_FRAMES, RendererBase, by_pixel, checked_seed
from solari_vk.renderers.results import RenderedFrame
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.shutter import Shutter
from solari_vk.settings import Settings, uniform_values

# Fields of the uniform block.
THIS_FRAME = (
    "index", "seed", "has_history", "exposure", "lighting_change", "expected_change", "blended_changed",
    "sample_jitter", "user_jitter_change", "shutter_state", "exposed_rows",
)  # fmt: skip
# Parts of the radiance. The first ones are in every frame, the others depend on the lighting.
RADIANCE_COMPONENTS = (*display.PARTS[:-1], "raw_radiance", "paths_diffuse", "paths_specular", *solari019.OUTPUTS)
_GIVE_SETTINGS = (
    "give settings=Settings.preset('solari'), or settings=Settings(name=value), after the size as one "
    "pair, (width, height)"
)
COUNTING = ("gbuffer", "world_cache")  # stages with a buffer of counters, NAME_counters


class Renderer(RendererBase):
    """Realtime lighting: one path a pixel, more where it has little history, ended by a world-space radiance cache; or
    Solari's separate passes.

    size: (width, height) of the picture in pixels; the setting `upscale` renders fewer. settings: kept, not copied;
    assigning to one of its fields takes effect with the next frame. seed: a whole number; the same seed gives the same
    pictures, bit by bit, and another seed gives independent noise. count_rays: passes count their rays in
    `frame["ray_counts"]`, in the order of `counted_passes`, which costs time. Source: posts on Solari in Bevy 0.17 on.

    The scene may be edited between calls of `render`. Several renderers may share a scene; given one SceneBinder, they
    share its memory on the device too. `close` frees the renderer's memory, as closing the device does. Raises
    SolariError for a size that the device can't hold, a wrong seed and an unknown option.
    """

    OUTPUTS = (
        "radiance",
        "error",
        *FIRST_HITS,
        *RADIANCE_COMPONENTS,
        *(f"guides_{name}" for name in guides.IMAGES),
        "display",
    )
    LARGEST_PIXEL_BYTES, APART_PIXEL_BYTES = 96, 112  # `paths_states`, `paths_rays`
    IN_IMAGES = True
    _grid = (1, 1)  # columns and rows of views in the frame's pictures
    _world_count = 1  # worlds that the views show

    @checked_keywords(_GIVE_SETTINGS)
    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        size: tuple[int, int],
        settings: Settings | None = None,
        *,
        seed: int = 0,
        count_rays: bool = False,
    ) -> None:
        if not isinstance(settings, Settings | None):
            raise SolariError(f"Renderer: settings must be a Settings, not {quoted(settings)}; {_GIVE_SETTINGS}")
        self.settings = Settings() if settings is None else settings
        self.seed = seed
        self.count_rays = count_rays
        self.counted_passes: list[str] = []
        super().__init__(device, scene, size)
        self._owned.callback(self.binder.keep_previous_tlas, self, False)
        try:
            self.frame_count = 0
            self.frame_time = FrameBudget()
            self._callback_cameras = CallbackCameras()
            self._accumulation = ShutterAccumulation()
            self._has_history = False
            self._previous_jitter = (0.0, 0.0)  # the camera's own
            self._written_settings: tuple[Any, ...] = ()  # what the settings in the uniforms were written from
            self._light_translation = self._owned.enter_context(closing(IndexTranslation(device)))
            self._changed_lights = RecentChanges()
            self._edits = RecentEdits()
            frame = SceneFrame(device, self.binder, self._all_stages(self.size), external=self._inputs())
            self._frame = self._owned.enter_context(frame)
            self._camera_uniforms = CameraUniforms(self._frame.uniforms, self.binder.origin)
            self._this_frame = self._frame.uniforms.writer("this_frame", THIS_FRAME)
            self._remember_build()
        except BaseException:
            self.close()
            raise

    # ---- the frame ----------------------------------------------------------------------------------

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
        24 frames; it may jump. shutter: the frame shows one time of the exposure, for which `pose(seconds)`,
        by default `scene.animate`, poses the scene, and may return the camera; `radiance` is the mean of the successive
        frames given this shutter, pose and camera, and another one begins a new picture. The scene stays as in
        the middle of the exposure, which results at pixels' centers show. Raises SolariError for a wrong camera, a
        shutter without a pose in a scene without animations, or an invalid scene.
        """
        camera = self._camera_or_default(camera)
        if shutter is None and pose is None:
            previous = self._motion[0] if self._motion and self._has_history else None
            projection, timeline_value = self._submit(camera, self._accumulation.after(self.size[1]))
            self._accumulation.end()
            self._motion = projection, previous or projection
            frame = RenderedFrame(self, camera, projection, timeline_value)
        else:
            frame = self._render_exposed(camera, shutter, pose)
            self._motion = None
        self._callback_cameras.remember(frame.camera, camera)
        return self._finish(frame, METERING_FRAMES)

    def _render_exposed(self, camera: Camera, shutter: Any, pose: Any) -> RenderedFrame:
        """The next frame of an exposure; the scene stays as in its middle."""
        pose = checked_pose(self.binder.scene, shutter, pose, type(self).__name__)
        # Frames of another seed show other times.
        seconds, rows = shutter.frame(self.frame_count + SEED_STRIDE * self.seed, self.size[1])
        accumulation_key = shutter, pose, Projection.of(camera, self.size).view
        uniforms = self._accumulation.begin_frame(accumulation_key, rows)
        try:
            frame_camera = self._callback_cameras.pose(pose, seconds, camera)
            _, timeline_value = self._submit(frame_camera, uniforms)
            middle = self._callback_cameras.pose(pose, shutter.middle, camera)
        except BaseException:
            self.reset()  # what the device has is the mean of an exposure
            pose_after_error(pose, shutter)
            raise
        self._accumulation.finish_frame(accumulation_key)
        return RenderedFrame(self, middle, Projection.of(middle, self.size), timeline_value, exposed=True)

    def _submit(self, camera: Camera, shutter: ShutterUniforms | None = None) -> tuple[Projection, int]:
        """Submit a frame of the scene as it is; returns its projection, and the device's timeline value."""
        # A lens may change the G-buffer's method, which `_prepare` builds the frame for.
        self._prepare_lens(camera, rasters=self.settings.gbuffer == "raster")
        self._prepare()
        try:
            if self.settings.frame_ms > 0:
                share = self.frame_time.choose_for(self._frame, self.settings, not self._has_history)
                self._frame.uniforms.update_declared({"path_share.value": share})
            projection = self._write_uniforms(camera, shutter)
            timeline_value = self._frame.submit_applied()
        except BaseException:
            self.reset()  # the history on the device doesn't belong to the cameras and lights recorded here
            raise
        self.frame_count += 1
        self.frame_time.record_submission(timeline_value)
        self._back_sides.count_and_look(self.binder, camera, self.size)
        return projection, timeline_value

    @property
    def gbuffer(self) -> str:
        """How the surface of a pixel is found: "raster" or "traced", as the setting says or, for "auto", the device and
        the scene and the camera."""
        return gbuffer.chosen_method(
            self.device.properties.kind, self.settings.gbuffer, self.binder.features, self._needs_traced_camera
        )

    def _stages(self, picture: tuple[int, int]) -> list[Stage]:
        """The stages of a frame, in order. picture: width and height of the picture in pixels."""
        settings = self.settings
        grid = self._grid
        check_frame_ms(settings, self.device)
        instances = self._world_count * self.binder.instance_capacity
        size = tiled(taa.render_size(picture, settings), grid)
        picture = tiled(picture, grid)
        # Only ReSTIR of paths asks whether a reused sample was visible in the previous frame.
        self.binder.keep_previous_tlas(self, settings.lighting == "paths" and settings.restir)
        apart = paths.apart_bytes(self.device.rays, self.device.properties)
        # The frame, from top to bottom. Each stage names the files of its shaders, and what goes in and out.
        stages = [
            gbuffer.stage(size, settings, instances, self.gbuffer, bool(LOBES & self.binder.features)),
            guides.stage(size, settings),
            *lighting.stages(size, settings, grid, self._world_count, ABSORPTION in self.binder.features, apart),
            taa.stage(picture, size, grid),
            display.show_stage(picture, lighting.debug_view_pass(settings.lighting)),
            gbuffer.last_stage(instances),
        ]
        self.counted_passes = []
        if self.count_rays:
            stages, self.counted_passes = display.count_rays(stages)
        return stages

    def _picture_sizes(self, size: tuple[int, int]) -> tuple[tuple[int, int], ...]:
        return size, taa.render_size(size, self.settings)

    def _inputs(self) -> dict[str, Any]:
        """What the stages' shaders are given beside the scene, by name."""
        return self._lookup_tables | self._light_translation.buffers

    def _prepare(self) -> None:
        """Have the next frame show the scene and the settings as they are."""
        self._frame.apply_edits()
        self._warn_of_darkness()
        seen = (
            self.size,
            self.settings,
            self.settings.revision,
            self.binder.bindings_version,
            self._view,
            self._tonemap,
            self._needs_traced_camera,
            self._frame.uniforms.version,
            self.count_rays,
        )
        # Most frames have the settings of the one before, whose uniforms then stay as they are.
        if seen != self._written_settings:
            if self._built != self._build_key():
                with self._keeps_size(self._built[0]):
                    self._rebuild()
            self._write_settings()
            self._written_settings = seen
        # Reservoirs and histories name lights by the previous frame's numbers, which are translated where they changed.
        lights = self.binder.lights
        if self._light_translation.update(
            lights.ids, lights.emitted, lights.positions, self.settings.world_cache_cell_size
        ):
            self._frame.bind(self._light_translation.buffers)

    def _build_key(self) -> tuple[Any, ...]:
        """What `_stages` depends on and may change from frame to frame."""
        features = self.binder.features
        has = bool(LOBES & features), ABSORPTION in features, self.count_rays
        sizes = self.size, self.binder.instance_capacity, self.settings.rebuild_key
        return *sizes, *has, self.gbuffer, self.render_size, self._own_stages

    def _remember_build(self) -> None:
        self._built = self._build_key()
        self._built_render_size = self.render_size
        self._jitters = jitters(taa.jitter_count(self.settings))
        self.frame_time = FrameBudget()  # of the setting frame_ms

    def _rebuild(self) -> None:
        """Rebuild the frame. Previous transforms of instances are kept when the table of instances has grown."""
        built_capacity = self._built[1]
        saved_rows = None
        if self.frame_count > 0 and self.binder.instance_capacity > built_capacity:
            saved_rows = self._frame.resource(gbuffer.PREVIOUS_INSTANCES).read()
        # Read before the rebuild, which makes these buffers anew.
        cache_bytes = self._frame.memory.get("world_cache_life")
        rendered = self._built_render_size
        self._frame.rebuild(self._all_stages(self.size))
        self._remember_build()
        if self._built_render_size != rendered:
            self.reset()  # histories have another size
        # The new lighting may lack the view, and an error in the middle of a frame would help nobody.
        self.view = self._view if self._view in self.known_views else PICTURE
        if self._built != self._build_key():  # the shown output of the user's has another size
            self._rebuild()
        if self._frame.memory.get("world_cache_life") != cache_bytes:
            self.reset()  # the previous frame's reservoirs name cells of the old map
        if saved_rows is not None:
            upload_rows(self._frame.resource(gbuffer.PREVIOUS_INSTANCES), saved_rows, self._world_count)

    def _write_settings(self) -> None:
        # The user's own outputs have no number: their pass draws over what debug views draw.
        shown = tuple(DEBUG_VIEWS).index(self._view) if self._view in DEBUG_VIEWS else len(DEBUG_VIEWS)
        tonemap = TONEMAPS.index(self._tonemap)
        display = {"display_settings.debug_view": shown, "display_settings.tonemap": tonemap}
        self._frame.uniforms.update_declared(uniform_values(self.settings) | display)

    def _write_uniforms(self, camera: Camera, shutter: ShutterUniforms | None) -> Projection:
        """Write what changes from frame to frame: the camera, the lights that changed, the noise's index and seed."""
        offset = (0.0, 0.0)
        if self.settings.jitter:
            # Renderers of different seeds begin at different places of the sequence of offsets, so that the mean of
            # their pictures has more of them.
            offset = self._jitters[(self.frame_count + 7 * self.seed) % len(self._jitters)]
        history = self._has_history
        lights = self.binder.lights
        cell_size = self.settings.world_cache_cell_size
        self._changed_lights.update(lights.ids, lights.emitted, lights.centers, lights.positions, cell_size)
        self._edits.update(self.binder.edit_counts, self._light_translation.newest)
        if not history:  # nothing has changed since a frame that doesn't count
            self._light_translation.changed_power = 0.0
            self._changed_lights.clear()
            self._edits.forget()
        # Each frame sees all through one point of the lens: Haeberli and Akeley, "The Accumulation Buffer" (1990).
        on_lens = lens_point(camera, self.frame_count + SEED_STRIDE * self.seed)
        projection = self._camera_uniforms.write(
            camera, self.size, offset, render_size=self._built_render_size, has_history=history, lens_offset=on_lens
        )
        (x, y), (previous_x, previous_y) = projection.jitter, self._previous_jitter
        shutter_state = (0, 0, 0) if shutter is None else (shutter.state, *shutter.rows)
        self._this_frame.write(
            self.frame_count & 0xFFFFFFFF,
            self.seed,
            history,
            projection.exposure,
            self._light_translation.changed_power,
            self._edits.share,
            bool(self._edits.blended),
            *offset,
            x - previous_x,
            y - previous_y,
            *shutter_state,
        )
        self._frame.uniforms.update_declared(self._changed_lights.uniforms)
        self._previous_jitter = projection.jitter
        self._has_history = True
        return projection

    # ---- control ------------------------------------------------------------------------------------

    @property
    def seed(self) -> int:
        """The seed of the noise, from the next frame on: a whole number from 0 to 2^32 - 1."""
        return self._seed

    @seed.setter
    def seed(self, seed: int) -> None:
        self._seed = checked_seed(seed)

    def _check_view(self, name: str) -> None:
        if not is_name(name, self._own_views):
            check_view(name, self.settings.lighting)

    @property
    def known_views(self) -> dict[str, str]:
        return {name: DEBUG_VIEWS[name] for name in views_of(self.settings.lighting)} | super().known_views

    @property
    def _own_views(self) -> dict[str, str]:
        if not self._own_stages.added:
            return {}
        return self._own_stages.views(self._frame, (self._built[0], self._built_render_size))

    def resize(self, size: tuple[int, int]) -> None:
        self._size = self._checked_size(size)
        self.reset()

    def reset(self) -> None:
        """Drop what earlier frames found, the world cache too, as for another scene. A cut of the camera needs none."""
        self._has_history = False

    # ---- results ------------------------------------------------------------------------------------

    def check_latest(self, frame: RenderedFrame, name: str) -> None:
        super().check_latest(frame, name)
        if self._accumulation.device_is_behind and name in FIRST_HITS:
            self.binder.update()  # first hits show the middle of the exposure
            self._accumulation.device_is_behind = False

    @property
    def render_size(self) -> tuple[int, int]:
        """Width and height in pixels of what is rendered for a picture, which has `size`: see the setting upscale."""
        return taa.render_size(self.size, self.settings)

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names in OUTPUTS that the frame has with its settings."""
        return tuple(name for name in super().outputs if name in FIRST_HITS or self._has(name))

    def _has(self, resource: str) -> bool:
        """Whether the latest frame computed a resource."""
        return resource in self._frame and (resource != "error" or self._frame.uniforms["denoise_settings.denoise"])

    def read(self, name: str) -> NDArray[Any]:
        """A copy of a result of the latest frame. Waits for the frame.

        Images, and buffers with one element per pixel, have the shape (height, width[, channels]); others keep theirs.
        "stage/counter" is a counter of a stage in COUNTING, such as "world_cache/active_cells"; elsewhere "/" stands
        for "_". "gbuffer_depth" is the image `depth`: near / distance along the view axis, 0 for background.
        """
        stage, _, counter = name.partition("/")
        block = f"{stage}_counters"
        if counter and stage in COUNTING and block in self._frame:
            counters = self._frame[block]
            if counter in (counters.dtype.names or ()):
                return np.asarray(counters[counter])
        elif counter in gbuffer.COUNTERS and stage == "gbuffer":
            raise SolariError(f"Renderer: there is no '{name}': only gbuffer=raster counts drawn and culled instances")
        if name == "guides_motion" and self._motion is not None:
            return self._center_motion(self._built[0], self._built_render_size, Frame.__getitem__)
        resource = "depth" if name == "gbuffer_depth" else name.replace("/", "_")
        if not self._has(resource):
            lit = lighting.lighting_with(resource)
            if resource in self._frame:  # `error`, which the denoiser estimates
                raise SolariError(f"Renderer: there is no '{name}': it needs the setting denoise=on")
            if lit:
                raise SolariError(f"Renderer: there is no '{name}': it needs the setting lighting={lit}")
            raise unknown_name("Renderer: there is no result", name, self.outputs)
        return by_pixel(self._frame[resource], self._result_sizes(resource))

    def tensor(self, name: str) -> NDArray[Any] | CudaTensor:
        if name == "guides_motion" and self._motion is not None:
            return self._center_motion(self._built[0], self._built_render_size, Frame.tensor)
        resource = name.replace("/", "_")
        if not self._has(resource):
            self.read(name)  # which says why
            raise SolariError(f"Renderer: there is no tensor of '{name}': frame['{name}'] reads it")
        return by_pixel(self._frame.tensor(resource), self._result_sizes(resource))

    def _result_sizes(self, resource: str) -> list[tuple[int, int]]:
        """The sizes of pictures that a buffer may have one element a pixel of."""
        is_buffer = isinstance(self._frame.resource(resource), Buffer)
        return [self._built[0], self._built_render_size] if is_buffer else []
