"""What is drawn over the picture: names and dividers, marks of lights and cameras, the outline of what is picked."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Camera, Instance
from solari_vk.studio.viewer import markers
from solari_vk.studio.viewer.gestures import BoxGesture, TransformGesture
from solari_vk.studio.viewer.outline import COLOR, Outline
from solari_vk.studio.viewer.overlay_renderer import OverlayRenderer
from solari_vk.studio.viewer.session import Session

DIVIDER_WIDTH = 9  # of what the mouse can take hold of, in window coordinates; the line itself is 1 wide
BAND_WIDTH = 3
BARE = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_move
# Colors as ImGui has them, 0xAABBGGRR.
WHITE = 0xFFFFFFFF
SHADOW = 0xC0000000
PICKED = int.from_bytes(COLOR, "little")
LIGHT = 0xFF66E0FF
CAMERA = 0xFFE0C090
AXIS_COLORS = (0xFF5050F0, 0xFF50D050, 0xFFF08050)  # of x, y and z
INSIDE = 0x20FFFFFF
OUTLINE = "outline"


class Decorations:
    """Draws over the picture of a session."""

    def __init__(self, session: Session, renderer: OverlayRenderer) -> None:
        self._session = session
        self._renderer = renderer
        self._outline = Outline()
        self._changed = False  # whether the outline's texture is older than its image

    def lay_out(self) -> None:
        """Draw everything, between ImGui's new_frame and end_frame."""
        session = self._session
        area = self._session.layout.picture
        # The background list is drawn below all windows, so panels and messages stay above.
        lines = imgui.get_background_draw_list()
        lines.push_clip_rect(imgui.ImVec2(area.x, area.y), imgui.ImVec2(area.x + area.width, area.y + area.height))
        if session.shows_panels:
            self._draw_outline(lines)
            self._draw_markers(lines)
        else:
            self._renderer.forget(OUTLINE)
            self._changed = True
            self._draw_band(lines)
        if len(session.columns()) > 1:
            self._draw_columns(lines)
        self._draw_gesture(lines)
        lines.pop_clip_rect()

    # ---- what is picked -----------------------------------------------------------------------------

    def _draw_outline(self, lines: Any) -> None:
        """The outline in the picture once it rests; until then the box around the object."""
        session = self._session
        instances = [item for item in session.picked if isinstance(item, Instance) and item.visible]
        # The outline is found in the picture's instance numbers, which takes a wait for the device: too long for each
        # frame while something moves.
        if instances and session.refinement.moves:
            for instance in instances:
                self._draw_box(lines, instance)
            return
        with session.showing_mistakes():
            if not session.is_rendering:
                self._changed |= self._outline.update(session.pictures, instances)
            image = self._outline.image
            if image is None:
                self._renderer.forget(OUTLINE)
                return
            texture = self._renderer.show(OUTLINE, image if self._changed else None)
            if texture is not None:
                self._changed = False
                area = session.layout.picture
                low, high = imgui.ImVec2(area.x, area.y), imgui.ImVec2(area.x + area.width, area.y + area.height)
                lines.add_image(texture, low, high)

    def _draw_box(self, lines: Any, instance: Instance) -> None:
        session = self._session
        positions = instance.mesh.positions
        corners = np.array(list(product(*zip(positions.min(axis=0), positions.max(axis=0), strict=True))), np.float64)
        places = markers.project(session.camera, transform_points(instance.transform, corners), session.layout.picture)
        for a, b in combinations(range(8), 2):
            # The corners' numbers are their sides in binary: those of an edge differ in one axis.
            if bin(a ^ b).count("1") == 1:
                _line(lines, places[a], places[b], PICKED)

    def _draw_band(self, lines: Any) -> None:
        """A line beside the rows that have the samples which are being traced."""
        session = self._session
        area = self._session.layout.picture
        if session.pictures.most_bands and session.pictures.reference is not None and not session.refinement.finished:
            tracer = session.pictures.reference.tracer
            end = area.y + tracer.unfinished_bands[1] / tracer.size[1] * area.height
            lines.add_rect_filled(imgui.ImVec2(area.x, area.y), imgui.ImVec2(area.x + BAND_WIDTH, end), PICKED)

    def _draw_markers(self, lines: Any) -> None:
        """Rings at lights and squares at cameras; a line along the direction of those that are picked."""
        session = self._session
        radius = markers.RADIUS * session.window.text_scale
        item: Any
        for item, (x, y) in markers.visible_markers(session):
            center = imgui.ImVec2(x, y)
            picked = any(item is other for other in session.picked)
            color = CAMERA if isinstance(item, Camera) else LIGHT
            if picked:
                color = PICKED
            if isinstance(item, Camera):
                half = 0.8 * radius
                lines.add_rect(imgui.ImVec2(x - half, y - half), imgui.ImVec2(x + half, y + half), color, 0, 2.0)
            else:
                lines.add_circle(center, radius, SHADOW, 0, 4.0)
                lines.add_circle(center, radius, color, 0, 2.0)
                lines.add_circle_filled(center, 0.35 * radius, color)
            axis: Any = -item.transform[:3, 2] if isinstance(item, Camera) else getattr(item, "direction", None)
            if picked and axis is not None:
                end = item.position + 0.15 * session.camera_control.seen_height * np.asarray(axis, np.float64)
                [place] = markers.project(session.camera, end[None], session.layout.picture)
                _line(lines, np.array((x, y)), place, color)

    # ---- what is going on ---------------------------------------------------------------------------

    def _draw_gesture(self, lines: Any) -> None:
        """The axes along which something moves, and the box that picks."""
        gesture = self._session.gesture
        if isinstance(gesture, BoxGesture) and gesture.corners is not None:
            low, high = (imgui.ImVec2(*corner) for corner in gesture.corners)
            lines.add_rect_filled(low, high, INSIDE)
            lines.add_rect(low, high, WHITE)
        elif isinstance(gesture, TransformGesture):
            transforming = gesture.transforming
            for number, start, end in transforming.guides():
                _line(lines, start, end, AXIS_COLORS[number])
            center = transforming.sight.project(transforming.pivot)
            if np.isfinite(center).all():
                lines.add_circle_filled(imgui.ImVec2(*center), 3.0, PICKED)

    # ---- pictures side by side ----------------------------------------------------------------------

    def _draw_columns(self, lines: Any) -> None:
        """The lines between pictures side by side, which the user can drag, and the pictures' names."""
        area = self._session.layout.picture
        height = imgui.get_text_line_height()
        for index, (name, (begin, end)) in enumerate(self._session.columns().items()):
            width = imgui.calc_text_size(name).x
            at = area.x + (begin * area.width + 8 if index else end * area.width - 8 - width)
            top = area.y + area.height - height - 8
            lines.add_text(imgui.ImVec2(at + 1, top + 1), 0xFF000000, name)
            lines.add_text(imgui.ImVec2(at, top), WHITE, name)
            if index:
                self._divider(lines, f"divider {index}", begin)

    def _divider(self, lines: Any, name: str, at: float) -> None:
        area = self._session.layout.picture
        pictures = self._session.pictures
        # A window without a background takes the mouse along the line, before the picture does.
        x = area.x + at * area.width
        lines.add_line(imgui.ImVec2(x, area.y), imgui.ImVec2(x, area.y + area.height), 0xC0FFFFFF)
        imgui.set_next_window_pos(imgui.ImVec2(x - DIVIDER_WIDTH // 2, area.y))
        imgui.set_next_window_size(imgui.ImVec2(DIVIDER_WIDTH, area.height))
        imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(0, 0))
        imgui.push_style_var(imgui.StyleVar_.window_min_size, imgui.ImVec2(1, 1))
        flags = BARE | imgui.WindowFlags_.no_background | imgui.WindowFlags_.no_bring_to_front_on_focus
        imgui.begin(name, None, flags)
        imgui.invisible_button("drag", imgui.ImVec2(DIVIDER_WIDTH, max(area.height, 1)))
        if imgui.is_item_active():
            dragged = area.share((imgui.get_io().mouse_pos.x, 0))[0] - at
            pictures.divider = min(max(pictures.divider + dragged, 0.0), 1.0)
        imgui.end()
        imgui.pop_style_var(2)


def _line(lines: Any, start: NDArray[np.float64], end: NDArray[np.float64], color: int) -> None:
    if np.isfinite(start).all() and np.isfinite(end).all():
        lines.add_line(imgui.ImVec2(*start), imgui.ImVec2(*end), color, 1.5)
