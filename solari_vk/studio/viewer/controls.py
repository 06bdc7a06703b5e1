"""Maps keys and mouse to actions and camera movements. Needs no window."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import glfw

from solari_vk.studio.viewer.camera_control import CameraControl
from solari_vk.studio.viewer.gestures import CLICK
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.session import Gesture
from solari_vk.studio.viewer.window import Event

SHIFT = glfw.MOD_SHIFT
CONTROL = glfw.MOD_CONTROL
ALT = glfw.MOD_ALT

FLY_KEYS = {
    glfw.KEY_W: "forward",
    glfw.KEY_S: "back",
    glfw.KEY_A: "left",
    glfw.KEY_D: "right",
    glfw.KEY_E: "up",
    glfw.KEY_Q: "down",
}
# (key, modifiers) -> the name of the action. Shift counts only for keys that are listed with it.
ACTIONS = {
    (glfw.KEY_F, 0): "focus",
    (glfw.KEY_HOME, 0): "focus_all",
    (glfw.KEY_0, 0): "reset",
    (glfw.KEY_C, CONTROL): "copy_pose",
    (glfw.KEY_V, CONTROL): "paste_pose",
    (glfw.KEY_Z, CONTROL): "undo",
    (glfw.KEY_Z, CONTROL | SHIFT): "redo",
    (glfw.KEY_Y, CONTROL): "redo",
    (glfw.KEY_S, CONTROL): "save",
    (glfw.KEY_G, 0): "move_picked",
    (glfw.KEY_R, 0): "turn_picked",
    (glfw.KEY_B, 0): "box",
    (glfw.KEY_A, CONTROL): "pick_all",
    (glfw.KEY_G, SHIFT): "next_gizmo",
    (glfw.KEY_L, 0): "turn_gizmo",
    (glfw.KEY_LEFT, 0): "nudge_left",
    (glfw.KEY_RIGHT, 0): "nudge_right",
    (glfw.KEY_UP, 0): "nudge_away",
    (glfw.KEY_DOWN, 0): "nudge_nearer",
    (glfw.KEY_PAGE_UP, 0): "nudge_up",
    (glfw.KEY_PAGE_DOWN, 0): "nudge_down",
    (glfw.KEY_H, 0): "hide",
    (glfw.KEY_H, ALT): "show_all",
    (glfw.KEY_DELETE, 0): "remove",
    (glfw.KEY_X, 0): "remove",
    (glfw.KEY_M, 0): "next_mode",
    (glfw.KEY_V, 0): "next_view",
    (glfw.KEY_V, SHIFT): "previous_view",
    (glfw.KEY_COMMA, 0): "move_divider_left",
    (glfw.KEY_PERIOD, 0): "move_divider_right",
    (glfw.KEY_T, 0): "next_tonemap",
    (glfw.KEY_EQUAL, 0): "brighter",
    (glfw.KEY_KP_ADD, 0): "brighter",
    (glfw.KEY_MINUS, 0): "darker",
    (glfw.KEY_KP_SUBTRACT, 0): "darker",
    (glfw.KEY_SPACE, 0): "play",
    (glfw.KEY_N, 0): "next_clip",
    (glfw.KEY_F1, 0): "help",
    (glfw.KEY_TAB, 0): "panels",
    (glfw.KEY_F2, 0): "screenshot",
    (glfw.KEY_F5, 0): "reload",
    (glfw.KEY_F11, 0): "fullscreen",
    (glfw.KEY_ESCAPE, 0): "close",
    (glfw.KEY_Q, CONTROL): "close_window",
}
# The number pad's keys, with their actions' arguments; on the other digits with Alt.
NUMBER_PAD: dict[tuple[int, int], tuple[str, Any]] = {
    (glfw.KEY_KP_1, 0): ("look_from", "front"),
    (glfw.KEY_KP_1, CONTROL): ("look_from", "back"),
    (glfw.KEY_KP_3, 0): ("look_from", "right"),
    (glfw.KEY_KP_3, CONTROL): ("look_from", "left"),
    (glfw.KEY_KP_7, 0): ("look_from", "top"),
    (glfw.KEY_KP_7, CONTROL): ("look_from", "bottom"),
    (glfw.KEY_KP_4, 0): ("orbit", (-1, 0)),
    (glfw.KEY_KP_6, 0): ("orbit", (1, 0)),
    (glfw.KEY_KP_2, 0): ("orbit", (0, -1)),
    (glfw.KEY_KP_8, 0): ("orbit", (0, 1)),
    (glfw.KEY_KP_5, 0): ("orthographic", None),
    (glfw.KEY_KP_DECIMAL, 0): ("focus", None),
    (glfw.KEY_KP_0, 0): ("reset", None),
}
# Keys that fly, unless something is picked and nothing flies; their actions return whether something was picked.
PICKED_ACTIONS = {(glfw.KEY_S, 0): "scale_picked", (glfw.KEY_D, SHIFT): "duplicate"}
# Keys that fly fast during a flight.
RESTING_ACTIONS = {(glfw.KEY_A, SHIFT): "add_menu"}
TEXT_ACTIONS = {"?": "help"}  # by the character, which is on another key on each keyboard
REPEATING = {
    "move_divider_left",
    "move_divider_right",
    "brighter",
    "darker",
    "next_view",
    "previous_view",
    "undo",
    "redo",
    "orbit",
    *(name for name in ACTIONS.values() if name.startswith("nudge")),
}
KEYS_HELP = (
    ("wheel", "zoom to what is under the cursor"),
    (
        "left button",
        "drag: orbit around what is under the cursor; click: pick, with Shift several; Ctrl and drag: a box",
    ),
    ("middle button", "drag: pan"),
    ("right button", "drag: look around; wheel meanwhile: speed"),
    ("Shift", "fly: the wheel flies past what is seen, dragging with the left button looks around"),
    ("W A S D, Q E", "fly, the slower the nearer something is; down and up. Shift: four times as fast; wheel: speed"),
    ("F, Home", "frame what is picked, or all; all"),
    ("0, 1 to 9", "back to the first camera; the scene's cameras"),
    ("number pad 1 3 7, or Alt+digit", "view from the front, the right, the top; with Ctrl from the other side"),
    ("number pad 5 . 0, 4 6 2 8", "orthographic, frame, first camera; orbit by steps. Also Alt+5, Alt+0, Alt+4 ..."),
    ("Ctrl+Z, Ctrl+Shift+Z", "undo and redo"),
    ("G, R, S", "grab (move), rotate, scale what is picked with the cursor; S flies while nothing is picked"),
    ("meanwhile X Y Z, Shift+X ...", "along an axis, again: the object's own; along the other two"),
    (
        "meanwhile 0 to 9 . -",
        "how far, in meters, degrees or as a factor; Tab: the next axis. Ctrl: steps, Shift: precise",
    ),
    ("Enter or click, Esc or right button", "keep it, cancel it"),
    ("Shift+D", "duplicate what is picked, and grab the copies"),
    ("B, Ctrl+A", "pick by a box that you drag, pick all"),
    ("Shift+A", "add a shape, a light or a camera"),
    ("Shift+G, L", "handles that move, turn or scale; along the world's axes or its own"),
    ("arrows, Page Up and Down", "nudge what is picked"),
    ("H, Alt+H", "hide what is picked; show all"),
    ("Delete, X", "remove what is picked"),
    ("Ctrl+S", "save as glTF, with a script that renders the picture"),
    ("Ctrl+C, Ctrl+V", "copy and paste the pose, as JSON that `render --camera` takes"),
    ("M", "mode: realtime, reference, split"),
    (", and .", "move the divider"),
    ("V, Shift+V", "next and previous debug view of the realtime picture"),
    ("T", "next tone mapping"),
    ("Space, N", "play or pause the file's animation; its next clip"),
    ("+ and -", "brighter and darker by a third of a stop"),
    ("Tab, ?", "panels, this help"),
    ("F2", "screenshot: PNG, EXR and the command line that renders it again"),
    ("F5", "read shaders and the file again now"),
    ("F11", "fullscreen"),
    ("Esc, Ctrl+Q", "cancel what is going on, or ask to close; close"),
)


def in_parts(events: Iterable[Event]) -> list[list[Event]]:
    """The events of a frame in parts, after each of which the panels are to be laid out: who gets a press of a button
    depends on what the cursor is over by then, and who gets a key on what was pressed before."""
    parts: list[list[Event]] = [[]]
    kinds = set[str]()
    for event in events:
        follows_cursor = "cursor" in kinds and (event.kind == "scroll" or (event.kind == "button" and event.pressed))
        follows_button = "button" in kinds and event.kind in ("key", "text")
        if follows_cursor or follows_button:
            parts.append([])
            kinds.clear()
        parts[-1].append(event)
        kinds.add(event.kind)
    return parts


class Controls:
    """Turns events into movements of `camera` and into calls of `act(name, argument)`.

    Names and arguments: those of ACTIONS with None; "camera" with the camera's index; "pick" or, with
    Shift, "pick_also" with the cursor's (x, y) at a click; "grab" with (x, y) when a drag or a zoom begins; "drop" with
    the event. "grab" returns the point in world space that is there, or None for the background. area: returns where
    the picture is in the window. gesture: returns what is going on, which takes keys and buttons.
    """

    def __init__(
        self,
        camera: CameraControl,
        act: Callable[[str, Any], Any],
        area: Callable[[], Area],
        gesture: Callable[[], Gesture | None] = lambda: None,
    ) -> None:
        self.camera = camera
        self.act = act
        self.area = area
        self.gesture = gesture
        self.cursor = (0.0, 0.0)
        self._button: int | None = None
        self._pressed_at = (0.0, 0.0)
        self._dragging = False
        self._center: Any = None
        self._zoomed_at: tuple[float, float] | None = None

    def handle(self, events: Iterable[Event], *, takes_keys: bool = True, takes_mouse: bool = True) -> None:
        """Handle events. takes_keys, takes_mouse: False ignores key presses, and button presses and the wheel, which
        count over the picture only."""
        for event in events:
            gesture = self.gesture()
            if gesture is not None:
                self._hand_over(gesture, event)
                continue
            match event.kind:
                # A release always counts: its press may have come before the panels took the keyboard or the mouse.
                case "key" if takes_keys or not event.pressed:
                    self._key(event)
                case "button" if not event.pressed or (takes_mouse and self._is_over_picture):
                    self._press(event)
                case "text" if takes_keys and chr(event.code) in TEXT_ACTIONS:
                    self.act(TEXT_ACTIONS[chr(event.code)], None)
                case "cursor":
                    self._move((event.x, event.y))
                case "scroll" if takes_mouse and self._is_over_picture:
                    self._scroll(event.y)
                case "focus" if not event.pressed:
                    self.release()
                case "drop":
                    self.act("drop", event)
                case "close":
                    self.act("close_window", None)

    def _hand_over(self, gesture: Gesture, event: Event) -> None:
        """Let a gesture have an event; but what was pressed before it began ends by its release."""
        match event.kind:
            case "cursor":
                self.cursor = event.x, event.y
            case "key" if not event.pressed:
                self._key(event)
            case "button" if not event.pressed and event.code == self._button:
                self._button = None
            case "focus" if not event.pressed:
                self.release()
            case "drop" | "close":
                gesture.cancel()
                self.handle([event])
                return
        gesture.handle(event)

    @property
    def _is_over_picture(self) -> bool:
        return self.area().holds(self.cursor)

    def release(self) -> None:
        """Release all keys and buttons, because a window without the focus gets no events of their release."""
        self.camera.pressed.clear()
        self.camera.fast = False
        self._button = None

    def _key(self, event: Event) -> None:
        modifiers = event.modifiers & (CONTROL | SHIFT | ALT)
        if event.code in (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT):
            self.camera.fast = event.pressed
        elif event.code in FLY_KEYS and not event.pressed:
            self.camera.pressed.discard(FLY_KEYS[event.code])
        elif event.pressed and self._acts_on_picked(event, modifiers):
            pass
        elif event.code in FLY_KEYS and not modifiers & (CONTROL | ALT):
            self.camera.pressed.add(FLY_KEYS[event.code])
        elif event.pressed:
            self._act_by_key(event, modifiers)

    def _acts_on_picked(self, event: Event, modifiers: int) -> bool:
        """Do what a key that flies does while nothing flies; returns whether it does something."""
        if event.repeats or self.camera.pressed or self._button == glfw.MOUSE_BUTTON_RIGHT:
            return False
        key = event.code, modifiers
        if key in RESTING_ACTIONS:
            self.act(RESTING_ACTIONS[key], None)
            return True
        return key in PICKED_ACTIONS and bool(self.act(PICKED_ACTIONS[key], None))

    def _act_by_key(self, event: Event, modifiers: int) -> None:
        code = event.code
        if glfw.KEY_0 <= code <= glfw.KEY_9 and modifiers & ALT:
            code += glfw.KEY_KP_0 - glfw.KEY_0
            modifiers &= ~ALT
        if (code, modifiers) in NUMBER_PAD:
            name, argument = NUMBER_PAD[code, modifiers]
            if not event.repeats or name in REPEATING:
                self.act(name, argument)
            return
        if glfw.KEY_1 <= event.code <= glfw.KEY_9 and not modifiers & CONTROL and not event.repeats:
            self.act("camera", event.code - glfw.KEY_1)
            return
        # Shift only means something else where a key is listed with it.
        action = ACTIONS.get((event.code, modifiers)) or ACTIONS.get((event.code, modifiers & ~SHIFT))
        if action == "close" and self._button is not None:
            self._button = None  # Escape ends the drag, and no more
            return
        if action is not None and (not event.repeats or action in REPEATING):
            self.act(action, None)

    def _scroll(self, notches: float) -> None:
        if self.camera.pressed or self._button == glfw.MOUSE_BUTTON_RIGHT:
            self.camera.change_speed(notches)
        elif self.camera.fast:
            self.camera.dolly(notches)
        else:
            # The distance under the cursor needs the picture from the device: once for a row of notches.
            if self._zoomed_at != self.cursor:
                self._zoomed_at = self.cursor
                self._see(self.cursor)
            area = self.area()
            x, y = area.share(self.cursor)
            self.camera.zoom(notches, ((x - 0.5) * area.width / max(area.height, 1), y - 0.5))

    def _see(self, cursor: tuple[float, float]) -> Any:
        """What is at the cursor, which from now on is as far away as what zooms and pans are about."""
        point = self.act("grab", cursor)
        if point is not None:
            self.camera.see_point(point)
        return point

    def _press(self, event: Event) -> None:
        is_box = event.pressed and event.code == glfw.MOUSE_BUTTON_LEFT and event.modifiers & CONTROL
        if is_box and self._button is None:
            self.act("box", self.cursor)
            return
        # A second button that is pressed during a drag does nothing.
        if event.pressed and self._button is None:
            self._button = event.code
            self._pressed_at = self.cursor
            self._dragging = False
            self._center = None
        elif not event.pressed and event.code == self._button:
            self._button = None
            if not self._dragging and event.code == glfw.MOUSE_BUTTON_LEFT:
                self.act("pick_also" if self.camera.fast else "pick", self.cursor)

    def _move(self, to: tuple[float, float]) -> None:
        # The first movement of a drag counts from where the button was pressed, the others from the last place.
        right, down = to[0] - self.cursor[0], to[1] - self.cursor[1]
        self.cursor = to
        if self._button not in (glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_MIDDLE, glfw.MOUSE_BUTTON_RIGHT):
            return
        if not self._dragging:
            right, down = to[0] - self._pressed_at[0], to[1] - self._pressed_at[1]
            if max(abs(right), abs(down)) < CLICK:
                return
            self._dragging = True
            if self._button == glfw.MOUSE_BUTTON_MIDDLE:
                self._see(self._pressed_at)
            elif self._button == glfw.MOUSE_BUTTON_LEFT and not self.camera.fast:
                self._center = self.act("grab", self._pressed_at)
        if self._button == glfw.MOUSE_BUTTON_MIDDLE:
            height = max(self.area().height, 1)
            self.camera.pan(right / height, down / height)
        elif self._center is None:
            self.camera.look(right, down)
        else:
            self.camera.orbit(right, down, self._center)
