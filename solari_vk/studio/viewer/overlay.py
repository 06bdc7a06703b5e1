"""The panels beside the picture: Dear ImGui's context, its input and the windows of a frame."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import glfw
from imgui_bundle import imgui

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.controls import KEYS_HELP
from solari_vk.studio.viewer.decorations import BARE, Decorations
from solari_vk.studio.viewer.gizmo import Gizmo, gizmo
from solari_vk.studio.viewer.layout import Area, Layout
from solari_vk.studio.viewer.overlay_renderer import OverlayRenderer
from solari_vk.studio.viewer.panels import Panels
from solari_vk.studio.viewer.session import Question, Session
from solari_vk.studio.viewer.status import Probe, status_line
from solari_vk.studio.viewer.swapchain import Swapchain
from solari_vk.studio.viewer.theme import apply_theme, scale_theme
from solari_vk.studio.viewer.window import Event

MOUSE_BUTTONS = 5  # that ImGui knows
MARGIN = 8  # of the message, in window coordinates
DOCKED = (
    imgui.WindowFlags_.no_title_bar
    | imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_collapse
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)


def _glfw_name(name: str) -> str:
    """GLFW's name of a key of ImGui. They differ in these two points, and for keys that text fields don't use."""
    return "KEY_" + name.removesuffix("_arrow").replace("keypad", "kp").upper()


_KEYS = {
    getattr(glfw, _glfw_name(name)): key
    for name, key in imgui.Key.__members__.items()
    if hasattr(glfw, _glfw_name(name))
}
_MODIFIERS = {
    getattr(glfw, f"MOD_{name}"): getattr(imgui.Key, f"mod_{short}")
    for name, short in (("CONTROL", "ctrl"), ("SHIFT", "shift"), ("ALT", "alt"))
}


class Overlay:
    """The panels of a viewer, drawn by a device. For each frame call `handle_events`, `lay_out`, and `draw` any number
    of times."""

    def __init__(self, session: Session, device: Device) -> None:
        self._session = session
        self._context: Any = imgui.create_context()
        imgui.set_current_context(self._context)
        io = imgui.get_io()
        io.set_ini_filename("")  # ImGui would write imgui.ini into the user's folder
        apply_theme()
        self._scale = 1.0
        self._renderer = OverlayRenderer(device)
        self._decorations = Decorations(session, self._renderer)
        self._gizmo = Gizmo(session)
        self._panels = Panels(session, self._renderer.show)
        self._probe = Probe(session)
        self._laid_out = False
        platform = imgui.get_platform_io()
        platform.platform_get_clipboard_text_fn = lambda _: session.window.clipboard
        platform.platform_set_clipboard_text_fn = lambda _, text: setattr(session.window, "clipboard", text)

    # ---- input --------------------------------------------------------------------------------------

    def handle_events(self, events: Iterable[Event]) -> tuple[bool, bool]:
        """Pass events to the panels; returns whether the keys and whether the mouse are left to the viewer."""
        # ImGui has one current context for the process, and two viewers have one each: every entry sets its own.
        imgui.set_current_context(self._context)
        io = imgui.get_io()
        has_menu = self.has_menu  # before Escape closes it
        for event in events:
            match event.kind:
                case "cursor":
                    io.add_mouse_pos_event(event.x, event.y)
                case "button" if event.code < MOUSE_BUTTONS:
                    io.add_mouse_button_event(event.code, event.pressed)
                case "scroll":
                    io.add_mouse_wheel_event(event.x, event.y)
                case "text":
                    io.add_input_character(event.code)
                case "focus":
                    io.add_focus_event(event.pressed)
                case "key":
                    self._handle_key(io, event)
        # These flags are those of the latest frame that was laid out. ImGuizmo isn't a window, so ImGui doesn't know
        # that it wants the mouse.
        # While something is dragged or a menu is open, Escape isn't meant for the window.
        drags = imgui.is_any_item_active() or self._gizmo.drags or has_menu
        return not (io.want_text_input or drags), not (io.want_capture_mouse or self._gizmo.busy)

    @property
    def has_menu(self) -> bool:
        """Whether a menu is open."""
        imgui.set_current_context(self._context)
        return bool(imgui.is_popup_open("", imgui.PopupFlags_.any_popup))

    def _handle_key(self, io: Any, event: Event) -> None:
        for bit, key in _MODIFIERS.items():
            io.add_key_event(key, bool(event.modifiers & bit))
        if event.code == glfw.KEY_ESCAPE and event.pressed:
            imgui.internal.close_popups_except_modals()
        if event.code in _KEYS:
            io.add_key_event(_KEYS[event.code], event.pressed)

    # ---- a frame ------------------------------------------------------------------------------------

    def lay_out(self, seconds: float) -> None:
        """Lay out the panels for the window's size, and apply what the user changes in them."""
        imgui.set_current_context(self._context)
        session = self._session
        io = imgui.get_io()
        size = session.window.size
        pixels = session.window.pixels
        io.display_size = imgui.ImVec2(*size)
        io.display_framebuffer_scale = imgui.ImVec2(pixels[0] / max(size[0], 1), pixels[1] / max(size[1], 1))
        io.delta_time = max(seconds, 1e-4)  # ImGui refuses 0
        scale = session.window.text_scale
        scale_theme(scale / self._scale, scale)
        self._scale = scale
        imgui.new_frame()
        gizmo.begin_frame()
        try:
            self._decorations.lay_out()
            if session.shows_panels:
                self._gizmo.lay_out()
                self._docked(session.layout)
            if session.shows_help:
                self._help()
            if session.question is not None:
                self._ask(session.question)
            if session.message:
                self._message()
            if not (imgui.is_any_item_active() or self._gizmo.drags):
                session.history.end_gesture()
        finally:
            imgui.end_frame()  # also after an error: ImGui allows no new_frame before the last one is ended
        imgui.render()
        self._laid_out = True

    def draw(self, commands: raw.CData, swapchain: Swapchain, index: int) -> None:
        """Record commands that draw the panels over an image of the swapchain.

        Raises CompilationError for an error in a shader, and then records nothing until `reload` is called.
        """
        imgui.set_current_context(self._context)
        # ImGui has nothing to draw before its first frame.
        if not self._laid_out:
            self.lay_out(0.0)
        self._renderer.draw(imgui.get_draw_data(), commands, swapchain, index)

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipeline then stays in use."""
        self._renderer.reload()

    # ---- parts --------------------------------------------------------------------------------------

    def _docked(self, layout: Layout) -> None:
        """The panels beside the picture, and the status line below."""
        session = self._session
        if layout.panels is not None:
            _place(layout.panels)
            imgui.begin("panels", None, DOCKED)
            self._panels.lay_out()
            imgui.end()
        if layout.status is not None:
            _place(layout.status)
            imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(8, 4))
            imgui.begin("status", None, DOCKED | imgui.WindowFlags_.no_scrollbar)
            if session.refinement.rests and not session.refinement.finished:
                width = 8 * imgui.get_font_size()
                imgui.progress_bar(session.refinement.done, imgui.ImVec2(width, imgui.get_text_line_height()), "")
                imgui.same_line()
            if not session.is_rendering:
                self._probe.update()
            room = layout.status.width - imgui.get_cursor_pos_x() - 8
            probe = "" if session.gesture else self._probe.text
            imgui.text_unformatted(status_line(session, probe, room, lambda text: imgui.calc_text_size(text).x))
            # The probe stands at the right edge, where it doesn't move as the text before it changes.
            imgui.same_line(layout.status.width - imgui.calc_text_size(probe).x - 8)
            imgui.text_unformatted(probe)
            imgui.end()
            imgui.pop_style_var()

    def _help(self) -> None:
        """In the middle of the window: a picture beside the panels may be too narrow. Long lines are broken, and what
        has no room can be scrolled to."""
        window = imgui.get_main_viewport().size
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), 0, imgui.ImVec2(0.5, 0.5))
        imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), window)
        imgui.begin("keys", None, (BARE | imgui.WindowFlags_.always_auto_resize) & ~imgui.WindowFlags_.no_scrollbar)
        keys, meanings = (max(imgui.calc_text_size(text).x for text in texts) for texts in zip(*KEYS_HELP, strict=True))
        if imgui.begin_table("keys", 2, imgui.TableFlags_.sizing_fixed_fit):
            imgui.table_setup_column("keys", 0, keys)
            font = imgui.get_font_size()
            imgui.table_setup_column("meanings", 0, max(min(meanings, window.x - keys - 5 * font), font))
            imgui.push_text_wrap_pos(0.0)
            for text in itertools.chain.from_iterable(KEYS_HELP):
                imgui.table_next_column()
                imgui.text_unformatted(text)
            imgui.pop_text_wrap_pos()
            imgui.end_table()
        imgui.end()

    def _ask(self, question: Question) -> None:
        """A question with a button for each answer; the last one leaves everything as it is."""
        self._centered()
        imgui.begin("question", None, BARE | imgui.WindowFlags_.always_auto_resize)
        imgui.text_unformatted(question.text)
        imgui.spacing()
        for words in (*question.answers, "cancel"):
            if imgui.button(words):
                act(self._session, "answer", words)
            imgui.same_line()
        imgui.new_line()
        imgui.end()

    def _centered(self) -> None:
        area = self._session.layout.picture
        middle = imgui.ImVec2(area.x + area.width / 2, area.y + area.height / 2)
        imgui.set_next_window_pos(middle, 0, imgui.ImVec2(0.5, 0.5))

    def _message(self) -> None:
        area = self._session.layout.picture
        foot = imgui.ImVec2(area.x + area.width / 2, area.y + area.height - MARGIN)
        imgui.set_next_window_pos(foot, 0, imgui.ImVec2(0.5, 1))
        imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), imgui.ImVec2(0.9 * area.width, 0.6 * area.height))
        flags = BARE | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_inputs
        imgui.begin("message", None, flags | imgui.WindowFlags_.no_focus_on_appearing)
        imgui.push_text_wrap_pos(0.85 * area.width)
        imgui.text_unformatted(self._session.message)
        imgui.pop_text_wrap_pos()
        imgui.end()

    def close(self) -> None:
        """Free everything. Safe to call twice."""
        if self._context is not None:
            imgui.set_current_context(self._context)
            self._renderer.close()
            imgui.destroy_context(self._context)
            self._context = None


def _place(area: Area) -> None:
    imgui.set_next_window_pos(imgui.ImVec2(area.x, area.y))
    imgui.set_next_window_size(imgui.ImVec2(max(area.width, 1), max(area.height, 1)))
