"""A GLFW window: its events in order, its surface, the clipboard and fullscreen."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any

import glfw

from solari_vk.base.errors import DeviceError, SolariError, quoted
from solari_vk.gpu.device import raw

_NONE: Any = None  # for "no window" and "no monitor", which GLFW's type hints don't allow
_windows = 0  # number of open windows of the process; closing the last one ends GLFW


def why_none_opens() -> str:
    """Why no window can be opened here; empty where one can."""
    errors: list[str] = []
    glfw.set_error_callback(lambda _, description: errors.append(_text(description)))
    if not glfw.init():
        return errors[-1] if errors else "GLFW does not start"
    if _windows == 0:
        glfw.terminate()
    return ""


@dataclass(frozen=True)
class Event:
    """kind: "key" and "button" (code, pressed, modifiers; `repeats` for a key that is held), "cursor" (x, y in window
    coordinates), "scroll" (x, y), "text" (code: a character), "focus" (pressed: whether the window gained it), "drop"
    (paths of files; code: the modifiers that are held) or "close", when the user closes the window."""

    kind: str
    code: int = 0
    pressed: bool = False
    modifiers: int = 0
    x: float = 0.0
    y: float = 0.0
    repeats: bool = False
    paths: tuple[str, ...] = ()


class Window:
    """A window. Its size is in window coordinates, which on some systems are not pixels. `close` destroys it.

    Raises SolariError where windows can't be opened. A closed window has no pixels and wants to close; everything else
    raises SolariError once it is closed.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        global _windows
        self.events: list[Event] = []
        self.title = title
        self._handle: Any = None
        width, height = _checked_size(size)
        self._error: str = ""
        self._before_fullscreen: tuple[int, int, int, int] | None = None
        glfw.set_error_callback(self._store_error)
        if not glfw.init():
            raise SolariError(f"no window can be opened: {self._error or 'GLFW does not start'}")
        _windows += 1
        glfw.default_window_hints()
        glfw.window_hint(glfw.CLIENT_API, glfw.NO_API)  # without an OpenGL context, which Vulkan's surfaces refuse
        glfw.window_hint(glfw.SCALE_TO_MONITOR, False)  # the size is the user's; `text_scale` enlarges the panels
        self._handle = glfw.create_window(width, height, title, None, None)
        if not self._handle:
            error = self._error
            self._release()
            raise SolariError(f"no window can be opened: {error}")
        self._listen()

    def _store_error(self, _: int, description: Any) -> None:
        self._error = _text(description)

    def _listen(self) -> None:
        # GLFW's callbacks run inside its poll_events. They only store events, which the viewer then handles in order.
        def key(_: Any, code: int, __: int, action: int, modifiers: int) -> None:
            self.events.append(Event("key", code, action != glfw.RELEASE, modifiers, repeats=action == glfw.REPEAT))

        def button(_: Any, code: int, action: int, modifiers: int) -> None:
            self.events.append(Event("button", code, action == glfw.PRESS, modifiers))

        def drop(_: Any, paths: list[Any]) -> None:
            self.events.append(Event("drop", self._held_modifiers(), paths=tuple(map(_text, paths))))

        take_drops: Any = glfw.set_drop_callback  # whose type hints name C's arguments

        glfw.set_key_callback(self.handle, key)
        glfw.set_mouse_button_callback(self.handle, button)
        glfw.set_cursor_pos_callback(self.handle, lambda _, x, y: self.events.append(Event("cursor", x=x, y=y)))
        glfw.set_scroll_callback(self.handle, lambda _, x, y: self.events.append(Event("scroll", x=x, y=y)))
        glfw.set_char_callback(self.handle, lambda _, code: self.events.append(Event("text", code)))
        glfw.set_window_close_callback(self.handle, self._ask_to_close)
        take_drops(self.handle, drop)
        glfw.set_window_focus_callback(self.handle, lambda _, on: self.events.append(Event("focus", pressed=bool(on))))

    def _ask_to_close(self, _: Any) -> None:
        """The viewer closes the window itself, once it has asked what to do with edits."""
        glfw.set_window_should_close(self.handle, False)
        self.events.append(Event("close"))

    def _held_modifiers(self) -> int:
        # GLFW's callback for drops tells no modifiers.
        keys = {
            glfw.MOD_SHIFT: (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT),
            glfw.MOD_CONTROL: (glfw.KEY_LEFT_CONTROL, glfw.KEY_RIGHT_CONTROL),
        }
        return sum(bit for bit, codes in keys.items() if any(glfw.get_key(self.handle, code) for code in codes))

    def create_surface(self, instance: raw.CData) -> raw.CData:
        """A new VkSurfaceKHR. Raises DeviceError when the instance or the platform has no surfaces for windows."""
        out = raw.ffi.new("VkSurfaceKHR*")
        # GLFW's errors are in its callback; the result is a VkResult.
        result = glfw.create_window_surface(instance, self.handle, None, out)
        if result < 0:
            raise DeviceError(f"Vulkan can't draw in this window: {self._error or f'VkResult {result}'}")
        return out[0]

    # ---- state --------------------------------------------------------------------------------------

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._handle

    @property
    def handle(self) -> Any:
        """GLFW's window. Raises SolariError for a closed one, for which GLFW would end the process."""
        self._check_open()
        return self._handle

    def _check_open(self) -> None:
        if self.closed:
            raise SolariError("the window is closed")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in window coordinates, which are the cursor's too."""
        width, height = glfw.get_window_size(self.handle)
        return width, height

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in pixels; (0, 0) while the window is minimized."""
        if self.closed or glfw.get_window_attrib(self.handle, glfw.ICONIFIED):
            return (0, 0)
        width, height = glfw.get_framebuffer_size(self.handle)
        return width, height

    @property
    def text_scale(self) -> float:
        """How much larger texts are than on a screen of 96 dots per inch, in window coordinates: where those aren't
        pixels, the system enlarges the window itself."""
        if self.closed or 0 in self.pixels:
            return 1.0
        # On macOS and Wayland window coordinates are enlarged already; on X11 and Windows they are pixels.
        scale, _ = glfw.get_window_content_scale(self.handle)
        return float(min(max(scale * self.size[0] / self.pixels[0], 1.0), 4.0))

    @property
    def wants_to_close(self) -> bool:
        """Whether the user, or an assignment of True, asks to close the window. Assigning False withdraws that."""
        return self.closed or bool(glfw.window_should_close(self.handle))

    @wants_to_close.setter
    def wants_to_close(self, value: bool) -> None:
        glfw.set_window_should_close(self.handle, value)

    @property
    def clipboard(self) -> str:
        """The text in the clipboard, "" without one."""
        self._check_open()
        return _text(glfw.get_clipboard_string(_NONE) or "")

    @clipboard.setter
    def clipboard(self, text: str) -> None:
        self._check_open()
        glfw.set_clipboard_string(_NONE, text)

    def set_title(self, title: str) -> None:
        """Set the title."""
        self.title = title
        glfw.set_window_title(self.handle, title)

    def has_input(self) -> bool:
        """Whether the user did something since `poll_events` that a picture must not keep waiting: all but moving the
        mouse without a button."""
        # Without its events for some seconds, window managers take a window for hung.
        glfw.poll_events()
        drags = any(glfw.get_mouse_button(self.handle, button) == glfw.PRESS for button in range(3))
        return any(event.kind != "cursor" or drags for event in self.events)

    def poll_events(self, wait: float = 0.0) -> list[Event]:
        """The events since the last call. Waits up to `wait` seconds for the first one."""
        self._check_open()
        if wait:
            glfw.wait_events_timeout(wait)
        else:
            glfw.poll_events()
        events, self.events = self.events, []
        return events

    def toggle_fullscreen(self) -> None:
        """Switch between the window and the whole monitor that shows the largest part of it."""
        if self._before_fullscreen is not None:
            x, y, width, height = self._before_fullscreen
            self._before_fullscreen = None
            glfw.set_window_monitor(self.handle, _NONE, x, y, width, height, glfw.DONT_CARE)
            return
        x, y = glfw.get_window_pos(self.handle)
        width, height = self.size

        def shared_area(monitor: Any) -> int:
            left, top = glfw.get_monitor_pos(monitor)
            mode = glfw.get_video_mode(monitor).size
            across = min(x + width, left + mode.width) - max(x, left)
            down = min(y + height, top + mode.height) - max(y, top)
            return max(across, 0) * max(down, 0)

        monitors = glfw.get_monitors()
        if monitors:
            monitor = max(monitors, key=shared_area)
            mode = glfw.get_video_mode(monitor)
            self._before_fullscreen = (x, y, width, height)
            glfw.set_window_monitor(self.handle, monitor, 0, 0, mode.size.width, mode.size.height, mode.refresh_rate)

    # ---- lifetime -----------------------------------------------------------------------------------

    def _release(self) -> None:
        global _windows
        _windows -= 1
        if _windows == 0:
            glfw.terminate()

    def close(self) -> None:
        """Destroy the window. Safe to call twice."""
        if not self.closed:
            glfw.destroy_window(self.handle)
            self._handle = None
            self._release()


def _checked_size(size: tuple[int, int]) -> tuple[int, int]:
    """A window's size as two ints. Raises SolariError for anything else."""
    try:
        width, height = (operator.index(side) for side in size)
    except (TypeError, ValueError):
        width = height = 0
    if not (1 <= width < 2**15 and 1 <= height < 2**15):
        raise SolariError(f"a window's size is two whole numbers from 1 to {2**15 - 1}, not {quoted(size)}")
    return width, height


def _text(value: Any) -> str:
    """A text from GLFW, which gives bytes although its type hints say otherwise."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
