"""Where lights and cameras, which pictures don't show, are marked in the window. Needs no panels library."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.model import Camera
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.session import Session

# The same size on the screen at any distance, so that far lights can be picked.
RADIUS = 9.0  # of a marker, in window coordinates at a text scale of 1


def project(camera: Camera, points: NDArray[np.float64], area: Area) -> NDArray[np.float64]:
    """Where points (N, 3) of the world are in the window, (N, 2); NaN for those that the camera doesn't see."""
    # `Camera.project` counts from the first pixel's center, windows count from its corner.
    found = camera.project(points, (max(area.width, 1), max(area.height, 1))) + 0.5 + (area.x, area.y)
    return np.asarray(found, np.float64)


def visible_markers(session: Session) -> list[tuple[Any, tuple[float, float]]]:
    """The lights and cameras that are marked, and where: those that have a place in the picture. None while the panels
    are hidden."""
    scene = session.scene
    area = session.layout.picture
    if not (session.has_panels and session.shows_panels):
        return []
    # The scene's camera through which the user looks is in the eye: its marker would cover the picture's middle.
    near = 1e-3 * session.camera_control.distance
    eye = session.camera.transform[:3, 3]
    placed = [item for item in (*scene.lights, *scene.cameras) if hasattr(item, "position")]
    items = [item for item in placed if np.linalg.norm(item.position - eye) > near]
    if not items:
        return []
    places = project(session.camera, np.array([item.position for item in items], np.float64), area)
    return [(item, (float(x), float(y))) for item, (x, y) in zip(items, places, strict=True) if area.holds((x, y))]


def marker_at(session: Session, cursor: tuple[float, float]) -> Any:
    """The light or camera whose marker is at the cursor, the nearest one to it; None if there is none."""
    # Of markers that overlap the nearest one to the cursor counts, whatever is in front.
    shown = visible_markers(session)
    distances = [np.hypot(x - cursor[0], y - cursor[1]) for _, (x, y) in shown]
    if not distances:
        return None
    nearest = int(np.argmin(distances))
    return shown[nearest][0] if distances[nearest] <= RADIUS * session.window.text_scale else None
