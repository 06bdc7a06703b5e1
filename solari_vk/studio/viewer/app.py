"""The interactive viewer: a window, a camera that the user moves, and the pictures of the renderers."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, ValidationError, checked_keywords, quoted
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.compiler import folders
from solari_vk.renderers.own_stages import AnyStage
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import Settings
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.camera_control import CameraControl, extent_of
from solari_vk.studio.viewer.comparison import SecondScene
from solari_vk.studio.viewer.compile_preview import CompilePreview
from solari_vk.studio.viewer.controls import Controls, in_parts
from solari_vk.studio.viewer.layout import Layout
from solari_vk.studio.viewer.opening import add_recent
from solari_vk.studio.viewer.picking import seen_distance
from solari_vk.studio.viewer.pictures import Pictures, meter_exposure
from solari_vk.studio.viewer.presenter import Presenter
from solari_vk.studio.viewer.progressive import ProgressiveRenderer
from solari_vk.studio.viewer.reload import Sources
from solari_vk.studio.viewer.scaling import CPU_FPS, ScaleControl
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.status import state_in_words
from solari_vk.studio.viewer.swapchain import Swapchain
from solari_vk.studio.viewer.window import Event, Window

GPU_FPS = 60.0  # frames per second that the scale "auto" aims at on a GPU by default
MAX_STEP = 0.25  # seconds that camera and animation move in one frame at most, even if the frame took longer
SEEING = 0.1  # seconds between two looks at the distance of what is seen, each of which waits for the picture
HIDDEN_WAIT = 0.1  # seconds that a frame of a minimized window waits for events
PANELS_WAIT = 0.05  # seconds between two looks at the cursor while a frame is rendered
IDLE_WAIT = 0.05  # seconds that a frame waits for events once the picture is finished


class Viewer(Session):
    """A window that shows a scene until the user closes it. A context manager.

    size: width and height of the window. camera: the first view, by default the scene's default camera; the user moves
    a copy of it. mode: "realtime", "reference" or "split". scale: the share of the window's width and height that is
    rendered, or "auto" to aim at `fps` frames per second (default: 60, on a CPU 7). overlay: show panels over the
    picture if imgui-bundle is installed. source, source_options: the arguments that name the scene on a command line;
    screenshots note them. load: a function that loads the scene, called when its file changes. folder: the folder of
    screenshots. beside: a second scene, called beside_name, that is shown right of a line which the user drags, seen by
    the same camera.

    `run(on_frame)` calls on_frame(viewer, seconds since the last frame) before each frame. It may edit the scene,
    `settings` and everything else. Raises SolariError where no window can be opened, and DeviceError when the device
    can't draw in it. Later errors, such as one in a shader, are shown in the window.
    """

    @checked_keywords()
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
        beside: Scene | None = None,
        beside_name: str = "",
    ) -> None:
        if fps is None:
            fps = CPU_FPS if device.properties.kind == "cpu" else GPU_FPS
        if not fps > 0:
            raise SolariError(f"the viewer's fps must be more than 0, not {quoted(fps)}")
        scale_control = ScaleControl(scale, 1 / fps)
        sources = Sources(scene, Path(source) if source else None, load)
        # What is open is closed in reverse order, here if a later step fails, and otherwise by `close`: the swapchain
        # before its window, everything that draws before the swapchain.
        with ExitStack() as undo:
            window = Window(size, "solari_vk")
            undo.callback(window.close)
            window_device = _device_for_window(device, undo)
            self._swapchain = Swapchain(window_device, window.create_surface, lambda: window.pixels)
            undo.callback(self._swapchain.close)
            self._presenter = Presenter(window_device, self._swapchain)
            undo.callback(self._presenter.close)
            pictures = Pictures(device, scene, Settings() if settings is None else settings, seed, mode)
            undo.callback(pictures.close)
            area = Layout.of(window.size, panels=overlay, scale=window.text_scale).picture
            camera = camera or scene.camera_for(area.width / max(area.height, 1))
            meter_exposure(device, pictures.binder, camera)
            camera_control = CameraControl(camera, extent_of(scene))
            super().__init__(
                window,
                pictures,
                camera_control,
                scale_control,
                sources,
                source=source,
                source_options=source_options,
                folder=Path(folder),
            )
            self.refinement.enabled = scale_control.auto
            if beside is not None:
                self.beside = SecondScene(device, beside, pictures, beside_name or beside.name or "second")
                undo.callback(self.beside.close)
            self.controls = Controls(self.camera_control, self.act, lambda: self.layout.picture, lambda: self.gesture)
            self._renderer = ProgressiveRenderer(self, self._show_panels)
            undo.callback(self._renderer.close)
            self.overlay = self._open_overlay() if overlay else None
            if self.overlay is not None:
                undo.callback(self.overlay.close)
            self._closers = undo.pop_all()
        if source and not source.startswith("builtin:"):
            add_recent(Path(source).absolute())
        self.frame_count = 0
        self._wants_screenshot = False
        self._last_frame_at = time.perf_counter()
        self._panels_at = self._last_frame_at  # when they were shown last while a frame was rendered
        self._seen_at = -math.inf  # when the distance of what is seen was read last
        self._timed_mode = mode

    def add_stage(self, stage: AnyStage, *, after: str) -> None:
        """Add a stage of your own to realtime frames, as `Renderer.add_stage` does: its outputs are among the views,
        and its shaders are compiled anew when they change."""
        self.pictures.add_stage(stage, after)
        made = stage(self.window.pixels) if callable(stage) else stage
        self.sources.watch(folders(made.glsl_root))

    def remove_stage(self, name: str) -> None:
        """Remove a stage of your own. Raises SolariError for any other name."""
        self.pictures.remove_stage(name)

    def _open_overlay(self) -> Any:
        try:
            from solari_vk.studio.viewer.overlay import Overlay
        except ImportError:
            self.say("there are no panels, because imgui-bundle is not installed: ? lists the keys")
            return None
        overlay = Overlay(self, self._presenter.device)
        self.has_panels = self.shows_panels = True
        self.shader_users["panels"] = overlay.reload
        return overlay

    def act(self, name: str, argument: Any = None) -> Any:
        """Do one of the actions: a method of actions.Actions. A user's mistake is shown in the window.

        A screenshot waits for a picture of the scene as it is now."""
        self.cursor = self.controls.cursor
        if name == "screenshot" and self.pictures.ready and not self._is_current():
            self._wants_screenshot = True
            return None
        return act(self, name, argument)

    def _is_current(self) -> bool:
        return self._renderer.is_current((self.picture_area.width, self.picture_area.height))

    # ---- running ------------------------------------------------------------------------------------

    def run(self, on_frame: Callable[[Viewer, float], None] | None = None, frames: int | None = None) -> None:
        """Call `step` until the window is closed, or `frames` times."""
        for _ in itertools.count() if frames is None else range(frames):
            if self.window.wants_to_close:
                break
            self.step(on_frame)

    def step(self, on_frame: Callable[[Viewer, float], None] | None = None) -> bool:
        """Handle input, render a frame and show it. Returns False if nothing was shown, as in a minimized window."""
        seconds = self._handle_input()
        self.reload_changed()
        if on_frame is not None:
            on_frame(self, seconds)
        if 0 in self.window.pixels or self.window.wants_to_close:
            return False
        if self.overlay is not None:
            self.overlay.lay_out(seconds)
        else:
            self.history.end_gesture()  # without panels nothing is dragged
        # The panels decide how large the picture is, so it is rendered after them.
        self._presenter.area = self.picture_area
        self._render_or_wait((self.picture_area.width, self.picture_area.height))
        if self._wants_screenshot and ("picture" in self.faults or self._is_current()):
            self._wants_screenshot = False
            act(self, "screenshot")
        shown = self._presenter.show(self._renderer.parts(), self._draw)
        self.frame_count += 1
        self._record_times(seconds, time.perf_counter() - self._last_frame_at)
        self._show_title()
        return shown

    def _handle_input(self) -> float:
        """Handle events, and move camera and animation; returns the seconds since the last frame."""
        wait = 0.0
        if 0 in self.window.pixels:
            wait = HIDDEN_WAIT
        elif self.refinement.finished:
            wait = IDLE_WAIT
        events = self.window.poll_events(wait)
        if self.overlay is None:
            self.controls.handle(events)
        else:
            self._share_events(self.overlay, events)
        self.cursor = self.controls.cursor
        now = time.perf_counter()
        seconds = now - self._last_frame_at
        self._last_frame_at = now
        self._fly(seconds, now)
        with self.showing_mistakes():
            self.player.advance(min(seconds, MAX_STEP))
        return seconds

    def _share_events(self, overlay: Any, events: list[Event]) -> None:
        """Pass events to the panels, and what these leave to the controls."""
        for number, part in enumerate(in_parts(events)):
            if number:
                # Once for what the cursor is over, and once for what ImGui says only of its last frame.
                overlay.lay_out(0.0)
                overlay.lay_out(0.0)
            # What is going on takes keys and buttons; the panels only see what ends, and where the cursor is.
            shown = part if self.gesture is None else [event for event in part if _is_seen_by_all(event)]
            keys, mouse = overlay.handle_events(shown)
            is_going_on = self.gesture is not None
            self.controls.handle(part, takes_keys=keys or is_going_on, takes_mouse=mouse or is_going_on)

    def _show_panels(self) -> None:
        """While a slow frame is rendered: the panels follow the cursor, over the latest picture."""
        now = time.perf_counter()
        if self.overlay is None or now - self._panels_at < PANELS_WAIT:
            return
        self._panels_at = now
        # The next frame handles all events that wait, these movements too.
        self.overlay.handle_events([event for event in self.window.events if event.kind == "cursor"])
        self.is_rendering = True
        try:
            self.overlay.lay_out(PANELS_WAIT)
        finally:
            self.is_rendering = False
        self._presenter.show_again(self._draw)

    def _render_or_wait(self, pixels: tuple[int, int]) -> None:
        """Render the pictures; while the first one is compiled, the window shows what takes so long."""
        if self.pictures.ready or self.refinement.rests or "picture" in self.faults:
            self._render(pixels)
            return
        self._show_wait(f"preparing the {self.pictures.mode} renderer ...")
        with CompilePreview(self.pictures, self._show_wait, lambda: self._preview(pixels)):
            self._render(pixels)

    def _fly(self, seconds: float, now: float) -> None:
        """Move the camera, at a speed that follows the distance to what the latest picture shows."""
        control = self.camera_control
        if self.pictures.ready and (self._seen_at == -math.inf or (control.flies and now - self._seen_at > SEEING)):
            self._seen_at = now
            with self.showing_mistakes():
                control.see(seen_distance(self.pictures))
        control.advance(min(seconds, MAX_STEP))

    def capture(self) -> NDArray[np.uint8]:
        """The window's pixels with the panels, (height, width, 3). Raises SolariError when they can't be read."""
        if self.window.closed:
            raise SolariError("the window is closed")
        pixels = self._presenter.capture(self._renderer.parts(), self._draw)
        if pixels is None:
            raise SolariError("the window shows no frame that can be read")
        return pixels

    def _render(self, pixels: tuple[int, int]) -> None:
        """Render the pictures. An error in the scene or in a shader is shown, and the last picture stays."""
        try:
            self._renderer.render(pixels)
            if not self.pictures.refuses:
                self.clear_fault("picture")
        except ValidationError:
            raise
        except SolariError as error:
            if self.device.lost:
                raise
            self.report("picture", error)

    def _draw(self, commands: raw.CData, index: int) -> None:
        """Record the drawing of the panels over an image of the swapchain."""
        if self.overlay is not None:
            with self.showing_mistakes("panels"):
                self.overlay.draw(commands, self._swapchain, index)

    def _preview(self, pixels: tuple[int, int]) -> None:
        self.pictures.preview(self.camera, pixels, self.scale.scale)

    def _show_wait(self, text: str) -> None:
        """Tell the user why the first picture takes long."""
        self._set_title(text)
        if self.overlay is not None:
            # The text stands in the place of messages for this frame only.
            message = self.message
            self.message = message or text
            self.overlay.lay_out(0.0)
            self.message = message
        self._presenter.area = self.picture_area
        self._presenter.show(self.pictures.parts(), self._draw)

    def _record_times(self, since_last: float, seconds: float) -> None:
        # The first frames compile.
        if self.frame_count > 1:
            self.spans.append(since_last)
        self.timings = self.pictures.timings
        if self._timed_mode != self.pictures.mode:
            self._timed_mode = self.pictures.mode
            self.scale.forget_times()
        # GPU time if the device has timestamps: the seconds of a frame also have the wait for the display.
        if self.pictures.is_short and not self.refinement.rests:
            self.scale.record_frame(sum(self.timings.values()) / 1000 or seconds)

    def _show_title(self) -> None:
        self.end_message()
        self._set_title(self.message.partition("\n")[0] or state_in_words(self))

    def _set_title(self, text: str) -> None:
        self.window.set_title(" - ".join(part for part in (self.name, "solari_vk", text) if part))

    # ---- lifetime -----------------------------------------------------------------------------------

    def close(self) -> None:
        """Close the window and free everything. Safe to call twice."""
        self._closers.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _device_for_window(device: Device, undo: ExitStack) -> Device:
    """The device that draws the window: on a processor another one than that of the pictures, since work of one device
    is done in order, and a single pass of a picture may take seconds."""
    if device.properties.kind != "cpu":
        return device
    return undo.enter_context(Device(device.properties.uuid, validation=device.validation, on_compile=None))


def _is_seen_by_all(event: Event) -> bool:
    """Whether an event begins nothing."""
    return event.kind in ("cursor", "focus") or (event.kind in ("key", "button") and not event.pressed)
