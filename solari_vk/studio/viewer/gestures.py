"""What keys begin and the mouse ends: moving, turning and scaling what is picked, and picking by a box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import glfw
import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.scene.matrices import transform_points, unit
from solari_vk.scene.placement import Scaled
from solari_vk.studio.viewer import markers
from solari_vk.studio.viewer.history import Edit
from solari_vk.studio.viewer.outline import shares_within
from solari_vk.studio.viewer.placing import move_to, pivot_of, transform_of
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.transforming import AXES, Cursor, Sight, Transforming
from solari_vk.studio.viewer.window import Event

KEYS = {glfw.KEY_G: "move", glfw.KEY_R: "turn", glfw.KEY_S: "scale"}
DOING = {"move": "moving", "turn": "turning", "scale": "scaling"}
ENTER = (glfw.KEY_ENTER, glfw.KEY_KP_ENTER)
SHIFTS = (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT)
CONTROLS = (glfw.KEY_LEFT_CONTROL, glfw.KEY_RIGHT_CONTROL)
LEFT, RIGHT = glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_RIGHT
# Hands tremble, and touch pads move at the end of a click.
CLICK = 3.0  # a button that is released before the cursor moves this far is a click, not a drag
LEAST_SHARE = 0.5  # of an object's pixels that a box holds which picks it


class TransformGesture:
    """Moves, turns or scales what is picked until Enter or a click; Esc or the right button leaves all as it was.

    kind: one of transforming.KINDS. items: objects that have a place. made: what was done already, such as adding them,
    which is a part of the edit. picked: what to pick if it is cancelled.
    """

    keys = "X Y Z: axis, with Shift the other two   0-9: how far   Ctrl: steps   Enter: keep   Esc: cancel"

    def __init__(
        self, session: Session, kind: str, items: Sequence[Any], made: Sequence[Edit] = (), picked: Sequence[Any] = ()
    ) -> None:
        self._session = session
        self._made = list(made)
        self._picked = list(picked)
        self._fine = False
        self._refusal = ""  # why the latest place was refused
        fallback = session.camera_control.center
        self._starts = []
        for item in items:
            start = transform_of(item, fallback)
            assert start is not None, "items have a place"
            self._starts.append((item, start, transform_points(start, pivot_of(item))))
        # The fields as they are, also where a transform wouldn't give them back to the last bit.
        self._before = [
            (item, {name: getattr(item, name) for name in move_to(item, start)}) for item, start, _ in self._starts
        ]
        pivot = np.mean([own for _, _, own in self._starts], axis=0)
        _, axes, _ = self._starts[-1]
        own_axes = unit(axes[:3, :3].T).T
        self.transforming = Transforming(
            kind, Sight(session.camera, session.layout.picture), pivot, own_axes, session.cursor
        )

    @property
    def text(self) -> str:
        return self.transforming.text

    def handle(self, event: Event) -> None:
        """Use an event; a release of a button, which began before, changes nothing."""
        transforming = self.transforming
        match event.kind:
            case "key":
                self._key(event)
            case "button" if event.pressed and event.code == LEFT:
                self.keep()
                return
            case "button" if event.pressed and event.code == RIGHT:
                self.cancel()
                return
            case "cursor":
                transforming.move_cursor((event.x, event.y), self._fine)
            case "text":
                character = chr(event.code)
                if character.upper() in AXES:
                    transforming.constrain(AXES.index(character.upper()), plane=character.isupper())
                else:
                    transforming.type(character)
        if self._session.gesture is self:
            self._apply()

    def _key(self, event: Event) -> None:
        transforming = self.transforming
        if event.code in SHIFTS:
            self._fine = event.pressed
        elif event.code in CONTROLS:
            transforming.snaps = event.pressed
        elif not event.pressed:
            return
        elif event.code in ENTER:
            self.keep()
        elif event.code == glfw.KEY_ESCAPE:
            self.cancel()
        elif event.code == glfw.KEY_BACKSPACE:
            transforming.erase()
        elif event.code == glfw.KEY_TAB:
            transforming.next_number()
        elif event.code in KEYS and not event.modifiers:
            transforming.begin(KEYS[event.code])

    def _apply(self) -> None:
        """Place the objects as it is said now; a place that they refuse is shown as a message."""
        values = []
        for item, start, own_pivot in self._starts:
            placed = self.transforming.place(start, own_pivot)
            if self.transforming.kind == "scale" and not isinstance(item, Scaled):
                placed[:3, :3] = start[:3, :3]  # lights and cameras have a place, but no size
            values.append((item, move_to(item, placed)))
        # A number may be refused only until its last digit is typed, as the first one of 0.5.
        if self._session.message == self._refusal:
            self._session.message = ""
        self._refusal = ""
        try:
            self._session.history.try_out(values)
        except SolariError as error:
            self._refusal = str(error)
            self._session.warn(self._refusal)

    def keep(self) -> None:
        """End it: what it did is one edit."""
        self._session.gesture = None
        changed = [(item, fields) for item, fields in self._before if not _has(item, fields)]
        if changed or self._made:
            what = changed[0][0].describe() if len(changed) == 1 else f"{len(self._starts)} objects"
            done = "duplicating" if self._made else DOING[self.transforming.kind]
            self._session.history.keep(f"{done} {what}", changed, self._made)

    def cancel(self) -> None:
        """End it: all is as it was."""
        session = self._session
        session.gesture = None
        session.history.try_out(self._before)
        for edit in reversed(self._made):
            edit.undo()
        if self._made:
            session.pick_only(self._picked)


class BoxGesture:
    """Picks the objects, lights and cameras in a rectangle that the user drags; with Shift also what was picked.

    begun: where the button was pressed already.
    """

    text = "drag a box around what is to be picked"
    keys = "Shift: also what is picked   Esc: cancel"

    def __init__(self, session: Session, begun: Cursor | None = None) -> None:
        self._session = session
        self._begun = begun
        self._end = session.cursor

    @property
    def corners(self) -> tuple[Cursor, Cursor] | None:
        """The least and the largest x and y of the box in the window, None until it begins."""
        if self._begun is None:
            return None
        (x, y), (right, down) = self._begun, self._end
        return (min(x, right), min(y, down)), (max(x, right), max(y, down))

    def handle(self, event: Event) -> None:
        """Use an event."""
        is_escape = event.kind == "key" and event.code == glfw.KEY_ESCAPE
        if event.pressed and (is_escape or (event.kind == "button" and event.code == RIGHT)):
            self.cancel()
        elif event.kind == "cursor":
            self._end = event.x, event.y
        elif event.kind == "button" and event.code == LEFT and event.pressed:
            self._begun = self._end
        elif event.kind == "button" and event.code == LEFT and self._begun is not None:
            self.cancel()
            if self._is_large:
                self._pick(also=bool(event.modifiers & glfw.MOD_SHIFT))

    @property
    def _is_large(self) -> bool:
        """Whether it was dragged: a click alone picks nothing."""
        assert self._begun is not None
        return max(abs(self._end[0] - self._begun[0]), abs(self._end[1] - self._begun[1])) >= CLICK

    def cancel(self) -> None:
        """End it: what was picked is picked."""
        self._session.gesture = None

    def _pick(self, also: bool) -> None:
        session = self._session
        assert self.corners is not None
        (left, top), (right, bottom) = self.corners
        area = session.layout.picture
        found: list[Any] = [
            item for item, (x, y) in markers.visible_markers(session) if left <= x <= right and top <= y <= bottom
        ]
        shares = shares_within(session.pictures, area.share((left, top)), area.share((right, bottom)))
        found += [instance for instance, share in shares.items() if share >= LEAST_SHARE]
        before = session.picked if also else []
        session.pick_only([*before, *(item for item in found if item not in session.locked and item not in before)])
        session.say(f"{len(session.picked)} picked")


def _has(item: Any, fields: dict[str, Any]) -> bool:
    return all(np.array_equal(getattr(item, name), value) for name, value in fields.items())
