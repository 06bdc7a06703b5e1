"""How the panels look: the font, the colors, and the size of texts on screens of high density."""

from __future__ import annotations

from pathlib import Path

import imgui_bundle
from imgui_bundle import imgui

FONTS = ("Roboto/Roboto-Regular.ttf", "DroidSans.ttf")  # in the order of choice; imgui-bundle ships them
FONT_SIZE = 15.0
ICON_FONT = "Font_Awesome_6_Free-Solid-900.otf"
ICON_SIZE = 11.0
# Icons of that font.
SHOWN = "\uf06e"  # eye
HIDDEN = "\uf070"  # eye-slash
LOCKED = "\uf023"  # lock
FREE = "\uf3c1"  # lock-open
ACCENT = (0.95, 0.55, 0.15)
COLORS = {
    "window_bg": (0.13, 0.13, 0.14, 1.0), "popup_bg": (0.16, 0.16, 0.17, 0.98), "border": (0.28, 0.28, 0.30, 1.0),
    "frame_bg": (0.22, 0.22, 0.24, 1.0), "frame_bg_hovered": (0.28, 0.28, 0.31, 1.0),
    "frame_bg_active": (0.32, 0.32, 0.35, 1.0), "button": (0.26, 0.26, 0.29, 1.0),
    "button_hovered": (0.34, 0.34, 0.38, 1.0), "button_active": (0.42, 0.42, 0.47, 1.0),
    "header": (0.22, 0.22, 0.25, 1.0), "header_hovered": (0.28, 0.28, 0.32, 1.0),
    "header_active": (0.33, 0.33, 0.37, 1.0), "check_mark": (*ACCENT, 1.0), "slider_grab": (*ACCENT, 0.8),
    "slider_grab_active": (*ACCENT, 1.0), "plot_histogram": (*ACCENT, 1.0), "plot_lines": (*ACCENT, 1.0),
    "text_selected_bg": (*ACCENT, 0.4),
}  # fmt: skip


def apply_theme() -> None:
    """Give the current ImGui context its font and colors."""
    folder = Path(imgui_bundle.__file__).parent / "assets" / "fonts"
    style = imgui.get_style()
    io = imgui.get_io()
    for name in FONTS:
        if (folder / name).is_file():
            io.fonts.add_font_from_file_ttf(str(folder / name), FONT_SIZE)
            style.font_size_base = FONT_SIZE
            break
    if (folder / ICON_FONT).is_file():
        # Merged, so that one text can have letters and icons.
        merged = imgui.ImFontConfig()
        merged.merge_mode = True
        io.fonts.add_font_from_file_ttf(str(folder / ICON_FONT), ICON_SIZE, merged)
    imgui.style_colors_dark()
    for color, value in COLORS.items():
        style.set_color_(getattr(imgui.Col_, color), imgui.ImVec4(*value))
    style.window_rounding = style.window_border_size = 0.0
    style.frame_rounding = style.grab_rounding = style.popup_rounding = 3.0


def scale_theme(factor: float, scale: float) -> None:
    """Make spaces larger by a factor, and texts `scale` times as large as on a screen of 96 dots per inch."""
    style = imgui.get_style()
    if factor != 1:
        style.scale_all_sizes(factor)
    style.font_scale_dpi = scale
