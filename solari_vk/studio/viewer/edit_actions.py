"""Actions that change the scene, each of which can be undone; and saving and opening it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.material import Texture, TextureImage
from solari_vk.scene.model import Camera, Instance
from solari_vk.studio.viewer.gestures import TransformGesture
from solari_vk.studio.viewer.history import Edit, Presence
from solari_vk.studio.viewer.new_objects import LIGHTS, new_light, new_shape
from solari_vk.studio.viewer.opening import add_file, is_map, open_file, surround
from solari_vk.studio.viewer.placing import transform_of
from solari_vk.studio.viewer.saving import files_of, free_path, save_scene
from solari_vk.studio.viewer.session import GIZMOS, Question, Session
from solari_vk.studio.viewer.window import Event

TEXTURE_FILES = (".png", ".jpg", ".jpeg", ".webp", ".ktx2", ".dds")
NO_PANELS = "this needs the panels: pip install 'solari-vk[viewer]'"
NUDGE = 0.02  # share of the picture's height
AXES = {"right": 0, "left": 0, "up": 1, "down": 1, "nearer": 2, "away": 2}


class EditActions:
    """The edits of a session, for its keys (controls.ACTIONS) and buttons."""

    def __init__(self, session: Session) -> None:
        self._session = session

    # ---- history ------------------------------------------------------------------------------------

    def undo(self) -> None:
        text = self._session.history.undo()
        self._session.say(f"undone: {text}" if text else "there is nothing to undo")

    def redo(self) -> None:
        text = self._session.history.redo()
        self._session.say(f"done again: {text}" if text else "there is nothing to do again")

    # ---- what is picked -----------------------------------------------------------------------------

    def _picked(self) -> list[Any]:
        """What is picked and may be edited; if that is nothing, the user is told."""
        picked = self._session.picked
        free = [item for item in picked if item not in self._session.locked]
        if not picked:
            self._session.say("pick something first: click on it, or on its name in the panels")
        elif not free:
            self._session.say(f"{picked[-1].describe()} is locked")
        return free

    def move_picked(self) -> bool:
        return self._begin("move")

    def turn_picked(self) -> bool:
        return self._begin("turn")

    def scale_picked(self) -> bool:
        return self._begin("scale")

    def _begin(self, kind: str, made: Sequence[Edit] = (), before: Sequence[Any] = ()) -> bool:
        """Let the cursor move, turn or scale what is picked; returns whether something is. made, before: edits and what
        was picked ahead of them, for cancelling."""
        session = self._session
        picked = self._picked()
        placed = [item for item in picked if transform_of(item, session.camera_control.center) is not None]
        if placed:
            session.message = ""
            session.gesture = TransformGesture(session, kind, placed, made, before)
        elif picked:
            session.say(f"{picked[-1].describe()} has no place")
        return bool(picked)

    def duplicate(self) -> bool:
        """Add copies of what is picked, which share meshes and materials with it, and let the cursor move them."""
        session = self._session
        scene = session.scene
        before = self._picked()
        originals = [item for item in before if not isinstance(item, EnvironmentLight)]
        made = []
        for item in originals:
            holder: Any = next(items for items in (scene.instances, scene.lights, scene.cameras) if item in items)
            copy = dataclasses.replace(item)
            copy.name = _free_name(_without_number(item.name), holder.names)
            made.append(Presence(holder, copy, len(holder), True))
            made[-1].redo()
        if made:
            session.pick_only(edit.item for edit in made)
            self._begin("move", made, before)
        elif before:
            session.say("what surrounds the scene is there once")
        return bool(before)

    def own_material(self) -> None:
        """Give what is picked a copy of the material of the object that was picked last."""
        session = self._session
        last = session.selected
        if not isinstance(last, Instance):
            session.say("materials belong to objects: pick one")
            return
        shared = last.material
        material = dataclasses.replace(shared)
        material.name = _free_name(_without_number(shared.name) or "material", session.scene.materials.names)
        users = [item for item in self._picked() if isinstance(item, Instance) and item.material is shared]
        session.edit_all(
            f"a material of its own for {last.describe()}", [(item, {"material": material}) for item in users]
        )

    def next_gizmo(self) -> None:
        session = self._session
        session.gizmo = GIZMOS[(GIZMOS.index(session.gizmo) + 1) % len(GIZMOS)]
        session.say(
            f"dragging what is picked: {session.gizmo}"
            if session.has_panels
            else "handles need the panels (pip install solari-vk[viewer]): arrows nudge what is picked"
        )

    def turn_gizmo(self) -> None:
        session = self._session
        session.gizmo_is_local = not session.gizmo_is_local
        session.say(f"handles along {'its own' if session.gizmo_is_local else 'the world'} axes")

    def _nudge(self, direction: str) -> None:
        """Move what is picked by a small step, along the world's axis that looks most like it on the screen."""
        picked = self._picked()
        control = self._session.camera_control
        placed = [item for item in picked if hasattr(item, "position")]
        if not placed:
            if picked:
                self._session.say(f"{picked[-1].describe()} has no place")
            return
        turn = control.camera.transform[:3, :3]
        if AXES[direction] == 1:
            axis = np.array((0.0, 1.0, 0.0))
        else:
            # The camera's axis in the horizontal plane, and of the world's axes the nearest to it.
            level = turn[:, AXES[direction]] * (1, 0, 1)
            nearest = np.argmax(np.abs(level))
            axis = np.zeros(3)
            axis[nearest] = np.sign(level[nearest]) or 1.0
        sign = -1 if direction in ("left", "down", "away") else 1
        # By a share of what is seen, so that a nudge is as far on the screen near and far away.
        step = sign * NUDGE * control.seen_height * axis
        self._edit_all("position", [(item, {"position": item.position + step}) for item in placed])

    def _edit_all(self, what: str, values: Sequence[tuple[Any, dict[str, Any]]]) -> None:
        if len(values) == 1:
            self._session.edit(values[0][0], **values[0][1])
        else:
            self._session.edit_all(f"{what} of {len(values)} objects", values)

    def nudge_left(self) -> None:
        self._nudge("left")

    def nudge_right(self) -> None:
        self._nudge("right")

    def nudge_up(self) -> None:
        self._nudge("up")

    def nudge_down(self) -> None:
        self._nudge("down")

    def nudge_away(self) -> None:
        self._nudge("away")

    def nudge_nearer(self) -> None:
        self._nudge("nearer")

    def hide(self) -> None:
        picked = self._picked()
        instances = [item for item in picked if isinstance(item, Instance)]
        if instances:
            visible = not instances[-1].visible
            self._edit_all("visible", [(item, {"visible": visible}) for item in instances])
        elif picked:
            self._session.say(f"{picked[-1].describe()} can't be hidden, but removed")

    def show_all(self) -> None:
        hidden = [instance for instance in self._session.scene.instances if not instance.visible]
        self._session.history.assign_all(
            f"showing {len(hidden)} objects", [(item, {"visible": True}) for item in hidden]
        )
        self._session.history.end_gesture()

    def remove(self) -> None:
        picked = self._picked()
        scene = self._session.scene
        surrounding = scene.environment.lights if scene.environment else ()
        lights = [item for item in picked if isinstance(item, Light)]
        # A sky is several lights, its sun and its dome: they are removed together.
        if any(isinstance(item, EnvironmentLight) or item in surrounding for item in lights):
            lights += [light for light in surrounding if light not in lights]
        self._session.history.remove(
            (scene.instances, [item for item in picked if isinstance(item, Instance)]),
            (scene.lights, lights),
            (scene.cameras, [item for item in picked if isinstance(item, Camera)]),
        )
        if picked:
            what = picked[0].describe() if len(picked) == 1 else f"{len(picked)} objects"
            self._session.say(f"removed {what}; Ctrl+Z brings back what was removed")

    # ---- textures -----------------------------------------------------------------------------------

    def put_texture(self, path: Path | str) -> None:
        """Put the picture of a file on the field `session.texture_field` of the materials of what is picked."""
        field = self._session.texture_field
        file = Path(path)
        pixels: Any = file  # which becomes those of the file
        image = TextureImage(pixels=pixels, name=file.stem)
        materials = {id(item.material): item.material for item in self._picked() if isinstance(item, Instance)}
        if materials:
            what = f"{field.replace('_', ' ')} of what is picked"
            self._session.history.assign_all(what, [(item, {field: Texture(image)}) for item in materials.values()])
            self._session.say(f"{file.name} is the {what}")
        elif self._session.picked:
            self._session.say("textures belong on instances: pick one")

    # ---- adding -------------------------------------------------------------------------------------

    def add_shape(self, kind: str) -> None:
        """Add an object of one of new_objects.SHAPES where the camera looks, and pick it."""
        session = self._session
        made = new_shape(kind, session.camera_control)
        made.name = _free_name(kind, session.scene.instances.names)
        session.history.add(session.scene.instances, made)
        session.selected = made

    def add_light(self, kind: str) -> None:
        """Add a light of one of new_objects.LIGHTS where the camera looks, and pick it."""
        session = self._session
        made = new_light(kind, session.camera_control)
        made.name = _free_name(LIGHTS[kind][0], session.scene.lights.names)
        session.history.add(session.scene.lights, made)
        session.selected = made

    def add_camera(self) -> None:
        """Add the view as a camera of the scene."""
        session = self._session
        made = Camera(**{name: getattr(session.camera, name) for name in Camera._names})
        made.name = _free_name("view", session.scene.cameras.names)
        session.history.add(session.scene.cameras, made)
        session.say(f"the view is camera {len(session.scene.cameras)}")

    def surround(self, kind: str) -> None:
        """Surround the scene by "none", "studio", "sky" or a picture of all directions in a file."""
        surround(self._session, kind)

    # ---- files --------------------------------------------------------------------------------------

    def save(self, path: Path | str | None = None) -> None:
        """Write the scene as glTF and the script that renders the picture. path: by default a new name.

        Asks before it replaces files that the session didn't write; without panels, the same action again does.
        """
        session = self._session
        target = Path(path) if path is not None else session.save_path or free_path(session)
        known = session.save_path is not None and target.resolve() == session.save_path.resolve()
        # Saving again to the same name replaces what this session wrote, without a question.
        existing = [] if known else [str(file) for file in files_of(target) if file.exists()]
        text = f"There is {' and '.join(existing)} already."
        if not existing or (session.question is not None and session.question.text == text):
            session.question = None
            self._write(target)
            return
        session.question = Question(text, {"replace": lambda: self._write(target)})
        if not session.has_panels:
            session.warn(f"{text} Save once more to replace it, or give another name.")

    def _write(self, target: Path) -> None:
        session = self._session
        script, lost = save_scene(session, target)
        session.save_path = target
        session.sources.mark_written(target)
        session.history.mark_saved()
        session.say(f"wrote {target} and {script.name}" + "".join(f"\nnot in the file: {what}" for what in lost))

    def drop(self, event: Event) -> None:
        """Open a model that was dropped into the window, with Shift add it; surround the scene by a picture; or put an
        8-bit picture on the material of an instance that is picked."""
        for path in map(Path, event.paths):
            self._drop_file(path, adds=bool(event.code))

    def _drop_file(self, path: Path, adds: bool) -> None:
        # .png and .jpg may be textures or maps: what is picked decides.
        is_texture = path.suffix.lower() in TEXTURE_FILES
        if is_texture and (isinstance(self._session.selected, Instance) or not is_map(path)):
            self.put_texture(path)
        elif is_map(path):
            self.surround(str(path))
        elif adds:
            add_file(self._session, path)
        else:
            self.open(path)

    def open(self, path: Path | str) -> None:
        """Show another file, after asking what to do with edits that aren't saved."""
        self._ask_about_edits(f"open {Path(path).name}", lambda: open_file(self._session, Path(path)))

    def close(self) -> None:
        """Cancel what is going on; if that is nothing, ask whether to close the window."""
        session = self._session
        text = "Close the window?"
        if session.question is not None and session.has_panels:
            session.question = None
        elif session.shows_help:
            session.shows_help = False
        elif session.history.unsaved or (session.question is not None and session.question.text == text):
            self.close_window()
        else:
            session.question = Question(text, {"close": self.close_window})
            if not session.has_panels:
                session.warn("Esc once more closes the window")

    def close_window(self) -> None:
        def close() -> None:
            self._session.window.wants_to_close = True

        self._ask_about_edits("close", close)

    def _ask_about_edits(self, what: str, go_on: Any) -> None:
        """Go on at once without unsaved edits. Otherwise ask; without panels, the same action again goes on."""
        session = self._session
        text = f"There are edits that aren't saved. Before you {what}:"
        if not session.history.unsaved or (session.question is not None and session.question.text == text):
            session.question = None
            go_on()
            return

        def save_and_go_on() -> None:
            self.save()
            go_on()

        session.question = Question(text, {"save and " + what: save_and_go_on, what + " without saving": go_on})
        if not session.has_panels:
            session.warn(f"there are edits that aren't saved: Ctrl+S saves them; once more: {what} without")

    def answer(self, words: str) -> None:
        """Answer the question that is asked; other words than its answers do nothing."""
        question = self._session.question
        self._session.question = None  # before the answer, which may ask another one
        if question is not None and words in question.answers:
            question.answers[words]()


def _without_number(name: str) -> str:
    """A name without the number that `_free_name` puts behind it."""
    start, _, number = name.rpartition(" ")
    return start if start and number.isdecimal() else name


def _free_name(name: str, names: Iterable[str]) -> str:
    """The name, or with the first number behind it that makes it another one than these."""
    others = set(names)
    found = name
    number = 1
    while found in others:
        number += 1
        found = f"{name} {number}"
    return found
