"""The surfaces that a camera would see along rays, in order: back faces of single-sided materials aren't among them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.renderers.ray_tracer import Hits, RayTracer
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.model import Camera

STEP = np.float32(1 + 2**-20)  # from one surface to the next: two that are closer, relative to the distance, are one
SELF_OCCLUSION = 1e-4  # of the distance: a surface that is so little before a point is the point's own
Floats = NDArray[np.float64]


def check_view(who: str, tracer: RayTracer, camera: Camera, size: tuple[int, int]) -> None:
    """Raise SolariError for what is no tracer, no camera or no size."""
    for argument, kind in ((tracer, RayTracer), (camera, Camera)):
        if not isinstance(argument, kind):
            raise SolariError(f"{who}: a {kind.__name__} is needed, not {quoted(argument)}")
    camera.rays((0, 0), size)  # refuses what is no size


def pixel_grid(size: tuple[int, int]) -> Floats:
    """The centers of all pixels of a picture, row by row, (N, 2) as `Camera.rays` takes them."""
    rows, columns = np.divmod(np.arange(size[0] * size[1]), size[0])
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def is_inside(pixels: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether positions (N, 2) are in a picture, whose first pixel's center is (0, 0)."""
    return np.asarray(((pixels >= -0.5) & (pixels < np.array(size) - 0.5)).all(axis=-1))


def behind(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Where rays go on behind hits at distances t (N)."""
    # Near zero the step is smaller than what float32 resolves: then it is the next number.
    begins: NDArray[np.float32] = np.maximum(t * STEP, np.nextafter(t, np.float32(np.inf)))
    return begins


def peel(
    tracer: RayTracer,
    origins: Floats,
    directions: Floats,
    t_min: ArrayLike,
    t_max: ArrayLike = np.inf,
    *,
    first: bool = False,
) -> Iterator[tuple[NDArray[np.int64], Hits]]:
    """The surfaces along rays (N, 3), nearest first: each step gives the numbers of the rays that met one, and hits.

    first: a ray ends at its first surface.
    """
    count = len(origins)
    start = np.array(np.broadcast_to(t_min, count), np.float32)
    end = np.array(np.broadcast_to(t_max, count), np.float32)
    # Pixels of a fisheye picture outside its circle have no direction.
    active = np.flatnonzero(np.isfinite(directions).all(axis=-1))
    step = 0
    hides_back = np.zeros(0, np.bool_)
    while len(active):
        # Each step has a seed of its own, because blended surfaces are hit with the probability alpha.
        hits = tracer.trace(
            origins[active], directions[active], t_min=start[active], t_max=end[active], seed=step & 0xFFFFFFFF
        )
        there = hits.instance >= 0
        active, hits = active[there], hits[there]
        start[active] = behind(hits.t)
        if step == 0:
            hides_back = tracer.hides_back  # only now: the first trace applied the scene's edits
        seen = hits.front_face | ~hides_back[hits.instance]
        yield active[seen], hits[seen]
        if first:
            active = active[~seen]
        step += 1


def first_surfaces(
    tracer: RayTracer, origins: Floats, directions: Floats, t_min: ArrayLike, t_max: ArrayLike = np.inf
) -> tuple[NDArray[np.int64], Hits | None]:
    """The rays that meet a surface that a camera sees, and the nearest hit of each; None if no ray does."""
    parts = list(peel(tracer, origins, directions, t_min, t_max, first=True))
    if not parts:
        return np.zeros(0, np.int64), None
    rays, hits = zip(*parts, strict=True)
    return np.concatenate(rays), np.concatenate(hits).view(Hits)


def is_blocked(
    tracer: RayTracer, camera: Camera, points: Floats, pixels: Floats, size: tuple[int, int], tolerance: ArrayLike
) -> NDArray[np.bool_]:
    """Whether a surface hides points (N, 3), which are seen at pixels (N, 2), from a camera.

    tolerance (N): how far before a point, in meters, a surface counts as its own.
    """
    origins, directions, starts = pixel_rays(camera, pixels, size)
    distance = np.einsum("ni,ni->n", points - origins, directions)
    hidden, _ = first_surfaces(tracer, origins, directions, starts, distance - tolerance)
    blocked = np.zeros(len(points), np.bool_)
    blocked[hidden] = True
    return blocked
