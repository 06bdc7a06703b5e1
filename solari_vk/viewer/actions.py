"""What keys do, by the names of controls.ACTIONS."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import DeviceError, SolariError, ValidationError
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.display import VIEWS
from solari_vk.viewer.controls import KEYS_HELP
from solari_vk.viewer.pictures import MODES, Pick
from solari_vk.viewer.screenshot import take_screenshot

if TYPE_CHECKING:
    from solari_vk.viewer.app import Viewer


class Actions:
    """The actions on a viewer: a method `_act_NAME` each."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer

    def act(self, name: str, argument: Any) -> Any:
        """Do one; mistakes are told in the window."""
        try:
            return getattr(self, f"_act_{name}")(*(() if argument is None else (argument,)))
        except (DeviceError, ValidationError):
            raise
        except (SolariError, OSError) as error:
            self._viewer.warn(str(error))
            return None

    def _act_focus(self) -> None:
        if self._viewer.pick is None:
            self._viewer.say("nothing is picked: click on something first")
            return
        instance = self._viewer.pick.instance
        corners = instance.mesh.positions @ instance.transform[:3, :3].T
        self._viewer.camera_control.focus(self._viewer.pick.point, float(np.linalg.norm(np.ptp(corners, axis=0))) / 2)

    def _act_reset(self) -> None:
        self._viewer.camera_control.reset()
        self._viewer.pictures.cut()

    def _act_copy_pose(self) -> None:
        self._viewer.window.clipboard = self._viewer.camera_control.copy_pose()
        self._viewer.say("the camera's pose is in the clipboard")

    def _act_paste_pose(self) -> None:
        self._viewer.camera_control.paste_pose(self._viewer.window.clipboard)
        self._viewer.pictures.cut()

    def _act_camera(self, number: int) -> None:
        cameras = list(self._viewer.scene.cameras)
        if number < len(cameras):
            self._viewer.camera_control.take(cameras[number])
            self._viewer.pictures.cut()
        else:
            self._viewer.say(f"there is no camera {number + 1}: the scene has {len(cameras)}")

    def _act_next_mode(self) -> None:
        self._viewer.pictures.mode = MODES[(MODES.index(self._viewer.pictures.mode) + 1) % len(MODES)]

    def _act_next_view(self, step: int = 1) -> None:
        names = tuple(VIEWS)
        self._viewer.pictures.view = names[(names.index(self._viewer.pictures.view) + step) % len(names)]
        self._viewer.say(f"{self._viewer.pictures.view}: {VIEWS[self._viewer.pictures.view]}")

    def _act_previous_view(self) -> None:
        self._act_next_view(-1)

    def _act_next_tonemap(self) -> None:
        self._viewer.pictures.tonemap = TONEMAPS[(TONEMAPS.index(self._viewer.pictures.tonemap) + 1) % len(TONEMAPS)]
        self._viewer.say(f"tone mapping: {self._viewer.pictures.tonemap}")

    def _act_move_divider_left(self) -> None:
        self._viewer.pictures.divider = max(self._viewer.pictures.divider - 0.02, 0.0)

    def _act_move_divider_right(self) -> None:
        self._viewer.pictures.divider = min(self._viewer.pictures.divider + 0.02, 1.0)

    def _act_brighter(self) -> None:
        self._viewer.camera_control.expose(1 / 3)

    def _act_darker(self) -> None:
        self._viewer.camera_control.expose(-1 / 3)

    def _act_help(self) -> None:
        self._viewer.shows_help = not self._viewer.shows_help
        if self._viewer.shows_help and self._viewer.overlay is None:
            print("\n".join(f"{keys:>16}  {meaning}" for keys, meaning in KEYS_HELP), file=sys.stderr)

    def _act_overlay(self) -> None:
        self._viewer.shows_overlay = not self._viewer.shows_overlay

    def _act_screenshot(self) -> None:
        self._viewer.say(
            f"wrote {take_screenshot(self._viewer)}, with an .exr and the command line that renders it in a .txt"
        )

    def _act_reload(self) -> None:
        self._viewer.reload(shaders=True, file=True)

    def _act_fullscreen(self) -> None:
        self._viewer.window.toggle_fullscreen()

    def _act_close(self) -> None:
        self._viewer.window.wants_to_close = True

    def _act_pick(self, cursor: tuple[float, float]) -> None:
        self._viewer.pick = self._pick_at(cursor)
        if self._viewer.pick is not None:
            instance, point = self._viewer.pick.instance, ", ".join(f"{x:.4g}" for x in self._viewer.pick.point)
            self._viewer.say(f"{instance.describe()} of {instance.material.describe()} at ({point})")

    def _act_grab(self, cursor: tuple[float, float]) -> NDArray[np.float64] | None:
        pick = self._pick_at(cursor)
        return None if pick is None else pick.point

    def _pick_at(self, cursor: tuple[float, float]) -> Pick | None:
        width, height = self._viewer.window.size
        return self._viewer.pictures.pick(cursor[0] / max(width, 1), cursor[1] / max(height, 1))
