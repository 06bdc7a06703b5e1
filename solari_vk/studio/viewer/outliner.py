"""The list of what is in the scene, by which objects are picked, hidden, locked, added and removed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any

from imgui_bundle import imgui

from solari_vk.scene.model import Camera, Instance
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.new_lights import LIGHTS
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.theme import FREE, HIDDEN, LOCKED, SHOWN
from solari_vk.studio.viewer.widgets import hint, toggle

MAX_ROWS = 500  # that a list shows; the others are found by a part of their name, or picked in the picture
ROWS_HIGH = 9  # rows of the list that are seen at once


class Outliner:
    """Lays out the instances, lights and cameras of a session's scene."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._filter = ""

    def lay_out(self) -> None:
        """Lay out a field for a part of a name, the list, and buttons that add to it."""
        scene = self._session.scene
        imgui.set_next_item_width(-1)
        _, self._filter = imgui.input_text_with_hint("##filter", "find by name", self._filter)
        height = ROWS_HIGH * imgui.get_text_line_height_with_spacing()
        imgui.begin_child("list", imgui.ImVec2(0, height), imgui.ChildFlags_.borders | imgui.ChildFlags_.resize_y)
        surrounding = scene.environment.lights if scene.environment else ()
        self._list("instances", list(scene.instances))
        self._list("lights", [light for light in scene.lights if light not in surrounding])
        self._list("cameras", list(scene.cameras))
        imgui.end_child()
        for kind, (_, meaning) in LIGHTS.items():
            if imgui.button(f"+ {kind}"):
                act(self._session, "add_light", kind)
            hint(f"Add {meaning}.")
            imgui.same_line()
        if imgui.button("+ camera"):
            act(self._session, "add_camera")
        hint("Add the view as a camera of the scene.")
        if scene.warnings and imgui.tree_node(f"warnings ({len(scene.warnings)})###warnings"):
            for warning in scene.warnings:
                imgui.text_wrapped(warning)
            imgui.tree_pop()

    def _list(self, title: str, items: Sequence[Any]) -> None:
        if not items:
            return
        # ### makes the rest the whole identity, so that the tree stays open when the number before it changes.
        if imgui.tree_node_ex(f"{title} ({len(items)})###{title}", imgui.TreeNodeFlags_.default_open):
            wanted = self._filter.strip().lower()
            named = ((item.name or f"{title[:-1]} {number}", item) for number, item in enumerate(items))
            found = ((name, item) for name, item in named if wanted in name.lower())
            for number, (name, item) in enumerate(islice(found, MAX_ROWS)):
                imgui.push_id(number)
                self._row(name, item)
                imgui.pop_id()
            if next(found, None) is not None:
                imgui.text_disabled("... and more: find them by name, or click on them")
            imgui.tree_pop()

    def _row(self, name: str, item: Any) -> None:
        self._visibility(item)
        imgui.same_line()
        self._lock(item)
        imgui.same_line()
        self._name(name, item)

    def _visibility(self, item: Any) -> None:
        """A button that shows or hides an instance; for others a space as wide, so that names stand in a column."""
        if not isinstance(item, Instance):
            imgui.dummy(imgui.calc_text_size(SHOWN))
            return
        # What stands behind ## is a widget's identity and isn't shown: the icon may change under the mouse.
        icon = SHOWN if item.visible else HIDDEN
        if toggle(f"{icon}##shown", item.visible, "Show or hide (H)."):
            self._session.edit(item, visible=not item.visible)

    def _lock(self, item: Any) -> None:
        locked = self._session.locked
        icon = LOCKED if item in locked else FREE
        if not toggle(f"{icon}##lock", item in locked, "Lock: clicks don't pick it, and nothing edits it."):
            return
        if item in locked:
            locked.discard(item)
        else:
            locked.add(item)

    def _name(self, name: str, item: Any) -> None:
        """The name, which picks the item; a double click looks through a camera."""
        session = self._session
        dim = isinstance(item, Instance) and not item.visible
        if dim:
            imgui.push_style_color(imgui.Col_.text, imgui.get_style_color_vec4(imgui.Col_.text_disabled))
        clicked, _ = imgui.selectable(f"{name}##name", any(item is picked for picked in session.picked))
        if dim:
            imgui.pop_style_color()
        if clicked:
            self._click(item)
        if isinstance(item, Camera) and imgui.is_item_hovered() and imgui.is_mouse_double_clicked(0):
            session.camera_control.look_through(item)
            session.pictures.cut()

    def _click(self, item: Any) -> None:
        """Pick an item, with Shift or Ctrl among others."""
        io = imgui.get_io()
        if io.key_shift or io.key_ctrl:
            self._session.pick_also(item)
        else:
            self._session.selected = item
