"""What one camera shows in browsers: its movements, options and pictures. Runs on the thread that owns the device."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, is_name, quoted, unknown_name
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import DEBUG_VIEWS, check_view, views_of
from solari_vk.passes.reference import MAX_SAMPLES
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, Settings
from solari_vk.studio.browser.picture import move, number
from solari_vk.studio.viewer.camera_control import CameraControl, extent_of
from solari_vk.studio.viewer.compile_preview import CompilePreview
from solari_vk.studio.viewer.picking import pick_at, seen_distance
from solari_vk.studio.viewer.pictures import MODES, Pictures, meter_exposure
from solari_vk.studio.viewer.scaling import CPU_FPS, ScaleControl

GPU_FPS = 30.0  # frames a second that the scale "auto" aims at on a GPU
REST = 8  # frames after the last change from which the whole size is rendered, and the path tracer's turn has come
ENOUGH_FRAMES = 64  # frames of the whole size after which the realtime picture is finished
HIDDEN = 4  # frames of the whole size, and samples of the path tracer, that look worse than what was shown before
WHOLE_AT_ONCE = 1.0  # seconds that a frame of the whole size may take for a picture at rest that grows in one step
SCALE_OF_ITS_OWN = {"upscale"}  # settings that follow the scale
LONGEST = 0.4  # seconds that a frame of the path tracer may take if it has several samples: movements wait for it
EXPOSURES = 100.0  # EV100 from minus to plus this

Tell = Callable[[dict[str, Any], NDArray[np.uint8] | None], object]


@dataclass(frozen=True)
class Shown:
    """A picture (height, width, 3), sRGB, and what the page says about it."""

    codes: NDArray[np.uint8]
    about: dict[str, Any]
    finished: bool


class Screens:
    """A scene on a device, and how new screens show it. `close` frees the scene on the device, then what is `owned`.

    mode, view, tonemap, seed, scale: as in `Viewer` and `Pictures`. size: the largest picture, which the page scales.
    samples: of each pixel, after which the path tracer's picture is finished.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        camera: Camera,
        *,
        size: tuple[int, int],
        name: str = "",
        mode: str = "realtime",
        view: str = "picture",
        tonemap: str = "agx",
        settings: Settings | None = None,
        seed: int = 0,
        scale: str | float = "auto",
        fps: float | None = None,
        samples: int = 256,
    ) -> None:
        self.device = device
        self.scene = scene
        self.camera = camera
        self.size = size
        self.name = name or scene.name
        self.mode = mode
        self.view = view
        self.tonemap = tonemap
        self.settings = Settings() if settings is None else settings
        self.seed = seed
        self.samples = samples
        self._scale = scale
        self._fps = fps or (CPU_FPS if device.properties.kind == "cpu" else GPU_FPS)
        self.owned = ExitStack()
        self.scale_control()  # raises an error in the scale at once
        self.binder = SceneBinder(device, scene)
        meter_exposure(device, self.binder, camera)

    @property
    def lost(self) -> bool:
        """Whether the device is lost."""
        return self.device.lost

    def scale_control(self) -> ScaleControl:
        """A control of the share of the size that is rendered while the camera moves."""
        return ScaleControl(self._scale, 1 / self._fps)

    def open(self, tell: Tell, state: Mapping[str, Any] | None = None) -> Screen:
        """A new screen. tell: called with what the pages should say while the first picture takes long, and with the
        picture so far. state: `Shown.about["state"]` of a screen to go on from."""
        return Screen(self, tell, state)

    def describe(self) -> dict[str, Any]:
        """What pages know from the start: names, choices, and the settings with their meaning."""
        shown = [name for name in FIELDS if name not in SCALE_OF_ITS_OWN]
        return {
            "name": self.name,
            "device": self.device.name,
            "size": self.size,
            "modes": MODES,
            "tonemaps": TONEMAPS,
            "views": {name: DEBUG_VIEWS[name] for name in views_of(self.settings.lighting)},
            "qualities": list(QUALITIES),
            "samples": self.samples,
            "settings": [_described(name) for name in shown],
        }

    def close(self) -> None:
        """Free the scene, after the screens."""
        self.binder.destroy()
        self.owned.close()


class Screen:
    """One camera and its pictures. Messages of pages move it; `render` makes the next picture.

    In the mode "reference" the realtime renderer shows the camera while it moves, and the path tracer once it rests.
    """

    def __init__(self, screens: Screens, tell: Tell, state: Mapping[str, Any] | None) -> None:
        self._screens = screens
        self._tell = tell
        self.mode = screens.mode
        self.finished = False
        self.control = CameraControl(screens.camera, extent_of(screens.scene))
        self._scale = screens.scale_control()
        self._center: NDArray[np.float64] | None = None  # of the drag that goes on
        self._knows_distance = False  # whether the control knows how far away things are
        self._still = 0  # frames since the last change
        self._resting = 1.0, 0  # the scale of the picture at rest, and its frames
        self._seconds = 0.0  # that the latest frame took
        with ExitStack() as undo:
            # Settings of its own, which its page changes; the scene on the device is shared.
            self.pictures = Pictures(screens.device, screens.binder, copy.copy(screens.settings), screens.seed)
            undo.callback(self.pictures.close)
            self.pictures.view = screens.view
            self.pictures.tonemap = screens.tonemap
            self.pictures.most_samples = 1
            if state:
                self._restore(state)
            undo.pop_all()

    # ---- messages -----------------------------------------------------------------------------------

    def do(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Do what a page asks, and return the answer to it, {} for none.

        message: one of {"move": movement}, {"grab": [x, y]}, {"pick": [x, y]}, {"set": {name: value}}. Raises
        SolariError, TypeError or ValueError for what can't be done.
        """
        if "move" in message:
            self._move(message["move"])
            return {}
        if "grab" in message:
            self._grab(message["grab"])
            return {}
        if "pick" in message:
            return {"picked": self._picked(message["pick"])}
        if "set" in message:
            for name, value in message["set"].items():
                self._set(name, value)
            return {"options": self.options()}
        raise SolariError(f"a page asked for something unknown: {quoted(dict(message))}")

    def _move(self, movement: Mapping[str, Any]) -> None:
        if bool(movement.get("home")):
            self._knows_distance = False
            self._center = None
            self.pictures.cut()
        if move(self.control, movement, self._center):
            self._change()

    def _grab(self, place: Any) -> None:
        """Begin a drag: from now on movements orbit around what is there."""
        pick = self._pick(place)
        self._center = None if pick is None else pick.point
        if pick is not None:
            self.control.see(float(np.linalg.norm(pick.point - self.control.camera.transform[:3, 3])))

    def _picked(self, place: Any) -> dict[str, Any] | None:
        """What a page says about what is there, None for the background."""
        pick = self._pick(place)
        if pick is None:
            return None
        return {
            "name": pick.instance.name or pick.instance.describe(),
            "material": pick.instance.material.name,
            "point": [round(float(x), 4) for x in pick.point],
        }

    def _pick(self, place: Any) -> Any:
        x, y = (number(share) for share in place)
        return pick_at(self.pictures, x, y)

    def _set(self, name: str, value: Any) -> None:
        pictures = self.pictures
        settings = self.pictures.settings
        match name:
            case "mode":
                self.mode = _one_of("mode", value, MODES)
            case "view":
                if not is_name(value, pictures.known_views):
                    check_view(value, settings.lighting)
                pictures.view = value
            case "tonemap":
                pictures.tonemap = _one_of("tone mapping", value, TONEMAPS)
            case "divider":
                pictures.divider = min(max(number(value), 0.0), 1.0)
            case "ev100":
                self.control.camera.ev100 = min(max(number(value), -EXPOSURES), EXPOSURES)
            case "quality":
                for field, preset in QUALITIES[_one_of("quality", value, QUALITIES)].items():
                    setattr(settings, field, preset)
            case _ if name in FIELDS and name not in SCALE_OF_ITS_OWN:
                setattr(settings, name, value)
            case _:
                raise unknown_name("there is no option", name, FIELDS)
        # Another divider or tone mapping shows the same frames: nothing is rendered anew for it.
        if name not in ("divider", "tonemap"):
            self._change()
        self.finished = False

    def options(self) -> dict[str, Any]:
        """What `set` changes, as it is now; of the settings those that differ from their defaults."""
        pictures = self.pictures
        settings = {name: getattr(pictures.settings, name) for name in FIELDS if name not in SCALE_OF_ITS_OWN}
        return {
            "mode": self.mode,
            "view": pictures.view,
            "tonemap": pictures.tonemap,
            "divider": pictures.divider,
            "ev100": self.control.camera.ev100,
            "settings": {name: value for name, value in settings.items() if value != DEFAULTS[name]},
        }

    def state(self) -> dict[str, Any]:
        """What `_restore` takes, as JSON values."""
        return {"pose": self.control.camera.pose(), "distance": self.control.distance, "options": self.options()}

    def _restore(self, state: Mapping[str, Any]) -> None:
        options = dict(state["options"])
        for name in FIELDS:
            if name not in SCALE_OF_ITS_OWN:
                setattr(self.pictures.settings, name, DEFAULTS[name])
        # Settings come first: a debug view may need the lighting that they choose.
        for name, value in {**options.pop("settings"), **options}.items():
            self._set(name, value)
        self.control.look_through(Camera.from_pose(state["pose"]))
        self.control.distance = number(state["distance"])
        self._knows_distance = True

    def _change(self) -> None:
        if self._still > REST:
            self._scale.forget_times()  # the latest times are those of whole pictures
        self._still = 0
        self.finished = False

    # ---- pictures -----------------------------------------------------------------------------------

    def render(self) -> Shown | None:
        """The next picture, None if it looks worse than the one before. Sets `finished` when it is finished."""
        pictures = self.pictures
        began = time.perf_counter()
        rests = self._still >= REST
        # The path tracer's first samples are noise, so the realtime renderer shows the camera while it moves.
        pictures.mode = self.mode if self.mode != "reference" or rests else "realtime"
        self._resting = self._grown() if rests else (self._scale.scale, 0)
        scale, frames = self._resting
        self._render_frame(scale)
        codes = pictures.pixels()
        self._seconds = time.perf_counter() - began
        self._still += 1
        self._resting = scale, frames + 1
        if not self._knows_distance:
            self._knows_distance = True
            self.control.see(seen_distance(pictures))
        self._adjust(rests, self._seconds)
        done = self._share_done(rests)
        self.finished = done >= 1
        # The whole size begins with few frames or samples, which look worse than what moved before.
        begins_anew = scale > self._scale.scale or pictures.mode == "reference"
        if rests and begins_anew and not self.finished and (self._samples or frames + 1) < HIDDEN:
            return None
        about = {
            "rendered": pictures.rendered_size,
            "seconds": self._seconds,
            "samples": self._samples,
            "done": min(max(done, 0.0), 1.0),
            "finished": self.finished,
            "columns": pictures.columns(),
            "state": self.state(),
        }
        return Shown(codes, about, self.finished)

    def _render_frame(self, scale: float) -> None:
        if self.pictures.ready:
            self.pictures.render(self.control.camera, self._screens.size, scale)
            return
        # The first picture takes a software device up to a minute of compiling, during which pages see a preview.
        with CompilePreview(self.pictures, self._show_wait, lambda: self._preview(scale)):
            self.pictures.render(self.control.camera, self._screens.size, scale)

    def _adjust(self, rests: bool, seconds: float) -> None:
        """Choose the size, or the path tracer's samples, of the next frames by the time that this one took."""
        if not rests:
            self._scale.record_frame(seconds)
        elif self.pictures.mode == "reference":
            most = self.pictures.most_samples
            self.pictures.most_samples = max(most // 2, 1) if seconds > LONGEST else min(2 * most, MAX_SAMPLES)

    @property
    def _samples(self) -> int:
        """Samples per pixel of the path tracer's picture, 0 if none is shown."""
        pictures = self.pictures
        return 0 if pictures.mode == "realtime" or not pictures.reference else pictures.reference.tracer.samples

    def _share_done(self, rests: bool) -> float:
        """How much of the picture's work is done; from 1 on it is finished."""
        if self.pictures.mode == "reference":
            return self._samples / self._screens.samples
        scale, frames = self._resting
        return frames / ENOUGH_FRAMES if rests and scale == 1 else 0.0

    def _grown(self) -> tuple[float, int]:
        """The scale of the next frame at rest, and how many frames there are of it: the whole size, which is doubled
        up to where a frame of it would take long, so that the picture doesn't stay small until the last step."""
        scale, frames = self._resting
        if scale == 1 or (scale > self._scale.scale and frames <= HIDDEN):
            return scale, frames
        # A frame's time grows with its pixels, so that of the whole size is about seconds / scale^2.
        at_once = self.pictures.mode == "reference" or self._seconds < WHOLE_AT_ONCE * scale**2
        return (1.0 if at_once else min(2 * scale, 1.0)), 0

    def _preview(self, scale: float) -> None:
        self.pictures.preview(self.control.camera, self._screens.size, scale)

    def _show_wait(self, text: str) -> None:
        """Tell the pages why the first picture takes long, and show the path tracer's until then."""
        has_preview = self.pictures.previews and self.pictures.reference is not None
        self._tell({"note": text}, self.pictures.pixels() if has_preview else None)

    def picture(self) -> NDArray[np.uint8]:
        """The latest picture, (height, width, 3), sRGB. Raises SolariError if there is none yet."""
        return self.pictures.pixels()

    def close(self) -> None:
        """Free everything of this screen on the device."""
        self.pictures.close()


def _one_of(what: str, value: Any, known: Iterable[str]) -> Any:
    if value not in tuple(known):
        raise unknown_name(f"there is no {what}", value, known)
    return value


def _described(name: str) -> dict[str, Any]:
    """A setting for the page, as JSON values."""
    field = FIELDS[name]
    return {
        "name": name,
        "section": field.section,
        "meaning": field.meaning,
        "choices": field.choices,
        "default": DEFAULTS[name],
        "low": field.low,
        # JSON has no infinity.
        "high": None if math.isinf(field.high) else field.high,
    }
