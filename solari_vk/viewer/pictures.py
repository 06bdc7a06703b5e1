"""What the viewer shows of a scene: the realtime picture and the path tracer's, each made when first needed."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.display import VIEWS
from solari_vk.reference import MAX_SAMPLES, PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.settings import Settings
from solari_vk.viewer.presenter import Part

MODES = ("realtime", "reference", "split")
NOTHING = 0xFFFFFFFF  # the instance index of pixels that show none


@dataclass(frozen=True)
class Pick:
    """What a pixel shows: an instance, and the point of it in the world."""

    instance: Instance
    point: NDArray[np.float64]


class Pictures:
    """mode: one of MODES. view and tonemap: as of `Renderer`. divider: the share of the width that `split` gives to the
    realtime renderer, on the left. All may be assigned at any time. `close` frees all."""

    def __init__(self, device: Device, scene: Scene, settings: Settings, seed: int = 0, mode: str = "realtime") -> None:
        self.device, self.scene, self.settings, self.seed = device, scene, settings, seed
        self.view, self.tonemap = "picture", "agx"
        self.divider = 0.5
        self.counts_rays = False
        """Whether the realtime renderer counts its rays, which takes some time in each pass."""
        self.size = (0, 0)
        self.refused_size: tuple[int, int] | None = None
        self.refused_count: bool | None = None
        """What of `size` and `counts_rays` couldn't be built: what there was goes on."""
        self.binder = SceneBinder(device, scene)
        self.realtime: Renderer | None = None
        self.reference: PathTracer | None = None
        self._reference_frame: Frame | None = None
        self._camera: Camera | None = None  # as of the latest frame
        self.is_short = True
        """Whether the latest frame was as short as it can be at its size."""
        self.mode = mode

    @property
    def mode(self) -> str:
        return self._mode

    @mode.setter
    def mode(self, mode: str) -> None:
        if mode not in MODES:
            raise SolariError(f"the viewer's mode is one of {', '.join(MODES)}, not {mode!r}")
        self._mode = mode

    def render(self, camera: Camera, size: tuple[int, int]) -> None:
        """Submit the next frame of what the mode shows.

        A size that is refused, such as one whose frame can't be built since a shader is broken, is told once by a
        SolariError; from then on pictures have the last good size, until there is another size or a `reload`.

        While the camera moves, and beside the realtime picture, the reference gets a sample a pixel and frame, so that
        frames are short; else as many as make a dispatch worth its overhead.
        """
        if self.view not in VIEWS or self.tonemap not in TONEMAPS:
            raise SolariError(f"the viewer has no view {self.view!r} or no tone mapping {self.tonemap!r}")
        self.binder.update()  # what is wrong with the scene is no reason to refuse a size
        moved = self._camera is None or (self._camera.transform != camera.transform).any()
        self.is_short = moved or self.mode != "reference"
        self._camera = None
        good = self.size
        self.size = good if size == self.refused_size else size
        try:
            if self.mode != "reference":
                current = "realtime"
                self._render_realtime(camera)
            if self.mode != "realtime":
                current = "reference"
                self._render_reference(camera)
        except SolariError:
            built = _size(self.realtime if current == "realtime" else self._reference_frame)
            if built != self.size and good not in (self.size, (0, 0)):
                self.refused_size, self.size = self.size, good
            raise
        self._camera = copy.copy(camera)

    @property
    def refuses(self) -> bool:
        """Whether something else is shown than was asked for."""
        counts = self.mode != "reference" and self.refused_count == self.counts_rays
        return counts or self.refused_size is not None

    def _render_realtime(self, camera: Camera) -> None:
        if self.refused_count not in (None, self.counts_rays):
            self.refused_count = None
        if self.realtime is None:
            self.realtime = self._new_realtime()
        elif self.realtime.count_rays != self.counts_rays and self.refused_count is None:
            try:
                other = self._new_realtime()
            except SolariError:
                self.refused_count = self.counts_rays
                raise
            self.realtime.close()
            self.realtime = other
        elif self.realtime.size != self.size:
            self.realtime.resize(self.size)
        self.realtime.view, self.realtime.tonemap = self.view, self.tonemap
        self.realtime.render(camera)

    def _new_realtime(self) -> Renderer:
        return Renderer(
            self.device, self.binder, self.size, self.settings, seed=self.seed, count_rays=self.counts_rays
        )  # fmt: skip

    def _render_reference(self, camera: Camera) -> None:
        if self.reference is None:
            self.reference = PathTracer(self.device, self.binder, self.size, seed=self.seed)
        elif self.reference.size != self.size:
            self.reference.resize(self.size)
        pixels = {"radiance_mean": self.reference.resource("radiance_mean")}
        stages = [Stage("viewer", images={"display": self.size}, passes=[Pass("viewer/show", threads=self.size)])]
        frame = self._reference_frame
        if frame is None:
            frame = self._reference_frame = Frame(self.device, stages, external=pixels)
        elif frame.resource("radiance_mean") is not pixels["radiance_mean"] or _size(frame) != self.size:
            frame.rebuild(stages, pixels)
        self.reference.advance(camera, 1 if self.is_short else MAX_SAMPLES)
        frame.uniforms["size"] = self.size
        frame.uniforms["exposure"] = camera.exposure
        frame.uniforms["tonemap"] = TONEMAPS.index(self.tonemap)
        frame.submit()

    def parts(self) -> list[Part]:
        """What of which image is shown where, as of the latest frame; none before the first."""
        realtime = self.realtime.resource("display") if self.realtime and self.realtime.frame_count else None
        reference = self._reference_frame.resource("display") if self._reference_frame else None
        if self.mode == "split" and realtime is not None and reference is not None:
            return [Part(realtime, 0, self.divider), Part(reference, self.divider, 1)]
        shown = reference if self.mode == "reference" else realtime
        return [] if shown is None else [Part(shown)]

    def cut(self) -> None:
        """What comes next has nothing to do with what was seen last."""
        if self.realtime is not None:
            self.realtime.reset()

    def reload(self) -> None:
        """Take up changed shaders; raises CompilationError when one can't be compiled, and the old ones go on."""
        self.refused_size = self.refused_count = None
        for item in (self.realtime, self.reference):
            if item is not None:
                item.reload()
        if self._reference_frame is not None:
            self._reference_frame.rebuild()

    # ---- results ------------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the mode has a picture to read."""
        realtime = self.realtime is not None and self.realtime.frame_count > 0
        reference = self.reference is not None and self.reference.samples > 0
        return {"realtime": realtime, "reference": reference, "split": realtime and reference}[self.mode]

    def pixels(self) -> NDArray[np.uint8]:
        """The latest picture as it is shown, (height, width, 3), at the size it was rendered in."""
        parts = self.parts()
        if not parts:
            raise SolariError("there is no picture yet")
        columns = [
            part.image.read()[:, round(part.begin * part.image.width) : round(part.end * part.image.width), :3]
            for part in parts
        ]
        return np.concatenate(columns, axis=1)

    def radiance(self) -> NDArray[np.float32]:
        """Radiance (height, width, 3) of the latest picture; of the realtime renderer where both are shown."""
        source: Any = self.reference if self.mode == "reference" else self.realtime
        if source is None:
            raise SolariError("there is no picture yet")
        found: NDArray[np.float32] = source["radiance"]
        return found

    def error(self) -> tuple[float, float] | None:
        """How far the realtime picture is from the path tracer's: the root of the mean squared difference of what is
        shown, as a share of white, and the difference of the mean radiance, as a share of it. None without both, and
        for debug views, which the path tracer has none of."""
        if self.mode != "split" or self.view != "picture" or not self.ready:
            return None
        assert self.realtime is not None
        assert self.reference is not None
        assert self._reference_frame is not None
        shown = [item["display"][..., :3] / 255.0 for item in (self.realtime, self._reference_frame)]
        found, truth = (float(item["radiance"].mean(dtype=np.float64)) for item in (self.realtime, self.reference))
        if shown[0].shape != shown[1].shape or not truth > 0:
            return None
        return float(np.sqrt(((shown[0] - shown[1]) ** 2).mean())), found / truth - 1

    def ray_count(self) -> int:
        """Rays traced so far by what the mode shows, of those that are counted; it may begin anew."""
        count = 0
        if self.realtime is not None and self.mode != "reference":
            count += int(self.realtime["ray_counts"].sum(dtype=np.uint64))
        if self.reference is not None and self.mode != "realtime":
            count += self.reference.rays
        return count

    def pick(self, x: float, y: float) -> Pick | None:
        """What is seen at a place of the picture, both from 0 to 1; None where nothing is."""
        camera = self._camera
        if not self.ready or camera is None or not (0 <= x < 1 and 0 <= y < 1):
            return None
        column, row = int(x * self.size[0]), int(y * self.size[1])
        if self.mode == "reference":
            assert self.reference is not None
            index, point = self.reference["instance_id"][row, column], self.reference["position"][row, column]
        else:
            assert self.realtime is not None
            index = self.realtime["gbuffer_surface"][row, column, 1]
            depth = float(self.realtime["depth"][row, column, 0])
            point = point_at(camera, self.size, (column + 0.5, row + 0.5), camera.near / depth) if depth else None
        instance = self.binder.instances.get(int(index)) if index != NOTHING else None
        return None if instance is None or point is None else Pick(instance, np.asarray(point, np.float64))

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of the passes in the last finished frame."""
        found: dict[str, float] = {}
        if self.realtime is not None and self.mode != "reference":
            found |= self.realtime.timings
        if self.reference is not None and self.mode != "realtime":
            found |= self.reference.timings
        return found

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        for item in (self._reference_frame, self.realtime, self.reference):
            if item is not None:
                item.close()
        self.binder.destroy()


def _size(source: Renderer | Frame | None) -> tuple[int, int]:
    """The size of the picture that a renderer was last built for."""
    image = None if source is None else source.resource("display")
    return (0, 0) if image is None else (image.width, image.height)


def point_at(
    camera: Camera, size: tuple[int, int], pixel: tuple[float, float], view_depth: float
) -> NDArray[np.float64]:
    """The world's point at a place of the picture, in pixels, so many metres along the view axis."""
    slope = np.tan(camera.vertical_fov / 2)
    across = (2 * pixel[0] / size[0] - 1) * slope * size[0] / size[1]
    up = (1 - 2 * pixel[1] / size[1]) * slope
    found: NDArray[np.float64] = camera.transform[:3] @ (*(view_depth * np.array((across, up, -1))), 1.0)
    return found
