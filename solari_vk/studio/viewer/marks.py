"""Where lights and cameras, which pictures don't show, are marked in the window. Needs no panels library."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.model import Camera
from solari_vk.studio.viewer.layout import Area
from solari_vk.studio.viewer.session import Session

RADIUS = 9.0  # of a mark, in window coordinates at a text scale of 1


def project(camera: Camera, points: NDArray[np.float64], area: Area) -> NDArray[np.float64]:
    """Where points (N, 3) of the world are in the window, (N, 2); NaN for those that the camera doesn't see."""
    found = camera.project(points, (max(area.width, 1), max(area.height, 1))) + 0.5 + (area.x, area.y)
    return np.asarray(found, np.float64)


def marked(session: Session) -> list[tuple[Any, tuple[float, float]]]:
    """The lights and cameras that are marked, and where: those that have a place in the picture. None while the panels
    are hidden."""
    scene, area = session.scene, session.layout.picture
    if not (session.has_panels and session.shows_panels):
        return []
    near = 1e-3 * session.camera_control.distance
    eye = session.camera.transform[:3, 3]
    items = [item for item in (*scene.lights, *scene.cameras) if hasattr(item, "position")]
    items = [item for item in items if np.linalg.norm(item.position - eye) > near]  # such as the camera of the view
    if not items:
        return []
    places = project(session.camera, np.array([item.position for item in items], np.float64), area)
    return [(item, (float(x), float(y))) for item, (x, y) in zip(items, places, strict=True) if area.holds((x, y))]


def at(session: Session, cursor: tuple[float, float]) -> Any:
    """The light or camera whose mark is at the cursor, the nearest one to it; None if there is none."""
    reach = RADIUS * session.window.text_scale
    near = [(np.hypot(x - cursor[0], y - cursor[1]), number) for number, (_, (x, y)) in enumerate(marked(session))]
    distance, number = min(near, default=(np.inf, 0))
    return marked(session)[number][0] if distance <= reach else None
