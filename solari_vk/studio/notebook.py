"""An interactive picture in a notebook: `show`. widget.js is its part in the page."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from solari_vk.base.errors import SolariError, quoted
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.studio.browser.picture import PICTURE_JS, encoded, error_text, move
from solari_vk.studio.viewer.camera_control import CameraControl, extent_of
from solari_vk.studio.viewer.picking import realtime_distance

# The package imports without the extra `notebook`; `show` then says what is missing.
_missing = ""
try:
    from anywidget import AnyWidget
except ImportError as error:
    AnyWidget = object
    _missing = str(error)

ENOUGH_FRAMES = 32  # frames after which the picture of a still camera is shown without loss, and rendering ends


def show(renderer: Renderer) -> LivePicture:
    """A widget that shows the renderer's picture in Jupyter, and a camera that the mouse moves.

    Dragging orbits around what the middle of the first picture shows, with Shift it pans; the wheel zooms, and a double
    click returns to the first view, which is that of the scene's camera. Frames are rendered while the camera moves and
    until the picture is finished, between the cells that run; an error is shown over the picture. A widget that is
    closed, or whose output is cleared, renders nothing more. Close the widget before the renderer.

    Needs the extra `notebook` of the package. Raises SolariError where it is missing, and for anything that isn't a
    Renderer.
    """
    if not isinstance(renderer, Renderer):
        raise SolariError(f"notebook.show: the renderer must be a solari_vk.Renderer, not {quoted(renderer)}")
    if _missing:
        raise SolariError(
            f"notebook.show needs a library that isn't installed ({_missing}): install it by "
            "\"pip install 'solari-vk[notebook]'\""
        )
    return LivePicture(renderer)


class LivePicture(AnyWidget):  # type: ignore[misc]
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
        self._knows_distance = False  # whether the control knows how far away the middle of the picture is
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
        # Ctrl-C in a notebook arrives here too. Without an answer the page would wait for ever and show nothing new.
        try:
            answer, content = self._next_frame(request)
        except (Exception, KeyboardInterrupt) as error:
            answer = {"error": error_text(error)}
            content = []
        self.send({"page": request.get("page"), **answer}, content)

    def _next_frame(self, movement: dict[str, Any]) -> tuple[dict[str, Any], list[bytes]]:
        """Move the camera and render; returns what the page is told about the frame, and the encoded picture."""
        if move(self._control, movement):
            self._frames = 0
        frame = self._renderer.render(self._control.camera)
        if not self._knows_distance:
            self._control.see(realtime_distance(self._renderer, frame.camera))
            self._knows_distance = True
        self._frames += 1
        # The page stops asking for frames once one is finished.
        finished = self._frames >= ENOUGH_FRAMES
        kind = "png" if finished else "jpeg"  # a moving picture hides JPEG's loss, a still one would not
        codes = frame["display"][..., :3]
        return {"type": f"image/{kind}", "finished": finished}, [encoded(codes, kind)]
