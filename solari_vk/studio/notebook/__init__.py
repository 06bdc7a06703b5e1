"""An interactive picture in a notebook: `show`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from solari_vk.base.errors import SolariError, quoted
from solari_vk.renderers.renderer import Renderer

if TYPE_CHECKING:
    from solari_vk.studio.notebook.widget import LivePicture


def show(renderer: Renderer) -> LivePicture:
    """A widget that shows the renderer's picture in Jupyter, and a camera that the mouse moves.

    Dragging orbits around what the middle of the first picture shows, with Shift it pans; the wheel zooms, and a double
    click returns to the first view, which is that of the scene's camera. Frames are rendered while the camera moves and
    until the picture has settled, between the cells that run; an error is shown over the picture. A widget that is
    closed, or whose output is cleared, renders nothing more. Close the widget before the renderer.

    Needs the extra `notebook` of the package. Raises SolariError where it is missing, and for anything that isn't a
    Renderer.
    """
    if not isinstance(renderer, Renderer):
        raise SolariError(f"notebook.show: the renderer must be a solari_vk.Renderer, not {quoted(renderer)}")
    try:
        from solari_vk.studio.notebook.widget import LivePicture
    except ImportError as error:
        raise SolariError(
            f"notebook.show needs a library that isn't installed ({error}): install it by "
            "\"pip install 'solari-vk[notebook]'\""
        ) from None
    return LivePicture(renderer)
