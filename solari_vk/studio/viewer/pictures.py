"""The pictures that the viewer shows of a scene: the realtime renderer's and the path tracer's."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import DEBUG_VIEWS, PICTURE, views_of
from solari_vk.passes.reference import MAX_SAMPLES
from solari_vk.passes.taa import divided
from solari_vk.renderers.own_stages import AnyStage, made_stage
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings
from solari_vk.studio.viewer.presenter import Part, pixels_of
from solari_vk.studio.viewer.reference_picture import ReferencePicture, ToneMapped
from solari_vk.studio.viewer.scaling import Build, Size, Upscaling

MODES = ("realtime", "reference", "split")
UNSEEN_FIELDS = {"ev100", "auto_exposure", "name"}  # of a camera
METERING_SIZE = 96, 54  # of the picture that chooses the exposure
STRIP = 1 / 3  # share of the split view's width that shows the denoised picture, between raw one and reference


def meter_exposure(device: Device, binder: SceneBinder, camera: Camera) -> None:
    """Let a small picture choose a camera's exposure, if its `auto_exposure` is on or nobody set one."""
    if camera.auto_exposure or not camera.has_exposure:
        with PathTracer(device, binder, METERING_SIZE) as tracer:
            tracer.render(camera, samples=16).settle_exposure()


class Pictures:
    """Renders what `mode`, one of MODES, shows. A renderer is made when a mode first needs it.

    view, tonemap: as in `Renderer`. divider: where the mode "split" divides the window, as a share of its width from
    the left: between the realtime picture and the reference; or, with the denoiser, the middle of a strip with the
    denoised picture between the raw one and the reference. counts_rays: whether the realtime renderer counts its rays,
    which makes it a little slower. These and `mode` may be assigned at any time. Pictures of one SceneBinder share its
    memory on the device; its owner closes it after them. `close` frees everything else.
    """

    def __init__(
        self, device: Device, scene: Scene | SceneBinder, settings: Settings, seed: int = 0, mode: str = "realtime"
    ) -> None:
        self._owns_binder = isinstance(scene, Scene)
        self.binder = SceneBinder(device, scene) if isinstance(scene, Scene) else scene
        self.device = device
        self.scene = self.binder.scene
        self.settings = settings
        self.seed = seed
        self.mode = mode
        self.view = PICTURE
        self.tonemap = "agx"
        self.divider = 0.5
        self.counts_rays = False
        self.most_samples = MAX_SAMPLES
        """Samples per pixel that the path tracer adds in a frame at most."""
        self.sample_limit = 0
        """Samples per pixel after which the path tracer's picture isn't refined, while nothing changes; 0: none."""
        self.most_bands: int | None = None
        """Bands of rows that the path tracer traces in a frame at most; None: all."""
        self.keeps_realtime = False
        """Whether the realtime picture of the mode "split" stays as it is, because it is finished."""
        self.interrupted: Callable[[], bool] | None = None
        """Asked after each pass of a realtime frame; True gives the frame up, as `Interrupted` says."""
        self.meanwhile: Callable[[], object] | None = None
        """Called again and again while a pass of such a frame runs."""
        self.camera: Camera | None = None
        """The camera of the latest frame, None after a frame that failed."""
        self.is_short = True
        """Whether the latest frame took no more samples than it had to: its time then depends on its size alone."""
        self.own_stages: list[tuple[AnyStage, str]] = []
        """What `Renderer.add_stage` is given when the realtime renderer is made: the stage, and after which it runs."""
        self.realtime: Renderer | None = None
        self.reference: ReferencePicture | None = None
        self._raw: ToneMapped | None = None  # the realtime picture without denoising
        self._upscaling = Upscaling(settings)
        self._made_upscale = 0.0  # `Build.upscale` of the latest realtime picture
        self._build = Build()  # of the latest frame that was rendered
        self._refused: Build | None = None  # the requested build if it failed; `_build` then stays in use

    @property
    def view(self) -> str:
        """The view that was assigned, or "picture" while the lighting lacks it."""
        lacks = self._view in DEBUG_VIEWS and self._view not in views_of(self.settings.lighting)
        return PICTURE if lacks else self._view

    @view.setter
    def view(self, name: str) -> None:
        self._view = name

    @property
    def known_views(self) -> dict[str, str]:
        """The names that `view` takes with the settings, with what each shows."""
        known = {name: DEBUG_VIEWS[name] for name in views_of(self.settings.lighting)}
        made = {} if self.realtime is None else self.realtime.known_views
        return known | {name: meaning for name, meaning in made.items() if name not in DEBUG_VIEWS}

    @property
    def debug_view(self) -> str:
        """The view, or "picture" while it is an output of the user's stages, which commands and scripts lack."""
        return self.view if self.view in DEBUG_VIEWS else PICTURE

    def add_stage(self, stage: AnyStage, after: str) -> None:
        """Add a stage of the user's to the realtime renderer's frame, as `Renderer.add_stage` does. Before that is
        made, mistakes are found with it: the frame then raises their SolariError, and goes on without the stage."""
        made_stage("Viewer", stage, METERING_SIZE)
        if self.realtime is not None:
            self.realtime.add_stage(stage, after=after)
        self.own_stages.append((stage, after))

    def remove_stage(self, name: str) -> None:
        """Remove a stage of the user's. Raises SolariError for any other name."""
        names = [made_stage("Viewer", stage, METERING_SIZE).name for stage, _ in self.own_stages]
        if name not in names:
            raise unknown_name("Viewer.remove_stage: there is no stage of your own", name, names)
        if self.realtime is not None:
            self.realtime.remove_stage(name)
        del self.own_stages[names.index(name)]
        if self.view not in self.known_views:
            self.view = PICTURE

    def _add_own_stages(self, renderer: Renderer) -> None:
        """Raises SolariError for one that fails; a first renderer is then made without it."""
        for stage, after in self.own_stages:
            try:
                renderer.add_stage(stage, after=after)
            except SolariError:
                if self.realtime is None:
                    self.own_stages = [one for one in self.own_stages if one[0] is not stage]
                    self.view = self.debug_view
                raise

    @property
    def mode(self) -> str:
        return self._mode

    @mode.setter
    def mode(self, mode: str) -> None:
        if mode not in MODES:
            raise SolariError(f"the viewer's mode is one of {', '.join(MODES)}, not {quoted(mode)}")
        self._mode = mode

    @property
    def size(self) -> Size:
        """Width and height of the latest picture in pixels; in the mode "split" of the realtime one."""
        return self._build.reference if self.mode == "reference" else self._build.realtime

    @property
    def rendered_size(self) -> Size:
        """Width and height of a picture of as many pixels as are traced: less than the picture's with upscale."""
        if self.mode == "reference" or self.realtime is None:
            return self.size
        return divided(self.size, self.realtime.settings.upscale)

    @property
    def refuses(self) -> bool:
        """Whether the latest frame had another size, or another choice of `counts_rays`, than was asked for."""
        return self._refused is not None

    # ---- rendering ----------------------------------------------------------------------------------

    def render(self, camera: Camera, pixels: Size, scale: float = 1.0) -> None:
        """Submit the next frame of the pictures that the mode shows.

        pixels: width and height of the window. scale: the share of each that is rendered. A size that can't be built,
        for example because a shader has an error, raises SolariError once. Further frames then keep the last size that
        could be built, until another size is asked for or `reload` is called.

        The path tracer adds one sample per pixel while the camera moves and in the mode "split", so that frames are
        short, and otherwise as many as fill a dispatch.
        """
        self._check_choices()
        self.binder.update()  # raises an error in the scene here, so that the size isn't taken for its cause
        moved = self.most_bands is None and self._has_moved(camera)
        self.is_short = moved or self.mode != "reference"
        self.camera = None  # until the frame has succeeded
        wanted = Build.of(pixels, scale, self.counts_rays and self.mode != "reference")
        build = self._build if wanted == self._refused else wanted
        failing = "realtime"
        try:
            if self.mode != "reference":
                self._render_realtime(camera, build)
            if self.mode != "realtime":
                failing = "reference"
                self._render_reference(camera, build)
            self._render_raw(camera)
        except SolariError:
            if self._refuses_build(failing, build):
                self._refused = wanted
            raise
        self._build = build
        if wanted == build:
            self._refused = None
        self.camera = dataclasses.replace(camera)

    def _check_choices(self) -> None:
        may_come = self.realtime is None and bool(self.own_stages)  # the outputs that are views are known later
        if not (may_come or self.view in self.known_views) or self.tonemap not in TONEMAPS:
            raise SolariError(f"the viewer has no view {quoted(self.view)} or no tone mapping {quoted(self.tonemap)}")

    def _has_moved(self, camera: Camera) -> bool:
        """Whether the latest frame had another pose, or failed."""
        return self.camera is None or bool((self.camera.transform != camera.transform).any())

    def _refuses_build(self, failing: str, build: Build) -> bool:
        """Whether an error in a renderer comes from the build, and further frames go on with the last one."""
        # The renderer that failed has what the build asks for: then something else is wrong. Without an earlier build
        # there is nothing to go on with, and each frame tries again.
        return not self._is_built(failing, build) and self._build != Build() and build != self._build

    def view_key(self, camera: Camera) -> Hashable:
        """What the picture depends on but for its size, the settings, the exposure and the tone mapping: when it
        changes, what was rendered before is of no use. The scene counts as it was at its latest update."""
        # Arrays can't be compared as wholes or hashed, their bytes can.
        fields = [getattr(camera, name) for name in Camera._names if name not in UNSEEN_FIELDS]
        seen = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in fields)
        return seen, self.binder.scene_revision, self.mode, self.view, self.counts_rays

    def expose(self, camera: Camera) -> None:
        """Show the path tracer's picture with another exposure and tone mapping, without tracing anything."""
        if self.reference is not None:
            self.reference.expose(camera, self.tonemap)

    def complete(self) -> None:
        """Give all pixels of the path tracer's picture as many samples, by tracing the bands that lack the latest."""
        tracer = self.reference and self.reference.tracer
        if tracer and self.camera is not None and self.mode != "realtime" and tracer.unfinished_bands[0]:
            tracer.advance(self.camera)

    @property
    def previews(self) -> bool:
        """Whether the path tracer's picture is shown until the realtime renderer, which is made already, has one."""
        return self.mode == "realtime" and self.realtime is not None and not self.realtime.frame_count

    def preview(self, camera: Camera, pixels: Size, scale: float) -> None:
        """Add a sample per pixel to the path tracer's picture."""
        self._render_reference(camera, Build.of(pixels, scale, False))

    def _is_built(self, name: str, build: Build) -> bool:
        """Whether the renderer "realtime" or "reference" has what it needs for a build."""
        if name == "reference":
            return self.reference is not None and self.reference.size == self._reference_size(build)
        if self.realtime is None:
            return False
        display = self.realtime.resource("display")
        made = (display.width, display.height), self._made_upscale, self.realtime.count_rays
        return made == (build.realtime, build.upscale, build.counts_rays)

    @property
    def upscale(self) -> float:
        """The factor by which the realtime picture is upscaled: the setting follows the scale until the user changes
        it, and again when the scale changes."""
        return self._upscaling.factor(self.settings)

    def prefer_users_upscale(self) -> None:
        """Upscale by the user's setting until the scale changes, also if the setting is the same as before."""
        self._upscaling.prefer(self.settings)

    def _render_realtime(self, camera: Camera, build: Build) -> None:
        if self.keeps_realtime and self._is_built("realtime", build):
            return
        settings = self._upscaling.follow(self.settings, build.upscale)
        if self.realtime is None or self.realtime.count_rays != build.counts_rays:
            # The old renderer goes once the new one is made: an error leaves it in use.
            made = Renderer(
                self.device, self.binder, build.realtime, settings, seed=self.seed, count_rays=build.counts_rays
            )
            try:
                self._add_own_stages(made)
            except BaseException:
                made.close()
                raise
            if self.realtime is not None:
                self.realtime.close()
            self.realtime = made
        if self.realtime.size != build.realtime:
            self.realtime.resize(build.realtime)
        if self.realtime.between != self.interrupted:
            self.realtime.between = self.interrupted
        self.realtime.meanwhile = self.meanwhile
        self.realtime.view = self.view
        self.realtime.tonemap = self.tonemap
        self.realtime.render(camera)
        self._made_upscale = build.upscale

    def _reference_size(self, build: Build) -> Size:
        """In the mode "split", pictures are compared pixel by pixel of what is rendered."""
        return self.realtime.render_size if self.mode == "split" and self.realtime else build.reference

    def _render_reference(self, camera: Camera, build: Build) -> None:
        size = self._reference_size(build)
        if self.reference is None:
            self.reference = ReferencePicture(self.device, self.binder, size, self.seed)
        # A picture with all its samples is only tone mapped again.
        most = 1 if self.is_short else self.most_samples
        if self.sample_limit:
            most = min(most, self.sample_limit - self.reference.tracer.samples)
        if most > 0 or self.reference.size != size:
            self.reference.render(camera, size, self.tonemap, max(most, 1), self.most_bands)
        else:
            self.reference.expose(camera, self.tonemap)

    @property
    def _shows_raw(self) -> bool:
        """Whether the picture has a raw one beside it."""
        has_raw = self.realtime is not None and "raw_radiance" in self.realtime.outputs
        return has_raw and self.mode == "split" and self.view == PICTURE and self.settings.denoise

    def _render_raw(self, camera: Camera) -> None:
        if not self._shows_raw:
            return
        assert self.realtime is not None
        radiance = self.realtime.resource("raw_radiance")
        size = self.realtime.render_size
        if self._raw is None:
            self._raw = ToneMapped(self.device, radiance, size)
        self._raw.fit(radiance, size)
        self._raw.render(camera.exposure, self.tonemap)

    def cut(self) -> None:
        """Drop the realtime renderer's history, because the next picture has nothing in common with the latest."""
        if self.realtime is not None:
            self.realtime.reset()

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipelines then stay in use."""
        self._refused = None
        for item in (self.realtime, self.reference, self._raw):
            if item is not None:
                item.reload()

    # ---- results ------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether there is a picture to show in this mode."""
        has_realtime = self.realtime is not None and self.realtime.has_frame
        has_reference = self.reference is not None and self.reference.mean_samples > 0
        if self.mode == "split":
            return has_realtime and has_reference
        return has_realtime if self.mode == "realtime" else has_reference

    @property
    def whole(self) -> bool:
        """Whether all pixels of the picture have been rendered."""
        return self.ready and (self.mode == "realtime" or bool(self.reference and self.reference.tracer.samples))

    def columns(self) -> dict[str, tuple[float, float]]:
        """The names of the pictures that are shown side by side, from left to right, and where each begins and ends, as
        shares of the width."""
        if self.mode != "split":
            return {self.mode: (0.0, 1.0)}
        if not self._shows_raw:
            return {"realtime": (0.0, self.divider), "reference": (self.divider, 1.0)}
        # The denoised picture is a strip around the divider, so that it can be dragged over any place.
        begin, end = max(self.divider - STRIP / 2, 0.0), min(self.divider + STRIP / 2, 1.0)
        return {"raw": (0.0, begin), "denoised": (begin, end), "reference": (end, 1.0)}

    def parts(self) -> list[Part]:
        """The parts of images that make up the latest picture; an empty list before the first frame."""
        images = self._images()
        if self.previews and "reference" in images:
            return [Part(images["reference"])]
        columns = self.columns()
        if not columns.keys() <= images.keys():
            # In the mode "split" the realtime picture stands alone until the path tracer's is there.
            return [Part(images["realtime"])] if "realtime" in images and self.mode != "reference" else []
        # The smallest image's columns are the finest borders that all images have.
        texels = min(images[name].width for name in columns)
        return [
            Part(images[name], round(begin * texels) / texels, round(end * texels) / texels)
            for name, (begin, end) in columns.items()
        ]

    def _images(self) -> dict[str, Image]:
        """The images that there are, by the names of `columns`."""
        found = {}
        if self.realtime is not None and self.realtime.frame_count:
            found["realtime"] = found["denoised"] = self.realtime.resource("display")
        if self._raw is not None:
            found["raw"] = self._raw.display
        if self.reference is not None:
            found["reference"] = self.reference.display
        return found

    def pixels(self) -> NDArray[np.uint8]:
        """The latest picture as it is shown, (height, width, 3), at the size of the largest image in it."""
        return pixels_of(self.parts())

    def radiance(self) -> NDArray[np.float32]:
        """Radiance (height, width, 3) of the latest picture, in cd/m^2; in the mode "split" of the realtime one."""
        source: Any = self.realtime
        if self.mode == "reference":
            source = self.reference and self.reference.tracer
        if source is None:
            raise SolariError("there is no picture yet")
        found: NDArray[np.float32] = source["radiance"]
        return found

    def ray_count(self) -> int:
        """The number of rays traced so far for the pictures of the mode, where they are counted. A counter may restart
        from 0."""
        count = 0
        # A renderer that was just made, as for another size, has no frame.
        if self.realtime is not None and self.realtime.has_frame and self.mode != "reference":
            count += int(self.realtime["ray_counts"].sum(dtype=np.uint64))
        if self.reference is not None and self.mode != "realtime":
            count += self.reference.tracer.rays
        return count

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each pass in the last finished frame."""
        realtime = self.realtime.timings if self.realtime is not None and self.mode != "reference" else {}
        reference = self.reference.tracer.timings if self.reference is not None and self.mode != "realtime" else {}
        return realtime | reference

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        for item in (self.realtime, self.reference, self._raw):
            if item is not None:
                item.close()
        if self._owns_binder:
            self.binder.destroy()
