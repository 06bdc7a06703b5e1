"""What keys and buttons do: each method of Actions is the action with the method's name."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Instance
from solari_vk.studio.viewer import markers
from solari_vk.studio.viewer.camera_control import TURN, extent_of
from solari_vk.studio.viewer.controls import KEYS_HELP
from solari_vk.studio.viewer.edit_actions import NO_PANELS, EditActions
from solari_vk.studio.viewer.gestures import BoxGesture
from solari_vk.studio.viewer.picking import Pick, pick_at
from solari_vk.studio.viewer.pictures import MODES
from solari_vk.studio.viewer.screenshot import edit_lines, take_screenshot
from solari_vk.studio.viewer.session import Session

DIVIDER_STEP = 0.02  # share of the window's width
EXPOSURE_STEP = 1 / 3  # stops
ORBIT_STEP = math.radians(15)
SIDES = {
    "front": ((0, 0, -1), (0, 1, 0)),
    "back": ((0, 0, 1), (0, 1, 0)),
    "right": ((-1, 0, 0), (0, 1, 0)),
    "left": ((1, 0, 0), (0, 1, 0)),
    "top": ((0, -1, 0), (0, 0, -1)),
    "bottom": ((0, 1, 0), (0, 0, 1)),
}
"""Where the camera looks and what is up in the picture. The front is where +z is, as in glTF."""
Cursor = tuple[float, float]


class Actions(EditActions):
    """The actions of a session, for its keys (controls.ACTIONS) and buttons."""

    def focus(self) -> None:
        """Frame what is picked, or all."""
        # Lights and cameras are points: a box around them shows what is near.
        reach = 0.1 * extent_of(self._session.scene)
        item: Any
        found = []
        for item in self._session.picked:
            if isinstance(item, Instance):
                found.append(transform_points(item.transform, item.posed_mesh().positions))
            elif hasattr(item, "position"):
                found.append(np.stack([item.position - reach, item.position + reach]))
        if found:
            points = np.concatenate(found)
            self._frame(points.min(axis=0), points.max(axis=0))
        else:
            self.focus_all()

    def focus_all(self) -> None:
        try:
            self._frame(*self._session.scene.bounds)
        except SolariError:  # there is nothing to see
            self._session.camera_control.focus_home()

    def _frame(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        area = self._session.layout.picture
        aspect = area.width / max(area.height, 1)
        self._session.camera_control.focus((low + high) / 2, float(np.linalg.norm(high - low)) / 2, aspect)

    def reset(self) -> None:
        self._session.camera_control.reset()
        self._session.pictures.cut()

    def look_from(self, side: str) -> None:
        """Look from one of SIDES at what is seen in the middle."""
        direction, up = SIDES[side]
        self._session.camera_control.look_along(direction, up)
        self._session.pictures.cut()
        self._session.say(f"view from the {side}")

    def orbit(self, turn: tuple[float, float]) -> None:
        """Go around what is seen in the middle: by so many steps of 15 degrees to the right and up."""
        control = self._session.camera_control
        # A drag to the left takes the camera to the right, one down takes it up.
        control.orbit(-turn[0] * ORBIT_STEP / TURN, turn[1] * ORBIT_STEP / TURN, control.center)

    def orthographic(self) -> None:
        is_orthographic = self._session.camera_control.toggle_orthographic()
        self._session.pictures.cut()
        self._session.say("orthographic view" if is_orthographic else "perspective view")

    def copy_pose(self) -> None:
        self._session.window.clipboard = self._session.camera_control.copy_pose()
        self._session.say("the camera's pose is in the clipboard")

    def paste_pose(self) -> None:
        self._session.camera_control.paste_pose(self._session.window.clipboard)
        self._session.pictures.cut()

    def camera(self, index: int) -> None:
        cameras = self._session.scene.cameras
        if index < len(cameras):
            self._session.camera_control.look_through(cameras[index])
            self._session.pictures.cut()
        else:
            self._session.say(f"there is no camera {index + 1}: the scene has {len(cameras)}")

    def next_mode(self) -> None:
        self._session.pictures.mode = _next(MODES, self._session.pictures.mode)

    def next_view(self, step: int = 1) -> None:
        pictures = self._session.pictures
        if pictures.mode == "reference":
            self._session.say("debug views are of realtime pictures alone: M changes the mode")
            return
        known = pictures.known_views
        view = pictures.view = _next(tuple(known), pictures.view, step)
        self._session.say(f"{view}: {known[view]}")

    def previous_view(self) -> None:
        self.next_view(-1)

    def next_tonemap(self) -> None:
        tonemap = self._session.pictures.tonemap = _next(TONEMAPS, self._session.pictures.tonemap)
        self._session.say(f"tone mapping: {tonemap}")

    def move_divider_right(self, step: float = DIVIDER_STEP) -> None:
        self._session.pictures.divider = min(max(self._session.pictures.divider + step, 0.0), 1.0)

    def move_divider_left(self) -> None:
        self.move_divider_right(-DIVIDER_STEP)

    def play(self) -> None:
        player = self._session.player
        if player.clip is None:
            self._session.say("the scene has no animations")
        else:
            player.playing = not player.playing

    def next_clip(self) -> None:
        player = self._session.player
        if player.clip is None:
            self._session.say("the scene has no animations")
            return
        player.choose((player.number + 1) % len(self._session.scene.animations))
        self._session.say(f"clip: {player.clip.name or player.number}")

    def brighter(self) -> None:
        self._session.camera_control.expose(EXPOSURE_STEP)

    def darker(self) -> None:
        self._session.camera_control.expose(-EXPOSURE_STEP)

    def help(self) -> None:
        self._session.shows_help = not self._session.shows_help
        # Without panels the terminal is the only place for a list.
        if self._session.shows_help and not self._session.has_panels:
            print("\n".join(f"{keys:>26}  {meaning}" for keys, meaning in KEYS_HELP), file=sys.stderr)

    def add_menu(self) -> None:
        """Open the menu of what can be added, at the cursor."""
        session = self._session
        session.opens_add_menu = session.has_panels and session.shows_panels
        if not session.opens_add_menu:
            session.say("the menu is a part of the panels: Tab shows them" if session.has_panels else NO_PANELS)

    def panels(self) -> None:
        self._session.shows_panels = not self._session.shows_panels

    def screenshot(self) -> None:
        # The path tracer may be within a sample: all rows get it, so that the picture is one of whole samples.
        self._session.pictures.complete()
        path = take_screenshot(self._session)
        left = "; edits, which it leaves out, are listed there" if edit_lines(self._session) else ""
        self._session.say(f"wrote {path}, with an .exr and the command line that renders it in a .txt{left}")

    def reload(self) -> None:
        # Shaders can always be read again; the file would replace edits that aren't saved.
        def go_on() -> None:
            self._session.reload(shaders=True, file=True)

        if self._session.has_file:
            self._ask_about_edits("load the file again", go_on)
        else:
            go_on()

    def fullscreen(self) -> None:
        self._session.window.toggle_fullscreen()

    def pick_all(self) -> None:
        """Pick all objects that are seen and not locked, and the lights and cameras that have a place."""
        session = self._session
        placed = [item for item in (*session.scene.cameras, *session.scene.lights) if hasattr(item, "position")]
        found = [*placed, *(instance for instance in session.scene.instances if instance.visible)]
        session.pick_only(item for item in found if item not in session.locked)
        session.say(f"{len(session.picked)} picked")

    def box(self, begun: Cursor | None = None) -> None:
        """Let the user drag a box around what is to be picked. begun: where the button was pressed already."""
        self._session.gesture = BoxGesture(self._session, begun)

    def pick(self, cursor: Cursor) -> None:
        """Pick what is at the cursor: a mark of a light or a camera, or else an instance."""
        self._pick(cursor, also=False)

    def pick_also(self, cursor: Cursor) -> None:
        """Add what is at the cursor to what is picked, or take it out."""
        self._pick(cursor, also=True)

    def _pick(self, cursor: Cursor, also: bool) -> None:
        session = self._session
        # Markers are drawn over the picture, so they are picked before what is behind them.
        marked = markers.marker_at(session, cursor)
        pick = None if marked else self._pick_at(cursor)
        item: Any = marked or (pick and pick.instance)
        if item is not None and item in session.locked:
            session.say(f"{item.describe()} is locked")
            return
        if also:
            if item is not None:
                session.pick_also(item)
                session.say(f"{len(session.picked)} picked")
            return
        session.pick = pick
        session.selected = item
        if pick is not None:
            point = ", ".join(f"{x:.4g}" for x in pick.point)
            session.say(f"{pick.instance.describe()} of {pick.instance.material.describe()} at ({point})")
        elif item is not None:
            session.say(item.describe())

    def grab(self, cursor: Cursor) -> NDArray[np.float64] | None:
        """The point to orbit around."""
        pick = self._pick_at(cursor)
        return None if pick is None else pick.point

    def _pick_at(self, cursor: Cursor) -> Pick | None:
        # Two scenes side by side have pictures of their own, of the same size.
        x, y = self._session.layout.picture.share(cursor)
        return pick_at(self._session.pictures_at(x), x, y)


def act(session: Session, name: str, argument: Any = None) -> Any:
    """Do the action of this name, with an argument if it takes one. A user's mistake is shown in the window."""
    asked = session.question
    arguments = () if argument is None else (argument,)
    try:
        with session.showing_mistakes():
            return getattr(Actions(session), name)(*arguments)
    finally:
        # Without panels a question is answered by doing the same action again; any other action withdraws it.
        if asked is session.question and not session.has_panels:
            session.question = None


def _next(names: tuple[str, ...], current: str, step: int = 1) -> str:
    at = names.index(current) if current in names else 0
    return names[(at + step) % len(names)]
