"""The interactive viewer: a window, a camera in one's hands, and what the renderers show."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import DeviceError, SolariError, ValidationError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.swapchain import Swapchain
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.studio import frame_camera
from solari_vk.settings import Settings
from solari_vk.viewer.actions import Actions
from solari_vk.viewer.camera_control import CameraControl
from solari_vk.viewer.controls import Controls
from solari_vk.viewer.messages import Messages
from solari_vk.viewer.pictures import Pick, Pictures
from solari_vk.viewer.presenter import Presenter
from solari_vk.viewer.reload import Sources
from solari_vk.viewer.scaling import ScaleControl
from solari_vk.viewer.window import Window, checked_size

LONGEST_STEP = 0.25  # seconds that a camera flies in a frame at most, however long the frame took
HIDDEN_WAIT = 0.1  # seconds between looks at a window that shows nothing
CPU_FPS, GPU_FPS = 7.0, 60.0  # what scale "auto" aims at by default


class Viewer(Messages):
    """A window that shows a scene, until it is closed. A context manager.

    size: of the window. camera: where to begin (default: the scene's first, else one that sees all of it); `camera` is
    a copy that the user moves. mode: "realtime", "reference" or "split". scale: the share of the window's width
    and height that is rendered, or "auto" to aim at `fps` frames a second (default: 60, on a CPU 7). overlay: panels
    over the picture, where imgui-bundle is installed. source and source_options: what the scene was loaded from, as
    the words of a command line, and load: how to load it once more when the file changes. folder: where screenshots go.

    `run(on_frame)` calls on_frame(viewer, seconds since the last frame) before each frame, which may edit the scene,
    `settings` and everything else. Raises SolariError where no window can be opened, DeviceError when the device can't
    draw in it; what goes wrong later, such as a shader that can't be compiled, is shown in the window.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        size: tuple[int, int] = (1280, 720),
        camera: Camera | None = None,
        mode: str = "realtime",
        scale: str | float = "auto",
        fps: float | None = None,
        settings: Settings | None = None,
        seed: int = 0,
        overlay: bool = True,
        source: str | None = None,
        source_options: Sequence[str] = (),
        load: Callable[[], Scene] | None = None,
        folder: str | Path = ".",
    ) -> None:
        size = checked_size(size)
        super().__init__()
        self.device, self.scene, self.folder = device, scene, Path(folder)
        self.source, self.source_options = source, source_options
        self.settings = Settings() if settings is None else settings
        self.pick: Pick | None = None
        """What was picked last."""
        self.shows_help = self.shows_overlay = False
        self.frame_count = 0
        self._spans: deque[float] = deque(maxlen=20)  # seconds between the latest frames
        self.timings: dict[str, float] = {}
        """GPU milliseconds of the passes in the last finished frame."""
        self._timed_mode = mode
        self._last = time.perf_counter()
        if fps is None:
            fps = CPU_FPS if device.properties.kind == "cpu" else GPU_FPS
        if not fps > 0:
            raise SolariError(f"the viewer's fps must be more than 0, not {fps!r}")
        self.scale = ScaleControl(scale, 1 / fps)
        extent = _extent(scene)
        self.camera_control = CameraControl(camera or _first_camera(scene, size[0] / size[1]), extent)
        self._actions = Actions(self)
        self.controls = Controls(self.camera_control, self.act)
        self._sources = Sources(scene, Path(source) if source else None, load)
        self._closers = contextlib.ExitStack()
        try:
            self.window = Window(size, "solari_vk")
            self._closers.callback(self.window.close)
            self._swapchain = Swapchain(device, self.window.create_surface, lambda: self.window.pixels)
            self._closers.callback(self._swapchain.close)
            self._presenter = Presenter(device, self._swapchain)
            self._closers.callback(self._presenter.close)
            self.pictures = Pictures(device, scene, self.settings, seed, mode)
            self._closers.callback(self.pictures.close)
            self.overlay: Any = None
            if overlay:
                self._open_overlay()
        except BaseException:
            self._closers.close()
            raise

    def _open_overlay(self) -> None:
        try:
            from solari_vk.viewer.overlay import Overlay
        except ImportError:
            self.say("without imgui-bundle there are no panels: H lists the keys")
            return
        self.overlay = Overlay(self)
        self.shows_overlay = True
        self._closers.callback(self.overlay.close)

    # ---- running ------------------------------------------------------------------------------------

    @property
    def camera(self) -> Camera:
        """The camera in the user's hands."""
        return self.camera_control.camera

    def run(self, on_frame: Callable[[Viewer, float], None] | None = None, frames: int | None = None) -> None:
        """Show frames until the window is closed, or so many; those of a window that shows nothing count too."""
        for _ in itertools.count() if frames is None else range(frames):
            if self.window.wants_to_close:
                break
            self.step(on_frame)

    def step(self, on_frame: Callable[[Viewer, float], None] | None = None) -> bool:
        """Follow what the user did, render and show a frame; False when the window shows nothing just now."""
        visible = 0 not in self.window.pixels
        self._take_events(0.0 if visible else HIDDEN_WAIT)
        now = time.perf_counter()
        seconds, self._last = now - self._last, now
        self.camera_control.advance(min(seconds, LONGEST_STEP))
        self._reload_changed()
        if on_frame is not None:
            on_frame(self, seconds)
        pixels = self.window.pixels
        if 0 in pixels or self.window.wants_to_close:
            return False
        if self.overlay is not None:
            self.overlay.lay_out(seconds)
        if not self.pictures.ready and "picture" not in self._faults:
            self._show_wait()
        self._render(self.scale.size(pixels))
        shown = self._show()
        self.frame_count += 1
        self._take_time(seconds, time.perf_counter() - now)
        return shown

    def capture(self) -> NDArray[np.uint8]:
        """What the window shows, (height, width, 3), the panels too. SolariError when that can't be read."""
        if self.window.closed:
            raise SolariError("the window is closed")
        draw = None if self.overlay is None else self._draw
        pixels = self._presenter.capture(self.pictures.parts(), draw)
        if pixels is None:
            raise SolariError("the window shows nothing that can be read")
        return pixels

    def _take_events(self, wait: float) -> None:
        events = self.window.take_events(wait)
        keys, mouse = True, True
        if self.overlay is not None:
            keys, mouse = self.overlay.take_events(events)
        self.controls.handle(events, takes_keys=keys, takes_mouse=mouse)

    def _render(self, size: tuple[int, int]) -> None:
        """Render; what is wrong with the scene or the shaders is told, and the last picture stays."""
        try:
            self.pictures.render(self.camera, size)
            if not self.pictures.refuses:
                self._mended("picture")
        except ValidationError:
            raise
        except SolariError as error:
            if self.device.lost:
                raise
            self._faulty("picture", error)

    def _show(self) -> bool:
        return self._presenter.show(self.pictures.parts(), None if self.overlay is None else self._draw)

    def _draw(self, index: int) -> Any:
        try:
            return self.overlay.draw(self._swapchain, index)
        except (DeviceError, ValidationError):
            raise
        except (SolariError, OSError) as error:
            self._faulty("panels", error)
            return None

    def _show_wait(self) -> None:
        """A driver may compile for long before the first picture: say so."""
        text = f"preparing the {self.pictures.mode} renderer ..."
        self.window.set_title(f"{self._name} - {text}")
        if self.overlay is not None:
            told, self.message = self.message, self.message or text
            self.overlay.lay_out(0.0)
            self.message = told
        self._show()

    def _take_time(self, since_last: float, seconds: float) -> None:
        if self.frame_count > 1:
            self._spans.append(since_last)
        self.timings = self.pictures.timings
        if self._timed_mode != self.pictures.mode:
            self._timed_mode = self.pictures.mode
            self.scale.unsettle()
        if self.pictures.is_short:
            self.scale.note(sum(self.timings.values()) / 1000 or seconds)
        self._end_message()
        width, height = self.pictures.size
        state = f"{self.pictures.mode} - {self.pictures.view} - {width}x{height} - {self.fps:.1f} fps"
        first_line = self.message.partition("\n")[0]
        self.window.set_title(f"{self._name} - {first_line or state}")

    @property
    def _name(self) -> str:
        name = Path(self.source).name if self.source else self.scene.name
        return f"{name} - solari_vk" if name else "solari_vk"

    @property
    def fps(self) -> float:
        """Frames a second, of the latest ones; 0 before there are some."""
        return len(self._spans) / sum(self._spans) if self._spans else 0.0

    # ---- actions ----------------------------------------------------------------------------------------

    def act(self, name: str, argument: Any = None) -> Any:
        """Do what a key stands for: one of controls.ACTIONS, "camera", "pick" or "grab". Mistakes are told."""
        return self._actions.act(name, argument)

    # ---- reloading ----------------------------------------------------------------------------------

    def _reload_changed(self) -> None:
        shaders, file = self._sources.changed()
        if shaders or file:
            self.reload(shaders=shaders, file=file)

    def reload(self, *, shaders: bool, file: bool) -> None:
        """Take up what changed on disk; what is wrong with it is told, and what there was goes on."""
        done = [
            self._try(where, take_up)
            for wanted, where, take_up in (
                (shaders, "shaders", self.pictures.reload),
                (shaders and self.overlay is not None, "panels", lambda: self.overlay.reload()),
                (file, "file", self._load_again),
            )
            if wanted
        ]
        self.scale.unsettle()
        if all(done):
            self.say("shaders are reloaded" if shaders and not file else "reloaded")

    def _try(self, where: str, take_up: Callable[[], object]) -> bool:
        """Take up what changed; False when something is wrong with it, which is told."""
        self._faults.pop(where, None)  # the same mistake is told again
        try:
            take_up()
        except (DeviceError, ValidationError):
            raise
        except (SolariError, OSError) as error:
            self._faulty(where, error)
            return False
        return True

    def _load_again(self) -> None:
        if self._sources.load_again():
            self.pick = None

    # ---- lifetime -----------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the window and free all. Safe to call twice."""
        self._closers.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _extent(scene: Scene) -> float:
    """The length of the scene's diagonal, 1 for one without a size."""
    try:
        return float(np.linalg.norm(np.ptp(scene.bounds(), axis=0))) or 1.0
    except SolariError:
        return 1.0


def _first_camera(scene: Scene, aspect: float) -> Camera:
    return next(iter(scene.cameras), None) or frame_camera(scene, aspect=aspect)
