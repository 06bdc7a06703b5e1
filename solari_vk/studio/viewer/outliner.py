"""The tree of what is in the scene, by which objects are picked, hidden, locked, added and removed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import islice
from typing import Any

from imgui_bundle import imgui

from solari_vk.scene.group import Group
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.new_objects import LIGHTS, SHAPES
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.theme import FREE, HIDDEN, LOCKED, SHOWN
from solari_vk.studio.viewer.widgets import hint, toggle

MAX_ROWS = 500  # that a list shows; the others are found by a part of their name, or picked in the picture
ROWS_HIGH = 9  # rows of the list that are seen at once
LOOK = 2.0  # seconds between two looks at the groups, which ask for all that is in them, while nothing comes or goes
OPEN = imgui.TreeNodeFlags_.default_open
GROUP = imgui.TreeNodeFlags_.open_on_arrow | imgui.TreeNodeFlags_.open_on_double_click


class Outliner:
    """Lays out the instances, lights and cameras of a session's scene."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._filter = ""
        self._roots: list[Group] = []
        self._grouped: set[Any] = set()  # what is in them
        self._counts: tuple[int, ...] = ()
        self._looked_at = 0.0

    def lay_out(self) -> None:
        """Lay out a menu that adds to the scene, a field for a part of a name, and the tree."""
        scene = self._session.scene
        if imgui.button("+ add"):
            imgui.open_popup("add")
        hint("Add a shape, a light or a camera (Shift+A).")
        imgui.same_line()
        imgui.set_next_item_width(-1)
        _, self._filter = imgui.input_text_with_hint("##filter", "find by name", self._filter)
        # A third of the panels at most, so that in a small window what is picked is seen below.
        height = min(ROWS_HIGH * imgui.get_text_line_height_with_spacing(), imgui.get_window_height() / 3)
        imgui.begin_child("list", imgui.ImVec2(0, height), imgui.ChildFlags_.borders | imgui.ChildFlags_.resize_y)
        surrounding = scene.environment.lights if scene.environment else ()
        # A search finds objects in closed groups too, so that it lists all.
        roots, grouped = ([], set()) if self._filter.strip() else self._tree()
        if roots and imgui.tree_node_ex("groups", OPEN):
            for number, group in enumerate(roots):
                self._member(number, group)
            imgui.tree_pop()
        self._list("instances", [item for item in scene.instances if item not in grouped])
        self._list("lights", [item for item in scene.lights if item not in surrounding and item not in grouped])
        self._list("cameras", [item for item in scene.cameras if item not in grouped])
        imgui.end_child()
        if scene.warnings and imgui.tree_node(f"warnings ({len(scene.warnings)})###warnings"):
            for warning in scene.warnings:
                imgui.text_wrapped(warning)
            imgui.tree_pop()

    def _list(self, title: str, items: Sequence[Any]) -> None:
        if not items:
            return
        # ### makes the rest the whole identity, so that the tree stays open when the number before it changes.
        if imgui.tree_node_ex(f"{title} ({len(items)})###{title}", OPEN):
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

    def _tree(self) -> tuple[list[Group], set[Any]]:
        """The groups that are in no other, and the objects in them."""
        now = time.perf_counter()
        scene = self._session.scene
        counts = self._session.load_count, len(scene.instances), len(scene.lights), len(scene.cameras)
        if counts != self._counts or now - self._looked_at > LOOK:
            self._looked_at = now
            self._counts = counts
            self._roots = roots_of(scene)
            self._grouped = {item for group in self._roots for item in group.items}
        return self._roots, self._grouped

    def add_menu(self) -> None:
        """The menu of what can be added, also while the tree is closed."""
        session = self._session
        if session.opens_add_menu:
            session.opens_add_menu = False
            imgui.open_popup("add")
        if not imgui.begin_popup("add"):
            return
        for kind in SHAPES:
            if imgui.menu_item_simple(kind):
                act(session, "add_shape", kind)
        imgui.separator()
        for kind, (_, meaning) in LIGHTS.items():
            if imgui.menu_item_simple(f"{kind} light"):
                act(session, "add_light", kind)
            hint(f"Add {meaning}.")
        imgui.separator()
        if imgui.menu_item_simple("camera"):
            act(session, "add_camera")
        hint("Add the view as a camera of the scene.")
        imgui.end_popup()

    def _member(self, number: int, member: Any) -> None:
        """A row of a group or of an object in a group."""
        imgui.push_id(number)
        name = member.name or f"{type(member).__name__.lower()} {number}"
        if isinstance(member, Group):
            self._group(name, member)
        else:
            self._row(name, member)
        imgui.pop_id()

    def _group(self, name: str, group: Group) -> None:
        """A group, whose name picks all that is in it, and below it what is in it."""
        session = self._session
        present = members_of(session.scene, group)
        objects = [item for item in group.items if _is_there(session.scene, item)]
        instances = [item for item in objects if isinstance(item, Instance)]
        visible = any(item.visible for item in instances)
        if toggle(f"{SHOWN if visible else HIDDEN}##shown", visible, "Show or hide the group."):
            text = f"{'hiding' if visible else 'showing'} {group.describe()}"
            session.edit_all(text, [(item, {"visible": not visible}) for item in instances])
        imgui.same_line()
        is_picked = bool(objects) and set(objects) <= set(session.picked)
        picked = imgui.TreeNodeFlags_.selected if is_picked else 0
        is_open = imgui.tree_node_ex(f"{name} ({len(objects)})###group", GROUP | picked)
        if imgui.is_item_clicked() and not imgui.is_item_toggled_open():
            io = imgui.get_io()
            before = session.picked if io.key_shift or io.key_ctrl else []
            others = [item for item in objects if item not in session.locked and item not in before]
            session.pick_only([*before, *others])
        if is_open:
            for number, member in enumerate(present[:MAX_ROWS]):
                self._member(number, member)
            if len(present) > MAX_ROWS:
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


def roots_of(scene: Scene) -> list[Group]:
    """The groups that are in no other group."""
    groups = list(scene.groups)
    inside = {member for group in groups for member in group if isinstance(member, Group)}
    return [group for group in groups if group not in inside]


def members_of(scene: Scene, group: Group) -> list[Any]:
    """What is in a group itself, groups first; without what was removed from the scene."""
    groups = [member for member in group if isinstance(member, Group)]
    return groups + [member for member in group if _is_there(scene, member)]


def _is_there(scene: Scene, item: Any) -> bool:
    return item in scene.instances or item in scene.lights or item in scene.cameras
