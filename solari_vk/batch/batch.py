"""Many cameras of one scene, or of many, in one frame: first hits, path-traced pictures, or realtime lighting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_constructor, checked_keywords
from solari_vk.batch import view_cameras
from solari_vk.batch.batch_renderers import BatchPathTracer, BatchRenderer, WorldBindings
from solari_vk.batch.many_frames import WHERE as RENDER_MANY
from solari_vk.batch.many_frames import (
    FrameMemory,
    FrameResults,
    Result,
    accept_cameras,
    cameras_of,
    resets_of,
    seeds_of,
    transforms_of,
)
from solari_vk.batch.options import (
    RADIANCE_NAMES,
    check_realtime,
    check_scenes,
    checked_flag,
    checked_mask,
    checked_names,
    checked_results,
    checked_size,
    checked_worlds,
)
from solari_vk.batch.overrides import LightOverrides, MaterialOverrides, TransformOverrides
from solari_vk.batch.results import BatchResults
from solari_vk.batch.view_buffer import ViewBuffer
from solari_vk.batch.worlds import Worlds
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.features import LENSES
from solari_vk.bound.triangle_orders import TriangleOrders
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import batch as passes
from solari_vk.passes import reference
from solari_vk.passes.many_views import upload_rows
from solari_vk.passes.reference import numbered_seeds
from solari_vk.renderers.back_sides import BackSides
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.model import Camera, Scene

RENDER = "Batch.render"
SHADER = "passes/batch/labels.comp"
VIEWS_LOOKED_AT = 4


@checked_constructor
class Batch(BatchResults):
    """Renders many views of a scene in one frame. A context manager.

    size: (width, height) of a view in pixels. views: their number N. renderer: "labels" finds first hits alone, at the
    pixels' centers; "reference" adds path-traced `radiance`, and takes the options of `PathTracer`, such as seed and
    max_bounces; "realtime" adds the frame of `Renderer`, as `radiance`, `raw_radiance` and `display`, and takes its
    options settings and seed. outputs: names of OUTPUTS, which are computed beside the light: by default depth,
    position, geometric_normal, instance_id and primitive; motion_vectors and what needs materials take time of their
    own. View i has what a `PathTracer` or a `Renderer` of its own finds with the same camera and seed, bit by bit or,
    where a driver rounds in another way, nearly so: seed i is `seed` + i * 0x9E3779B9 modulo 2^32. Rays hit an
    instance's ray_mesh where it has one. Realtime views share the world cache, so that bits are equal for one view, and
    for more with the setting world_cache=off.

    worlds: their number, of which N is a multiple: `transforms` moves instances in each, `world_materials` and
    `world_lights` give instances other materials and the scene other lights. View i shows world i // (N / worlds). With
    a list of scenes in place of the scene, each world shows its own, which may stand in the list several times.

    The scene may be edited between calls of `render`. Raises SolariError for wrong options, and for more views than the
    device's buffers hold, which names the largest number.
    """

    OUTPUTS = passes.OUTPUTS

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder | Sequence[Scene],
        size: tuple[int, int],
        views: int,
        *,
        renderer: str = "labels",
        outputs: Sequence[str] = passes.GEOMETRY,
        worlds: int = 1,
        **options: Any,
    ) -> None:
        names = checked_names(renderer, outputs, options)
        check_scenes(scene, worlds)
        super().__init__(device, scene)
        try:
            self.views = whole_number(views, "Batch: views", 1)
            self._back_sides = BackSides(self.device)
            self._views_binding = reflect(compile_shader(SHADER), SHADER).bindings["views"]
            record = self._views_binding.element
            assert record is not None
            self.size = checked_size(device, size, self.views, record.itemsize, renderer)
            # The views' pictures one below the other, of which a dispatch renders some rows.
            self._strip = self.size[0], self.size[1] * self.views
            self._rows = reference.rows_of(self._strip, passes.MAX_PIXELS)
            self._labels_names = names
            self._names = (*RADIANCE_NAMES[renderer], *names)
            self._owned.callback(self._close_many)
            # The scene must be on the device before worlds copy its records.
            self.binder.update()
            shown = len(self.binder.listed_records) if self.binder.has_many_scenes else worlds
            count = checked_worlds(device, shown, self.views, renderer)
            each = [records.origin for records in self.binder.listed_records]
            origins = np.repeat(each, self.views // len(each), axis=0)
            self._cameras = view_cameras.CameraReader(record["current"], self.views, self.size, origins)
            self._worlds = Worlds(device, self.binder, count, self._port)
            self._owned.callback(self._worlds.destroy)
            self._worlds.update()
            self._bindings = WorldBindings(self._worlds)  # of the frame of labels
            self._capacity = self._worlds.rows
            self._make_frames(renderer, options)
            self._seeds = numbered_seeds(options.get("seed", 0), self.views)
        except BaseException:
            self._owned.close()
            raise

    def _make_frames(self, renderer: str, options: dict[str, Any]) -> None:
        """Make the frames that a renderer runs, and that of labels if outputs want any."""
        if renderer == "realtime":
            self._realtime = BatchRenderer(
                self.device, self.binder, self.size, self.views, self._views_binding, self._worlds, options
            )
            self._owned.callback(self._realtime.close)
        if self._labels_names or renderer == "reference":
            self._table = ViewBuffer(self.device, self._port, self._views_binding, self.views)
            self._owned.callback(self._table.destroy)
        if renderer == "reference":
            self._paths = BatchPathTracer(
                self.device, self.binder, self._strip, self._table.buffer, self._worlds, options
            )
            self._owned.callback(self._paths.close)
        if self._labels_names:
            self._orders = TriangleOrders(self.device, self.binder)
            self._owned.callback(self._orders.destroy)
            self._orders.update()
            external = {"views": self._table.buffer, **self._orders.buffers, **self._worlds.resources}
            frame = SceneFrame(self.device, self.binder, self._stages(self._capacity), external=external)
            self._labels = self._owned.enter_context(frame)

    def _stages(self, capacity: int) -> list[Stage]:
        """The frame of labels. capacity: the rows of a world in `instances`."""
        return [passes.labels_stage(self._strip, self._rows, self._labels_names, self._worlds.count * capacity)]

    @property
    def transforms(self) -> TransformOverrides:
        """The transforms of instances in each world, (worlds, 4, 4) by the name of an instance: assign them, as in
        `batch.transforms["box"] = poses`."""
        return self._worlds.transforms

    @property
    def world_materials(self) -> MaterialOverrides:
        """The materials of instances in each world, a list by the name of an instance: assign them, as in
        `batch.world_materials["box"] = [red, blue]`."""
        return self._worlds.materials

    @property
    def world_lights(self) -> LightOverrides:
        """What takes the place of a light of the scene in each world, a list by the name of the light: assign them, as
        in `batch.world_lights["sun"] = [low_sun, None]`."""
        return self._worlds.lights

    # ---- rendering ----------------------------------------------------------------------------------

    @checked_keywords()
    def render(
        self,
        cameras: ArrayLike | Sequence[Camera],
        *,
        fov: ArrayLike | None = None,
        vertical_fov: ArrayLike | None = None,
        K: ArrayLike | None = None,
        near: ArrayLike | None = None,
        ev100: ArrayLike | None = None,
        samples: int | None = None,
        seeds: ArrayLike | None = None,
        reset: ArrayLike = False,
        reset_cache: bool = False,
    ) -> Self:
        """Render all views, and return the batch, whose results are these until it renders again.

        cameras: poses (N, 4, 4), the transforms of `Camera`: world from camera, which looks along its -z axis with y
        up, in meters. They are arrays of numpy or tensors, of which those of a GPU stay on it: what is wrong with such
        a tensor is said by a later call. Their lens is given by one of fov, the vertical field of view in degrees,
        vertical_fov, in radians (45 degrees), both a number or (N,), and K, OpenCV's matrices (3, 3) or (N, 3, 3) in
        pixels of a view, as `Camera.from_opencv` takes them; near and ev100, numbers or (N,), are Camera.near and
        Camera.ev100. Or N `Camera` objects of any kind, with lenses, apertures and parallel projections.

        samples: per pixel, by default 16; each call begins new pictures. seeds (N,): whole numbers for those of the
        views. reset: True or (N,), views that begin anew, without history: their cameras count as not having moved.
        reset_cache: begin the world cache anew too, which views otherwise go on to share. Does not wait for the device.
        Raises SolariError for wrong shapes, numbers that aren't finite, and matrices that can't be inverted; nothing is
        rendered then.
        """
        self._check_open()
        self._check_tensors()
        sample_count = self._checked_samples(samples, RENDER)
        clears_cache = checked_flag(reset_cache, "reset_cache", RENDER)
        options = {"fov": fov, "vertical_fov": vertical_fov, "K": K, "near": near, "ev100": ev100}
        accepted = accept_cameras(self._port, cameras, RENDER, (self.views, 4, 4))
        read = self._read(accepted, options, RENDER)
        numbers = self._checked_seeds(seeds, RENDER)
        begins = checked_mask(reset, self.views)
        looks = self._is_looked_at()
        with self.binder.tensors.putting_off():
            self._render(read, sample_count, numbers, begins, clears_cache)
        if looks:
            self._look_for_backs(accepted, read)
        return self

    def _read(self, cameras: Any, options: Mapping[str, Any], where: str) -> view_cameras.ViewCameras:
        found = self._cameras.read(cameras, options, where)
        if self._realtime is not None:
            check_realtime(cameras, where)
        return found

    def _is_looked_at(self) -> bool:
        """Whether to look at the next frame."""
        # Where worlds have scenes of their own, each look takes the first one to the device again.
        is_later_scene = self.binder.has_many_scenes and self._rendered
        # A look waits for the device, and so for the streams in which tensors are computed.
        return self._back_sides.is_due() and not is_later_scene and not self.binder.tensors.is_used

    def _look_for_backs(self, cameras: Any, read: view_cameras.ViewCameras) -> None:
        """Warn if one of the first views looks through the backs of surfaces."""
        scene = self.binder.scene if self.binder.has_many_scenes else self.binder
        for view in range(1 if self.binder.has_many_scenes else min(self.views, VIEWS_LOOKED_AT)):
            camera = view_cameras.camera_of(cameras, read, view)
            if camera is not None:
                # What the device refuses meanwhile is said by the next call, as in `_render`.
                with self.binder.tensors.putting_off():
                    self._back_sides.look(scene, camera, self.size)

    def _render(
        self,
        cameras: view_cameras.ViewCameras,
        samples: int,
        seeds: NDArray[np.uint32],
        reset: NDArray[np.bool_],
        clears_cache: bool,
    ) -> None:
        """Render a frame of arguments that are checked. reset (N,): views without history."""
        if cameras.lenses and LENSES not in self.binder.features:
            self.binder.mark_changed(cameras.lenses[0])
        if self._worlds.has_tables:
            # Before the frames apply edits: worlds have records of the edited scene, and may add features to shaders.
            self.binder.update()
            self._worlds.update()
        if self._labels is not None or self._paths is not None:
            self._write_views(cameras, reset, seeds)
        if self._labels is not None:
            self._render_labels(self._labels)
        self._rendered = True
        if self._paths is not None:
            self._paths.trace(samples)
        if self._realtime is not None:
            self._realtime.render_views(cameras, reset, seeds, not clears_cache)

    @checked_keywords()
    def render_many(
        self,
        cameras: Any,
        *,
        frames: int,
        outputs: Sequence[str] | None = None,
        transforms: Mapping[Any, ArrayLike] | None = None,
        fov: ArrayLike | None = None,
        vertical_fov: ArrayLike | None = None,
        K: ArrayLike | None = None,
        near: ArrayLike | None = None,
        ev100: ArrayLike | None = None,
        samples: int | None = None,
        seeds: ArrayLike | None = None,
        reset: ArrayLike = False,
        reset_cache: bool = False,
    ) -> FrameResults:
        """Render several frames in one submission, and return what each of them shows, by the names of results. The
        path tracer, which times its dispatches, makes several submissions.

        cameras: as `render` takes them, for all frames, or for each: (frames, N, 4, 4), or a list of lists of `Camera`.
        outputs: the results to keep, by default all. reset: True or (N,), of the first frame, or (frames, N). seeds:
        (N,) or (frames, N). reset_cache is for the first frame. transforms: (frames, worlds, 4, 4) by instance, what
        `batch.transforms` is in each frame. The others are those of `render`, for all frames.

        The results are bit by bit those of as many calls of `render`, of which the batch then has those of the last.
        They take memory for each frame. Raises SolariError as `render`; nothing is rendered then.
        """
        self._check_open()
        self._check_tensors()
        frames = whole_number(frames, f"{RENDER_MANY}: frames", 1)
        names = checked_results(self._names if outputs is None else outputs, self._names, RENDER_MANY, "result")
        sample_count = self._checked_samples(samples, RENDER_MANY)
        clears_cache = checked_flag(reset_cache, "reset_cache", RENDER_MANY)
        moves = transforms_of(frames, self._worlds, transforms)
        options = {"fov": fov, "vertical_fov": vertical_fov, "K": K, "near": near, "ev100": ev100}
        shown = cameras_of(frames, self.views, cameras, self._port)
        read = [self._read(of_frame, options, RENDER_MANY) for of_frame in shown]
        looks = self._is_looked_at()
        numbers = [self._checked_seeds(of_frame, RENDER_MANY) for of_frame in seeds_of(frames, self.views, seeds)]
        resets = resets_of(frames, self.views, reset)
        self._prepare_many(frames)
        # The device gets the commands of all frames in one submission.
        with self.device.gathered(), self.binder.tensors.putting_off():
            for index in range(frames):
                for instance, values in moves[index]:
                    self.transforms.replace(instance, values)
                self._render(read[index], sample_count, numbers[index], resets[index], clears_cache and index == 0)
                many = self._copy_results(index, frames, names)
        if looks:
            self._look_for_backs(shown[-1], read[-1])
        return many

    def _prepare_many(self, frames: int) -> None:
        """Have all frames of this batch ready to be submitted so often before the device runs the first one."""
        if self._labels is not None:
            self._labels.prepare_many(frames)
        for renderer in (self._paths, self._realtime):
            if renderer is not None:
                renderer.frame.prepare_many(frames)

    def _copy_results(self, index: int, frames: int, names: Sequence[str]) -> FrameResults:
        """Copy the results of a frame, the first of which says how much memory all of them take."""
        results = {name: self._result(name) for name in names}
        if self._many is None or index == 0:
            self._many = self._make_many(results, frames)
        self._many.copy_results(index, results)
        return self._many

    def _make_many(self, results: Mapping[str, Result], frames: int) -> FrameResults:
        """What `render_many` returns, in the memory of the latest that it returned where this fits."""
        before = self._many
        if before is not None and before.memory.fits(results, frames):
            before.end()
            memory = before.memory
        else:
            self._close_many()
            memory = FrameMemory(self.device, results, frames)
        return FrameResults(self.device, results, memory, self._check_tensors)

    def _write_views(
        self, cameras: view_cameras.ViewCameras, reset: NDArray[np.bool_], seeds: NDArray[np.uint32]
    ) -> None:
        """Give the cameras to the frame of labels and to the path tracer."""
        table = self._table
        # In most frames only transforms change, which `upload_frame` uploads.
        if table.must_write((cameras.records, seeds), self._worlds.assignment_key):
            table.write_cameras(cameras)
            table.records["frame"]["seed"] = seeds
            self._worlds.assign_views(table)
        table.upload_frame(cameras, reset)

    def _render_labels(self, frame: SceneFrame) -> None:
        frame.apply_edits()
        self._bindings.show(frame)
        # The device has triangles in another order than the user, whose numbers `primitive` tells.
        if self._orders.update():
            frame.bind(self._orders.buffers)
        capacity = self._worlds.rows
        if capacity != self._capacity:
            if "motion_vectors" in self._names:
                # The rows of a world begin elsewhere now, also those of the previous frame.
                previous = frame.resource("previous_instances").read()
                frame.rebuild(self._stages(capacity))
                upload_rows(frame.resource("previous_instances"), previous, self._worlds.count)
            self._capacity = capacity
        # One dispatch has a limited number of pixels.
        frame.uniforms["path_sampling.row_count"] = self._rows
        for row in range(0, self._strip[1], self._rows):
            frame.uniforms["path_sampling.first_row"] = row
            frame.submit_applied()

    # ---- checks -------------------------------------------------------------------------------------

    def _checked_samples(self, samples: int | None, where: str) -> int:
        if samples is None:
            return 16
        if self._paths is None:
            what = "labels have" if self._realtime is None else "the realtime renderer takes"
            raise SolariError(f"{where}: {what} no samples: make the batch with renderer='reference'")
        return whole_number(samples, f"{where}: samples", 1)

    def _checked_seeds(self, seeds: Any, where: str) -> NDArray[np.uint32]:
        if seeds is None:
            return self._seeds
        if self._paths is None and self._realtime is None:
            raise SolariError(f"{where}: labels have no seeds: make the batch with renderer='reference'")
        # Doubles hold all whole numbers of 32 bits.
        numbers = view_cameras.array(seeds, "seeds", (self.views,), where=where)
        whole = (numbers == np.floor(numbers)) & (numbers >= 0) & (numbers < 2**32)
        view_cameras.check_all(whole, "be a whole number from 0 to 2^32 - 1", "the seed", where)
        return numbers.astype(np.uint32)
