"""The Python side of the picture in a notebook; widget.js is the side of the page."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import anywidget

from solari_vk.base.errors import SolariError
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.studio.browser.picture import PICTURE_JS, encoded, move
from solari_vk.studio.viewer.camera_control import CameraControl, extent_of
from solari_vk.studio.viewer.picking import realtime_distance

SETTLED = 32  # frames after which the picture of a still camera is shown without loss, and rendering ends


class LivePicture(anywidget.AnyWidget):  # type: ignore[misc]
    """A renderer's picture that follows the mouse.

    The page asks for a frame, with the movements since its last request, once it has shown the frame before. So a slow
    device or line only lowers the rate, and nothing is rendered for a page that is gone. Requests are answered in the
    thread that runs cells, between two cells, so the renderer is never used by two threads.
    """

    _esm = "\n".join(path.read_text(encoding="utf-8") for path in (PICTURE_JS, Path(__file__).with_name("widget.js")))

    def __init__(self, renderer: Renderer) -> None:
        super().__init__()
        self._renderer = renderer
        scene = renderer.binder.scene
        self._control = CameraControl(scene.camera_for(renderer.size[0] / renderer.size[1]), extent_of(scene))
        self._has_seen = False
        self._frames = 0  # since the last movement
        self.on_msg(self._answer)

    @property
    def camera(self) -> Camera:
        """A copy of the camera as it is now, for `renderer.render(camera)` and `camera.pose()`."""
        return dataclasses.replace(self._control.camera)

    def refresh(self) -> None:
        """Show the scene and the settings as they are now, after an edit. A movement does the same."""
        self._frames = 0
        self.send({"refresh": True})

    def _answer(self, _: Any, request: dict[str, Any], __: Any) -> None:
        """Move the camera as a page asks, and send the next frame, or why there is none.

        request: the page's name as "page", and the movement of picture.py.
        """
        if self.comm is None:
            return  # closed while the request was on its way
        try:
            if move(self._control, request):
                self._frames = 0
            frame = self._renderer.render(self._control.camera)
            if not self._has_seen:
                self._control.see(realtime_distance(self._renderer, frame.camera))
                self._has_seen = True
            codes = frame["display"][..., :3]
            self._frames += 1
            settled = self._frames >= SETTLED
            kind = "png" if settled else "jpeg"
            answer, content = {"type": f"image/{kind}", "settled": settled}, [encoded(codes, kind)]
        except (Exception, KeyboardInterrupt) as error:
            words = str(error) if isinstance(error, SolariError) else f"{type(error).__name__}: {error}"
            answer, content = {"error": words}, []
        self.send({"page": request.get("page"), **answer}, content)
