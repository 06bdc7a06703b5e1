"""What keys and buttons do: `act` calls the function of an action's name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import DeviceError, SolariError, ValidationError
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.viewer.controls import KEYS_HELP
from solari_vk.viewer.picking import Pick, pick_at
from solari_vk.viewer.pictures import MODES
from solari_vk.viewer.screenshot import take_screenshot
from solari_vk.viewer.session import Session

DIVIDER_STEP = 0.02  # of the window's width
EXPOSURE_STEP = 1 / 3  # stops
Cursor = tuple[float, float]


def act(session: Session, name: str, argument: Any = None) -> Any:
    """Do one of controls.ACTIONS, or "camera", "pick" or "grab" with an argument; a mistake is shown in the window."""
    try:
        return _ACTIONS[name](session, *(() if argument is None else (argument,)))
    except (DeviceError, ValidationError):
        raise
    except (SolariError, OSError) as error:
        session.warn(str(error))
        return None


def _focus(session: Session) -> None:
    if session.pick is None:
        session.say("nothing is picked: click on something first")
        return
    instance = session.pick.instance
    corners = instance.mesh.positions @ instance.transform[:3, :3].T
    session.camera_control.focus(session.pick.point, float(np.linalg.norm(np.ptp(corners, axis=0))) / 2)


def _reset(session: Session) -> None:
    session.camera_control.reset()
    session.pictures.cut()


def _copy_pose(session: Session) -> None:
    session.window.clipboard = session.camera_control.copy_pose()
    session.say("the camera's pose is in the clipboard")


def _paste_pose(session: Session) -> None:
    session.camera_control.paste_pose(session.window.clipboard)
    session.pictures.cut()


def _camera(session: Session, index: int) -> None:
    cameras = list(session.scene.cameras)
    if index < len(cameras):
        session.camera_control.take(cameras[index])
        session.pictures.cut()
    else:
        session.say(f"there is no camera {index + 1}: the scene has {len(cameras)}")


def _next_mode(session: Session) -> None:
    session.pictures.mode = _next(MODES, session.pictures.mode)


def _show_view(step: int) -> Callable[[Session], None]:
    def show(session: Session) -> None:
        view = session.pictures.view = _next(tuple(DEBUG_VIEWS), session.pictures.view, step)
        session.say(f"{view}: {DEBUG_VIEWS[view]}")

    return show


def _next_tonemap(session: Session) -> None:
    session.pictures.tonemap = _next(TONEMAPS, session.pictures.tonemap)
    session.say(f"tone mapping: {session.pictures.tonemap}")


def _next(names: tuple[str, ...], current: str, step: int = 1) -> str:
    return names[(names.index(current) + step) % len(names)]


def _move_divider(step: float) -> Callable[[Session], None]:
    def move(session: Session) -> None:
        session.pictures.divider = min(max(session.pictures.divider + step, 0.0), 1.0)

    return move


def _help(session: Session) -> None:
    session.shows_help = not session.shows_help
    if session.shows_help and not session.has_panels:
        print("\n".join(f"{keys:>16}  {meaning}" for keys, meaning in KEYS_HELP), file=sys.stderr)


def _panels(session: Session) -> None:
    session.shows_panels = not session.shows_panels


def _screenshot(session: Session) -> None:
    path = take_screenshot(session)
    session.say(f"wrote {path}, with an .exr and the command line that renders it in a .txt")


def _close(session: Session) -> None:
    session.window.wants_to_close = True


def _pick(session: Session, cursor: Cursor) -> None:
    session.pick = _pick_at(session, cursor)
    if session.pick is not None:
        instance, point = session.pick.instance, ", ".join(f"{x:.4g}" for x in session.pick.point)
        session.say(f"{instance.describe()} of {instance.material.describe()} at ({point})")


def _grab(session: Session, cursor: Cursor) -> NDArray[np.float64] | None:
    """The point to orbit around."""
    pick = _pick_at(session, cursor)
    return None if pick is None else pick.point


def _pick_at(session: Session, cursor: Cursor) -> Pick | None:
    width, height = session.window.size
    return pick_at(session.pictures, cursor[0] / max(width, 1), cursor[1] / max(height, 1))


_ACTIONS: dict[str, Callable[..., Any]] = {
    "focus": _focus,
    "reset": _reset,
    "copy_pose": _copy_pose,
    "paste_pose": _paste_pose,
    "camera": _camera,
    "next_mode": _next_mode,
    "next_view": _show_view(1),
    "previous_view": _show_view(-1),
    "next_tonemap": _next_tonemap,
    "move_divider_left": _move_divider(-DIVIDER_STEP),
    "move_divider_right": _move_divider(DIVIDER_STEP),
    "brighter": lambda session: session.camera_control.expose(EXPOSURE_STEP),
    "darker": lambda session: session.camera_control.expose(-EXPOSURE_STEP),
    "help": _help,
    "panels": _panels,
    "screenshot": _screenshot,
    "reload": lambda session: session.reload(shaders=True, file=True),
    "fullscreen": lambda session: session.window.toggle_fullscreen(),
    "close": _close,
    "pick": _pick,
    "grab": _grab,
}
