"""The panel's head: undo and redo, saving, opening files again, and the tools for what is picked."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import imgui

from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.opening import recent_files
from solari_vk.studio.viewer.saving import free_path
from solari_vk.studio.viewer.session import GIZMOS, Session
from solari_vk.studio.viewer.widgets import hint

NAMED = {"none": "look", "move": "move", "turn": "turn", "scale": "scale"}


class FilePanel:
    """Lays out buttons for the file and the edits."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._recent: list[str] | None = None  # read from disk when the popup opens, not in each frame
        self._path = ""

    def lay_out(self) -> None:
        """Lay out two rows of buttons, and what they open."""
        session = self._session
        history = self._session.history
        if imgui.button("open ..."):
            self._recent = recent_files()
            imgui.open_popup("open")
        imgui.same_line()
        if imgui.button("save ..."):
            self._path = str(session.save_path or free_path(session))
            imgui.open_popup("save")
        hint("Write the scene as glTF, and a Python script that renders the picture (Ctrl+S).")
        for label, edits in (("undo", history.done), ("redo", history.undone)):
            imgui.same_line()
            # A disabled button stays in its place, so that the others don't move under the mouse.
            imgui.begin_disabled(not edits)
            if imgui.button(label):
                act(session, label)
            if edits:
                hint(edits[-1].text)
            imgui.end_disabled()
        if history.unsaved:
            imgui.same_line()
            imgui.text_disabled("edited")
        self._open_popup()
        self._save_popup()
        for number, name in enumerate(GIZMOS):
            if number:
                imgui.same_line()
            if imgui.radio_button(f"{NAMED[name]}##handles", session.gizmo == name):
                session.gizmo = name
        imgui.same_line()
        _, session.gizmo_is_local = imgui.checkbox("local", session.gizmo_is_local)
        hint("Handles along the axes of the object itself, not of the world (L).")

    def _open_popup(self) -> None:
        if not imgui.begin_popup("open"):
            return
        imgui.text_disabled("Drop a model or a picture of all directions into the window, or:")
        _, self._path = imgui.input_text_with_hint("##path", "path of a model", self._path)
        imgui.same_line()
        if imgui.button("open") and self._path.strip():
            act(self._session, "open", Path(self._path.strip()).expanduser())
            imgui.close_current_popup()
        # The path behind ## keeps files of one name apart.
        for path in self._recent or ():
            if imgui.menu_item_simple(f"{Path(path).name}##{path}"):
                act(self._session, "open", path)
            hint(path)
        imgui.end_popup()

    def _save_popup(self) -> None:
        if not imgui.begin_popup("save"):
            return
        _, self._path = imgui.input_text("##target", self._path)
        imgui.same_line()
        if imgui.button("save"):
            act(self._session, "save", self._path.strip())
            imgui.close_current_popup()
        imgui.text_disabled("with a Python script beside it that renders the picture")
        imgui.end_popup()
