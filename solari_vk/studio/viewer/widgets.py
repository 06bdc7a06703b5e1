"""Widgets of the panels. Dear ImGui has no widget objects: a call lays one out for this frame and returns its value."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray


def as_edit(returned: Any) -> tuple[bool, Any]:
    """What ImGui's widgets return, whether the user changed the value and the value, with a type."""
    changed, value = returned
    return bool(changed), value


def choose(label: str, current: str, choices: Sequence[str]) -> str:
    """A drop-down list; returns the chosen item."""
    return choices[imgui.combo(label, choices.index(current), list(choices))[1]]


def hint(text: str) -> None:
    """Show a text while the mouse rests on the last item."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.delay_short):
        imgui.begin_tooltip()
        imgui.push_text_wrap_pos(25 * imgui.get_font_size())
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


def edit_on_enter(label: str, value: Any, field: Callable[..., tuple[bool, Any]]) -> Any:
    """A text field for a number; returns a new value once Enter is pressed, not while it is typed."""
    flags = imgui.InputTextFlags_.enter_returns_true
    more = {"format": "%g"} if field is imgui.input_float else {"step": 0, "step_fast": 0}
    changed, edited = field(label, value, flags=flags, **more)
    if changed and isinstance(edited, float):
        edited = float(f"{edited:.7g}")  # ImGui's numbers have 32 bits: round to what was typed
    return edited if changed else value


def share(label: str, value: float) -> tuple[bool, float]:
    """A slider from 0 to 1."""
    edited: tuple[bool, float] = imgui.slider_float(label, value, 0, 1, flags=imgui.SliderFlags_.always_clamp)
    return edited


def drag(label: str, value: float, low: float, high: float, format: str = "%.4g") -> tuple[bool, float]:
    """A number that is dragged in steps of 1 % of itself, within a range."""
    # A fixed step would be too coarse for millimeters and too fine for kilometers.
    value = min(value, high)  # for fields that may be infinite
    speed = max(0.01 * abs(value), 1e-3 * min(high - low, 1.0))
    edited: tuple[bool, float] = imgui.drag_float(label, value, speed, low, high, format)
    return edited


def color(label: str, value: NDArray[np.float32], high: float = 1.0) -> tuple[bool, NDArray[np.float64]]:
    """An editor of a color. The numbers are linear, as in the scene, so the swatch beside them looks darker."""
    flags = imgui.ColorEditFlags_.float | (imgui.ColorEditFlags_.hdr if high > 1 else 0)
    changed, edited = imgui.color_edit3(label, value.tolist(), flags)
    return changed, np.clip(edited, 0, high)


def toggle(label: str, on: bool, meaning: str) -> bool:
    """A small button that is dim while it is off; returns whether it was pressed."""
    imgui.push_style_color(imgui.Col_.text, imgui.ImVec4(1, 1, 1, 1 if on else 0.3))
    pressed = bool(imgui.small_button(label))
    imgui.pop_style_color()
    hint(meaning)
    return pressed
