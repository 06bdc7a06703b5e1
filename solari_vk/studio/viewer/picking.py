"""What the viewer's picture shows: the instance and the point of a pixel, and the distance of what is in the middle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera, Instance
from solari_vk.studio.viewer.pictures import Pictures


@dataclass(frozen=True)
class Pick:
    """An instance, and the point (x, y, z) of it that was picked, in world space."""

    instance: Instance
    point: NDArray[np.float64]


def pick_at(pictures: Pictures, x: float, y: float) -> Pick | None:
    """What the latest picture shows at (x, y), both from 0 to 1 from its top left corner; None for the background."""
    camera = pictures.camera
    if not pictures.ready or camera is None or not (0 <= x < 1 and 0 <= y < 1):
        return None
    if pictures.mode == "reference":
        assert pictures.reference is not None
        tracer = pictures.reference.tracer
        width, height = tracer.size
        pixel = int(y * height), int(x * width)
        index, point = tracer["instance_id"][pixel], tracer["position"][pixel]
    else:
        assert pictures.realtime is not None
        # The G-buffer has near / distance along the view axis, and 0 for the background.
        depths = pictures.realtime["gbuffer_depth"][..., 0]
        height, width = depths.shape
        row, column = int(y * height), int(x * width)
        if not depths[row, column]:
            return None
        index = pictures.realtime["gbuffer_surface"][row, column, 1]
        point = point_at(camera, (width, height), (column + 0.5, row + 0.5), camera.near / float(depths[row, column]))
    instance = pictures.binder.instances.get(int(index)) if index != NO_INDEX else None
    return None if instance is None else Pick(instance, np.asarray(point, np.float64))


def radiance_at(pictures: Pictures, x: float, y: float) -> NDArray[np.float32] | None:
    """The radiance (3,) in cd/m^2 at (x, y), both from 0 to 1 from the picture's top left corner; None outside, and
    before there is a picture. Of pictures side by side, that of the one which is seen there."""
    if not pictures.ready or not (0 <= x < 1 and 0 <= y < 1):
        return None
    seen = next((name for name, (begin, end) in pictures.columns().items() if begin <= x < end), "reference")
    if seen == "reference":
        assert pictures.reference is not None
        return pictures.reference.probe(x, y)
    assert pictures.realtime is not None
    if not pictures.realtime.has_frame:
        return None
    radiance = pictures.realtime["raw_radiance" if seen == "raw" else "radiance"]
    found: NDArray[np.float32] = radiance[int(y * len(radiance)), int(x * len(radiance[0])), :3]
    return found


def seen_distance(pictures: Pictures) -> float | None:
    """The distance in meters along the view axis to what fills the middle third of the latest picture: the median.

    None for the background. Waits for the picture.
    """
    camera = pictures.camera
    if not pictures.ready or camera is None:
        return None
    if pictures.mode == "reference":
        assert pictures.reference is not None
        return _middle(pictures.reference.tracer["depth"])
    assert pictures.realtime is not None
    return realtime_distance(pictures.realtime, camera)


def realtime_distance(renderer: Renderer, camera: Camera) -> float | None:
    """As `seen_distance`, in the latest frame of a renderer, which had this camera."""
    with np.errstate(divide="ignore"):  # the background, 0, is infinitely far away
        return _middle(camera.near / renderer["gbuffer_depth"][..., 0])


def _middle(depth: NDArray[np.floating[Any]]) -> float | None:
    # The median doesn't mind a fence or a window frame before what the user looks at.
    height, width = depth.shape
    distance = float(np.median(depth[height // 3 : height - height // 3, width // 3 : width - width // 3]))
    return distance if np.isfinite(distance) else None


def point_at(
    camera: Camera, size: tuple[int, int], pixel: tuple[float, float], view_depth: float
) -> NDArray[np.float64]:
    """The point in world space behind a position in pixels, `view_depth` meters along the view axis, of wide lenses
    along the ray."""
    return camera.unproject((pixel[0] - 0.5, pixel[1] - 0.5), view_depth, size)
