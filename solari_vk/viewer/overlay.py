"""The panels over the picture: Dear ImGui's context, its input and the windows of a frame."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import glfw
from imgui_bundle import imgui

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.swapchain import Swapchain
from solari_vk.viewer.controls import KEYS_HELP
from solari_vk.viewer.overlay_renderer import OverlayRenderer
from solari_vk.viewer.panels import Panels
from solari_vk.viewer.session import Session
from solari_vk.viewer.window import Event

MARGIN, WIDTH = 8, 360  # of the panels' window, in window coordinates
DIVIDER_WIDTH = 9
_BARE = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_move
# GLFW's and ImGui's names of keys differ only in these two points, and for keys that text fields don't use.
_KEYS = {
    getattr(glfw, code): key for name, key in imgui.Key.__members__.items()
    if hasattr(glfw, code := "KEY_" + name.removesuffix("_arrow").replace("keypad", "kp").upper())
}  # fmt: skip
_MODIFIERS = {getattr(glfw, f"MOD_{name}"): getattr(imgui.Key, f"mod_{short}")
              for name, short in (("CONTROL", "ctrl"), ("SHIFT", "shift"), ("ALT", "alt"))}  # fmt: skip


class Overlay:
    """The panels of a viewer. For each frame call `take_events`, `lay_out`, and `draw` any number of times."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._context: Any = imgui.create_context()
        imgui.set_current_context(self._context)
        io = imgui.get_io()
        io.set_ini_filename("")
        imgui.style_colors_dark()
        self._renderer = OverlayRenderer(session.device)
        self._panels = Panels(session)
        self._laid_out = False
        platform = imgui.get_platform_io()
        platform.platform_get_clipboard_text_fn = lambda _: session.window.clipboard
        platform.platform_set_clipboard_text_fn = lambda _, text: setattr(session.window, "clipboard", text)

    # ---- input --------------------------------------------------------------------------------------

    def take_events(self, events: Iterable[Event]) -> tuple[bool, bool]:
        """Pass events to the panels; returns whether the keys and whether the mouse are left to the viewer."""
        imgui.set_current_context(self._context)
        io = imgui.get_io()
        for event in events:
            if event.kind == "cursor":
                io.add_mouse_pos_event(event.x, event.y)
            elif event.kind == "button" and event.code < 5:
                io.add_mouse_button_event(event.code, event.pressed)
            elif event.kind == "scroll":
                io.add_mouse_wheel_event(event.x, event.y)
            elif event.kind == "text":
                io.add_input_character(event.code)
            elif event.kind == "focus":
                io.add_focus_event(event.pressed)
            elif event.kind == "key":
                for bit, key in _MODIFIERS.items():
                    io.add_key_event(key, bool(event.modifiers & bit))
                if event.code in _KEYS:
                    io.add_key_event(_KEYS[event.code], event.pressed)
        return not io.want_capture_keyboard, not io.want_capture_mouse

    # ---- a frame ------------------------------------------------------------------------------------

    def lay_out(self, seconds: float) -> None:
        """Lay out the panels for the window's size, and apply what the user changes in them."""
        imgui.set_current_context(self._context)
        session, io = self._session, imgui.get_io()
        size, pixels = session.window.size, session.window.pixels
        io.display_size = imgui.ImVec2(*size)
        io.display_framebuffer_scale = imgui.ImVec2(pixels[0] / max(size[0], 1), pixels[1] / max(size[1], 1))
        io.delta_time = max(seconds, 1e-4)
        imgui.new_frame()
        try:
            if session.pictures.mode == "split":
                self._dividers(size)
            if session.shows_panels:
                imgui.set_next_window_pos(imgui.ImVec2(MARGIN, MARGIN), imgui.Cond_.first_use_ever)
                height = max(size[1] - 2 * MARGIN, 1)
                width = min(WIDTH, max(size[0] - 2 * MARGIN, 1))
                imgui.set_next_window_size(imgui.ImVec2(width, height), imgui.Cond_.appearing)
                imgui.set_next_window_bg_alpha(0.8)
                if imgui.begin("solari_vk", None, imgui.WindowFlags_.no_saved_settings)[0]:
                    self._panels.lay_out()
                imgui.end()
            if session.shows_help:
                self._help(size)
            if session.message:
                self._message(size)
        finally:
            imgui.end_frame()
        imgui.render()
        self._laid_out = True

    def draw(self, commands: raw.CData, swapchain: Swapchain, index: int) -> None:
        """Record commands that draw the panels over an image of the swapchain.

        Raises CompilationError for an error in a shader, and then records nothing until `reload` is called.
        """
        imgui.set_current_context(self._context)
        if not self._laid_out:
            self.lay_out(0.0)
        self._renderer.draw(imgui.get_draw_data(), commands, swapchain, index)

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipeline then stays in use."""
        self._renderer.reload()

    # ---- parts --------------------------------------------------------------------------------------

    def _dividers(self, size: tuple[int, int]) -> None:
        """The lines between the pictures of the split view, which the user can drag, and the pictures' names."""
        pictures, lines = self._session.pictures, imgui.get_background_draw_list()
        for index, (name, (begin, end)) in enumerate(pictures.columns().items()):
            at = begin * size[0] + 8 if index else end * size[0] - 8 - imgui.calc_text_size(name).x
            lines.add_text(imgui.ImVec2(at + 1, size[1] - 23), 0xFF000000, name)
            lines.add_text(imgui.ImVec2(at, size[1] - 24), 0xFFFFFFFF, name)
            if index:
                self._divider(f"divider {index}", begin, size)

    def _divider(self, name: str, at: float, size: tuple[int, int]) -> None:
        x, pictures = at * size[0], self._session.pictures
        imgui.get_background_draw_list().add_line(imgui.ImVec2(x, 0), imgui.ImVec2(x, size[1]), 0xC0FFFFFF)
        imgui.set_next_window_pos(imgui.ImVec2(x - DIVIDER_WIDTH // 2, 0))
        imgui.set_next_window_size(imgui.ImVec2(DIVIDER_WIDTH, size[1]))
        imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(0, 0))
        imgui.push_style_var(imgui.StyleVar_.window_min_size, imgui.ImVec2(1, 1))
        flags = _BARE | imgui.WindowFlags_.no_background | imgui.WindowFlags_.no_bring_to_front_on_focus
        imgui.begin(name, None, flags)
        imgui.invisible_button("drag", imgui.ImVec2(DIVIDER_WIDTH, max(size[1], 1)))
        if imgui.is_item_active():
            dragged = imgui.get_io().mouse_pos.x / max(size[0], 1) - at
            pictures.divider = min(max(pictures.divider + dragged, 0.0), 1.0)
        imgui.end()
        imgui.pop_style_var(2)

    def _help(self, size: tuple[int, int]) -> None:
        imgui.set_next_window_pos(imgui.ImVec2(size[0] / 2, size[1] / 2), 0, imgui.ImVec2(0.5, 0.5))
        imgui.begin("keys", None, _BARE | imgui.WindowFlags_.always_auto_resize)
        if imgui.begin_table("keys", 2):
            for text in itertools.chain.from_iterable(KEYS_HELP):
                imgui.table_next_column()
                imgui.text_unformatted(text)
            imgui.end_table()
        imgui.end()

    def _message(self, size: tuple[int, int]) -> None:
        imgui.set_next_window_pos(imgui.ImVec2(size[0] / 2, size[1] - MARGIN), 0, imgui.ImVec2(0.5, 1))
        imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), imgui.ImVec2(0.9 * size[0], 0.6 * size[1]))
        flags = _BARE | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_inputs
        imgui.begin("message", None, flags | imgui.WindowFlags_.no_focus_on_appearing)
        imgui.push_text_wrap_pos(0.85 * size[0])
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
