"""The realtime renderer: what a frame is, read top to bottom."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Stage
from solari_vk.gpu.frame.packing import writer
from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes import (
    brdf_table,
    display,
    gbuffer,
    guides,
    light_tiles,
    restir_di,
    restir_gi,
    specular_gi,
    world_cache,
)
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.light_translation import LightTranslation
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.view import JITTERS, View
from solari_vk.settings import Settings

# Uniforms that are written together: those of two views, and what differs in every frame.
VIEW = ("world_from_view", "tan_half_fov", "near")
VIEWS = ("view_from_world", "previous_world_from_view", "previous_view_from_world", "previous_tan_half_fov",
         "previous_near")  # fmt: skip
JITTER = ("jitter",)
MOMENT = ("previous_jitter", "frame_index", "has_history", "exposure", "lighting_change")
COUNTING = ("gbuffer", "world_cache")  # stages that count something, in NAME_counters
LARGEST_PIXEL_BYTES = 64  # of a pixel in any one buffer


class Renderer:
    """Solari's realtime lighting: ReSTIR DI and GI, a world-space radiance cache, specular GI.

    size: (width, height) in pixels. settings: shared, not copied, so that assigning to its fields takes effect with the
    next frame. seed: another one gives other noise; one seed gives one picture. Sources: seeds 000, 003 and 002.

    The scene may be edited between calls of `render`, and several renderers may share it (as one SceneBinder, to
    hold it on the device once). `close` frees what the device holds; closing the device does so too.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        size: tuple[int, int],
        settings: Settings | None = None,
        *,
        seed: int = 0,
    ) -> None:
        self.device = device
        self.settings = Settings() if settings is None else settings
        self.seed = seed
        self.size = self._checked(size)
        self.frame_count = 0
        self._owns_binder = isinstance(scene, Scene)
        self.binder = SceneBinder(device, scene) if isinstance(scene, Scene) else scene
        self.binder.update()
        self._owned: list[Any] = []
        try:
            table, table_buffers = brdf_table.compute(device)
            self._owned.append(table)
            self._lights = LightTranslation(device)
            self._owned.append(self._lights)
            external = {**self.binder.resources, **table_buffers, **self._lights.buffers}
            self._frame = Frame(device, self._stages(), external=external)
            self._owned.append(self._frame)
        except BaseException:
            self.close()
            raise
        self._built = self.size, self.binder.instance_capacity, self.settings.built_in
        self._seen: tuple[Any, ...] = ()
        self._written: Uniforms | None = None  # that `_write_...` write to
        self._bound_version = self.binder.version
        self._previous: tuple[View, tuple[float, float]] | None = None  # view and jitter of the last frame: the history
        self._views: tuple[View, View] | None = None  # in the uniforms: this frame's and the last one's
        self.view, self.tonemap = "picture", "agx"

    # ---- the frame ----------------------------------------------------------------------------------

    def _stages(self) -> list[Stage]:
        """What happens in a frame, in this order."""
        size, settings, instances = self.size, self.settings, self.binder.instance_capacity
        return [
            gbuffer.stage(size, settings, instances),
            light_tiles.stage(size, settings),
            world_cache.stage(size, settings),
            restir_di.stage(size, settings),
            restir_gi.stage(size, settings),
            specular_gi.stage(size, settings),
            guides.stage(size, settings),
            display.stage(size, settings),
            gbuffer.last_stage(instances),
        ]

    def render(self, camera: Camera) -> RenderedFrame:
        """Submit the next frame and return it, without waiting for it; its results are read by name.

        Light gathers over frames: after about 24 of them a still picture has settled. Call `reset` at a cut.
        """
        if not isinstance(camera, Camera):
            raise SolariError(f"Renderer.render: a Camera is needed, not {camera!r}")
        self.binder.update()
        seen = (self.size, self.seed, self.settings, self.settings.revision, self.binder.version, self._view,
                self._tonemap, self._frame.uniforms)  # fmt: skip
        if seen != self._seen:
            self._take_up_settings()
            self._seen = seen
        lights = self.binder.lights
        if self._lights.update(lights.ids, lights.powers, lights.places, self.settings.world_cache_cell_size):
            self._frame.bind(self._lights.buffers)
        try:
            self._write_uniforms(camera)
            self._frame.submit()
        except BaseException:
            self.reset()  # what the passes know is older than what was noted of cameras and lights
            raise
        self.frame_count += 1
        return RenderedFrame(self)

    def _take_up_settings(self) -> None:
        """Build the frame anew where sizes or pipelines changed; take up the scene's resources and all settings."""
        built = self.size, self.binder.instance_capacity, self.settings.built_in
        if built != self._built:
            grown = self.frame_count > 0 and built[1] > self._built[1]
            instances = self._frame.resource(gbuffer.LASTING).read() if grown else None
            self._frame.rebuild(self._stages())
            self._built = built
            if instances is not None:  # what moves goes on moving
                self._frame.resource(gbuffer.LASTING).upload(instances)
        if self.binder.version != self._bound_version:
            self._bound_version = self.binder.version
            self._frame.bind(self.binder.resources)
        uniforms = self._frame.uniforms
        for name, value in self.settings.uniforms().items():
            uniforms[name] = value
        uniforms["seed"], uniforms["size"] = self.seed, self.size
        uniforms["view"], uniforms["tonemap"] = self._view, self._tonemap

    def _write_uniforms(self, camera: Camera) -> None:
        uniforms = self._frame.uniforms
        if self._written is not uniforms:  # the shaders' block is another one
            writers = [writer(uniforms.record, names) for names in (VIEW, VIEWS, JITTER, MOMENT)]
            self._write_view, self._write_views, self._write_jitter, self._write_moment = writers
            self._written, self._views = uniforms, None
        previous = self._previous
        view = View.of(camera, self.size, previous and previous[0])
        jitter = self._jitter(view)
        if previous is None:
            self._lights.change = 0.0
        old, old_jitter = previous or (view, jitter)
        if self._views is None or self._views[0] is not view or self._views[1] is not old:
            self._write_view(*view.world_from_view, *view.tan_half_fov, view.near)
            self._write_views(
                *view.view_from_world, *old.world_from_view, *old.view_from_world, *old.tan_half_fov, old.near
            )
            self._views = view, old
        self._write_jitter(*jitter)
        self._write_moment(
            *old_jitter, self.frame_count & 0xFFFFFFFF, previous is not None, view.exposure, self._lights.change
        )
        self._previous = view, jitter

    def _jitter(self, view: View) -> tuple[float, float]:
        """Where in the pixel this frame's samples lie, from its centre, in pixels."""
        if not self.settings.jitter:
            return view.jitter
        (x, y), (dx, dy) = view.jitter, JITTERS[(self.frame_count + 7 * self.seed) % len(JITTERS)]
        return x + dx, y + dy

    # ---- control ------------------------------------------------------------------------------------

    @property
    def seed(self) -> int:
        """What the noise follows, from the next frame on: a whole number from 0 to 2^32 - 1."""
        return self._seed

    @seed.setter
    def seed(self, seed: int) -> None:
        try:
            self._seed = operator.index(seed)
        except TypeError:
            self._seed = -1
        if not 0 <= self._seed < 2**32:
            raise SolariError(f"Renderer: seed must be a whole number from 0 to 2^32 - 1, not {seed!r}")

    @property
    def view(self) -> str:
        """What `display` shows: "picture", or a debug view of passes.display.VIEWS; from the next frame on."""
        return tuple(display.VIEWS)[self._view]

    @view.setter
    def view(self, name: str) -> None:
        self._view = _index_of(name, tuple(display.VIEWS), "view")

    @property
    def tonemap(self) -> str:
        """The curve of `display`: "none", "reinhard", "aces" or "agx"; from the next frame on."""
        return TONEMAPS[self._tonemap]

    @tonemap.setter
    def tonemap(self, name: str) -> None:
        self._tonemap = _index_of(name, TONEMAPS, "tone mapping")

    def reset(self) -> None:
        """Forget all earlier frames, as after a cut."""
        self._previous = None

    def reload(self) -> None:
        """Take up changed shaders. When one can't be compiled, the old ones go on; raises CompilationError."""
        self._frame.rebuild()

    def resize(self, size: tuple[int, int]) -> None:
        """Another picture size (width, height), without history."""
        self.size = self._checked(size)
        self.reset()

    def _checked(self, size: tuple[int, int]) -> tuple[int, int]:
        try:
            width, height = (operator.index(n) for n in size)
        except (TypeError, ValueError):
            raise SolariError(f"Renderer: size must be two whole numbers (width, height), not {size!r}") from None
        limits = self.device.properties.limits
        most = limits.maxStorageBufferRange // LARGEST_PIXEL_BYTES
        side = limits.maxImageDimension2D
        if not (0 < width <= side and 0 < height <= side and width * height <= most):
            raise SolariError(
                f"Renderer: {width}x{height} is not between 1 pixel and what this device holds, {side} pixels a side "
                f"and {most:,} in all"
            )
        return width, height

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        while self._owned:
            self._owned.pop().close()
        if self._owns_binder:
            self._owns_binder = False
            self.binder.destroy()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- results ------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A copy of a result of the latest frame; waits for it.

        Buffers with an element a pixel and images come as (height, width[, channels]), others as they are.
        "stage/counter" is a field of the counters of one of COUNTING, such as "world_cache/active_cells"; else a "/"
        stands for "_".
        """
        if self.frame_count == 0:
            raise SolariError(f"Renderer: render before asking for '{name}'")
        stage, _, counter = name.partition("/")
        block = f"{stage}_counters"
        if counter and stage in COUNTING and block in self._frame:
            counters = self._frame[block]
            if counter in (counters.dtype.names or ()):
                return np.asarray(counters[counter])
        elif counter in gbuffer.COUNTERS and stage == "gbuffer":
            raise SolariError(f"Renderer: no '{name}': only gbuffer=raster counts what is drawn and culled")
        values = self._frame[name.replace("/", "_")]
        width, height = self._built[0]
        if len(values.shape) and values.shape[0] == width * height:
            return values.reshape(height, width, *values.shape[1:])
        return values

    def resource(self, name: str) -> Any:
        """What a name of the shaders stands for on the device, as of the latest frame: a Buffer or an Image."""
        return self._frame.resource(name)

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each pass in the last finished frame."""
        return self._frame.timings


class RenderedFrame:
    """One frame's results by name, until the next one is rendered: what `Renderer.__getitem__` documents."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self.index = renderer.frame_count

    def __getitem__(self, name: str) -> NDArray[Any]:
        if self._renderer.frame_count != self.index:
            raise SolariError(f"frame {self.index} is gone, since a later one was rendered: read '{name}' before that")
        return self._renderer[name]


def _index_of(name: str, names: tuple[str, ...], what: str) -> int:
    if name not in names:
        raise SolariError(f"Renderer: there is no {what} {name!r}; there are {', '.join(names)}")
    return names.index(name)
