"""Maps keys and mouse to actions and camera movements. Needs no window."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import glfw

from solari_vk.viewer.camera_control import CameraControl
from solari_vk.viewer.window import Event

CLICK = 3.0  # a button that is released before the cursor moves this far is a click, not a drag

FLY_KEYS = {
    glfw.KEY_W: "forward",
    glfw.KEY_S: "back",
    glfw.KEY_A: "left",
    glfw.KEY_D: "right",
    glfw.KEY_E: "up",
    glfw.KEY_Q: "down",
}
# (key, whether Ctrl is held) -> the name of the action.
ACTIONS = {
    (glfw.KEY_F, False): "focus",
    (glfw.KEY_R, False): "reset",
    (glfw.KEY_C, True): "copy_pose",
    (glfw.KEY_V, True): "paste_pose",
    (glfw.KEY_M, False): "next_mode",
    (glfw.KEY_V, False): "next_view",
    (glfw.KEY_COMMA, False): "move_divider_left",
    (glfw.KEY_PERIOD, False): "move_divider_right",
    (glfw.KEY_T, False): "next_tonemap",
    (glfw.KEY_EQUAL, False): "brighter",
    (glfw.KEY_KP_ADD, False): "brighter",
    (glfw.KEY_MINUS, False): "darker",
    (glfw.KEY_KP_SUBTRACT, False): "darker",
    (glfw.KEY_SPACE, False): "play",
    (glfw.KEY_N, False): "next_clip",
    (glfw.KEY_H, False): "help",
    (glfw.KEY_TAB, False): "panels",
    (glfw.KEY_F2, False): "screenshot",
    (glfw.KEY_F5, False): "reload",
    (glfw.KEY_F11, False): "fullscreen",
    (glfw.KEY_ESCAPE, False): "close",
}
REPEATING = {"move_divider_left", "move_divider_right", "brighter", "darker", "next_view"}
KEYS_HELP = (
    ("W A S D, Q E", "fly, the slower the nearer something is; down and up. Shift: four times as fast; wheel: speed"),
    ("right button", "look around"),
    ("left button", "drag: orbit around the point under the cursor; click: pick"),
    ("F", "focus on what was picked, else on what was seen first"),
    ("1 to 9", "the scene's cameras"),
    ("R", "back to the first camera"),
    ("Ctrl+C, Ctrl+V", "copy and paste the pose, as JSON that `render --camera` takes"),
    ("M", "mode: realtime, reference, split"),
    (", and .", "move the divider of the split view"),
    ("V, Shift+V", "next and previous debug view"),
    ("T", "next tone mapping"),
    ("Space, N", "play or pause the file's animation; its next clip"),
    ("+ and -", "brighter and darker by a third of a stop"),
    ("Tab, H", "panels, this help"),
    ("F2", "screenshot: PNG, EXR and the command line that renders it again"),
    ("F5", "read shaders and the file again now"),
    ("F11, Esc", "fullscreen, close"),
)


class Controls:
    """Turns events into movements of `camera` and into calls of `act(name, argument)`.

    Names and arguments: those of ACTIONS with None; "camera" with the camera's index; "pick" with the cursor's (x, y)
    at a click; "grab" with (x, y) when a drag begins. "grab" returns the point in world space to orbit around, or None
    to look around instead.
    """

    def __init__(self, camera: CameraControl, act: Callable[[str, Any], Any]) -> None:
        self.camera = camera
        self.act = act
        self.cursor = (0.0, 0.0)
        self._button: int | None = None
        self._pressed_at = (0.0, 0.0)
        self._dragging = False
        self._center: Any = None

    def handle(self, events: Iterable[Event], *, takes_keys: bool = True, takes_mouse: bool = True) -> None:
        """Handle events. takes_keys, takes_mouse: False ignores key presses, and button presses and the wheel."""
        for event in events:
            if event.kind == "key" and (takes_keys or not event.pressed):
                self._key(event)
            elif event.kind == "button" and (takes_mouse or not event.pressed):
                self._press(event)
            elif event.kind == "cursor":
                self._move((event.x, event.y))
            elif event.kind == "scroll" and takes_mouse:
                self.camera.change_speed(event.y)
            elif event.kind == "focus" and not event.pressed:
                self.release()

    def release(self) -> None:
        """Release all keys and buttons, because a window without the focus gets no events of their release."""
        self.camera.held.clear()
        self.camera.fast = False
        self._button = None

    def _key(self, event: Event) -> None:
        control = bool(event.modifiers & glfw.MOD_CONTROL)
        if event.code in (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT):
            self.camera.fast = event.pressed
        elif event.code in FLY_KEYS and not (control and event.pressed):
            (self.camera.held.add if event.pressed else self.camera.held.discard)(FLY_KEYS[event.code])
        elif not event.pressed:
            return
        elif glfw.KEY_1 <= event.code <= glfw.KEY_9 and not control and not event.repeats:
            self.act("camera", event.code - glfw.KEY_1)
        else:
            action = ACTIONS.get((event.code, control))
            if action == "next_view" and event.modifiers & glfw.MOD_SHIFT:
                action = "previous_view"
            if action is not None and (not event.repeats or action in {*REPEATING, "previous_view"}):
                self.act(action, None)

    def _press(self, event: Event) -> None:
        if event.pressed and self._button is None:
            self._button, self._pressed_at, self._dragging, self._center = event.code, self.cursor, False, None
        elif not event.pressed and event.code == self._button:
            self._button = None
            if not self._dragging and event.code == glfw.MOUSE_BUTTON_LEFT:
                self.act("pick", self.cursor)

    def _move(self, to: tuple[float, float]) -> None:
        right, down = to[0] - self.cursor[0], to[1] - self.cursor[1]
        self.cursor = to
        if self._button not in (glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_RIGHT):
            return
        if not self._dragging:
            right, down = to[0] - self._pressed_at[0], to[1] - self._pressed_at[1]
            if max(abs(right), abs(down)) < CLICK:
                return
            self._dragging = True
            if self._button == glfw.MOUSE_BUTTON_LEFT:
                self._center = self.act("grab", self._pressed_at)
        if self._center is None:
            self.camera.look(right, down)
        else:
            self.camera.orbit(right, down, self._center)
