"""The panel of what surrounds the scene: a sky, a studio or a picture of all directions, and how it is turned."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from imgui_bundle import imgui

from solari_vk.scene.lights.environment import Environment
from solari_vk.scene.lights.sky import Sky
from solari_vk.scene.matrices import rotation
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.opening import maps_in
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.widgets import drag, hint

UP = (0.0, 1.0, 0.0)


class EnvironmentPanel:
    """Lays out the surroundings of a session's scene."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._maps: list[str] = []
        self._listed: Path | None = None  # the folder whose maps are listed

    def lay_out(self) -> None:
        """Lay out the choice and the fields of what is chosen."""
        session = self._session
        environment = self._session.scene.environment
        for kind in ("none", "studio", "sky"):
            if imgui.button(kind):
                act(session, "surround", kind)
            imgui.same_line()
        self._choose_map()
        if environment is None:
            imgui.text_disabled("nothing surrounds the scene")
            return
        name = environment.name or type(environment).__name__.lower()
        imgui.text(name)
        changed, intensity = drag("intensity", float(environment.intensity), 0.0, 1e6)
        if changed:
            session.edit(environment, intensity=intensity)
        if isinstance(environment, Sky):
            self._sky(environment)
        elif isinstance(environment, Environment):
            turn = environment.rotation
            angle = math.degrees(math.atan2(turn[0, 2], turn[0, 0]))
            changed, degrees = imgui.slider_float("rotation", angle, -180, 180, "%.0f deg")
            if changed:
                # The slider shows the turn about the vertical axis; what else the rotation has is kept.
                tilt = rotation(UP, -math.radians(angle)) @ turn
                session.edit(environment, rotation=rotation(UP, math.radians(degrees)) @ tilt)
            height, width = environment.image.shape[:2]
            imgui.text_disabled(f"{width} x {height}, drop an .hdr or .exr file to switch")

    def _choose_map(self) -> None:
        session = self._session
        folder = session.map_folder or (Path(session.source).resolve().parent if session.source else Path.cwd())
        # The folder is read once and not in each frame.
        if folder != self._listed:
            self._listed = folder
            self._maps = maps_in(folder)
        if not self._maps:
            imgui.new_line()
            return
        names = [Path(path).name for path in self._maps]
        environment = session.scene.environment
        current = names.index(environment.name) if environment and environment.name in names else -1
        imgui.set_next_item_width(-1)
        changed, number = imgui.combo("##map", current, names)
        hint(f"The .hdr and .exr files of {folder}.")
        if changed:
            act(session, "surround", self._maps[number])

    def _sky(self, sky: Sky) -> None:
        x, y, z = map(float, sky.sun_direction)
        height = math.degrees(math.asin(min(max(y, -1.0), 1.0)))
        heading = math.degrees(math.atan2(x, z))
        raised, height = imgui.slider_float("sun height", height, -10, 90, "%.0f deg")
        turned, heading = imgui.slider_float("sun heading", heading, -180, 180, "%.0f deg")
        if raised or turned:
            # At 90 degrees a sun has no heading, which the slider would then lose.
            up, around = math.radians(min(height, 89.9)), math.radians(heading)
            across = math.cos(up)
            sun = np.array((across * math.sin(around), math.sin(up), across * math.cos(around)), np.float32)
            self._session.edit(sky, sun_direction=sun)
        changed, turbidity = imgui.slider_float("turbidity", sky.turbidity, 1, 10, "%.1f")
        hint("1 is clean air, 2 to 3 a clear day, 6 haze.")
        if changed:
            self._session.edit(sky, turbidity=turbidity)
