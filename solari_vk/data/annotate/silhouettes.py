"""Silhouettes of instances: what of them is seen, and what would be seen if nothing were before them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.data.annotate.surfaces import check_view, peel, pixel_grid
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.model import Camera, Instance
from solari_vk.scene.objects import objects_of

Mask = NDArray[np.bool_]
Runs = NDArray[np.int32]
Box = tuple[int, int, int, int]


class Silhouette(NamedTuple):
    """The pixels of an instance, at their centers."""

    mask: Mask
    """Those that would show it if nothing were before it, (height, width): the amodal mask."""
    visible: Mask
    """Those that show it, (height, width)."""
    pixel_count: int
    """The number of pixels of the whole silhouette, with those around the picture."""
    box: Box
    """The smallest box around the whole silhouette: left column, top row, width, height. It may begin below 0."""

    @property
    def fraction(self) -> float:
        """The share of the whole silhouette that is seen, in [0, 1]."""
        return int(self.visible.sum()) / max(self.pixel_count, 1)


@checked_keywords(who="solari_vk")
def silhouettes(
    tracer: RayTracer, camera: Camera, size: tuple[int, int], *, around: float = 0.0, merge: bool = False
) -> dict[Instance, Silhouette]:
    """The silhouette of each instance that the camera would see if nothing were before it.

    size: of the picture, (width, height). around: how far the whole silhouettes reach beyond the picture's edges, in
    shares of its size; 1 as in BOP, for perspective and orthographic cameras without distortion. merge: parts of one
    object (`Instance.part_of`) with one label have one silhouette, that of the first. Rays pass on through
    every surface, so that a pixel costs as many rays as there are surfaces behind it. Blended surfaces count with the
    probability alpha. Rays hit an instance's ray_mesh where it has one. Raises SolariError for another `around`.
    """
    runs, ids = trace_silhouettes(tracer, camera, size, around=around)
    seen = {number: tracer.instances[number] for number in np.unique(runs[:, 0]).tolist()}
    labels = {number: instance.label for number, instance in seen.items()}
    objects = objects_of(seen, labels, merge=merge)
    masks = {number: np.isin(ids, parts) for number, parts in objects.items()}
    found = read_runs(merge_runs(runs, objects), masks)
    return {tracer.instances[number]: silhouette for number, silhouette in found.items()}


def trace_silhouettes(
    tracer: RayTracer, camera: Camera, size: tuple[int, int], *, around: float = 0.0
) -> tuple[Runs, NDArray[np.int64]]:
    """The whole silhouettes as runs of pixels (N, 4): instance, first column, row, length; and the instance that each
    pixel shows, (height, width), -1 for none. Arguments and errors are those of `silhouettes`."""
    check_view("silhouettes", tracer, camera, size)
    if not 0 <= around <= 8 or (around and camera.has_lens):
        raise SolariError(
            f"silhouettes: around is from 0 to 8, and 0 for a lens that isn't a pinhole, not {quoted(around)}"
        )
    width, height = size
    left, top = round(around * width), round(around * height)
    shape = height + 2 * top, width + 2 * left
    pixels = pixel_grid((shape[1], shape[0])) - (left, top)
    places = [np.zeros(0, np.int64)]
    ids = np.full(len(pixels), -1)
    for rays, hits in peel(tracer, *pixel_rays(camera, pixels, size)):
        # One number for an instance and a pixel, which np.unique then sorts: an instance with several surfaces along a
        # ray counts once.
        places.append(hits.instance.astype(np.int64) * len(pixels) + rays)
        # Surfaces come nearest first, so the first one is what the pixel shows.
        ids[rays] = np.where(ids[rays] < 0, hits.instance, ids[rays])
    runs = _runs(np.concatenate(places), shape, (-left, -top))
    return runs, ids.reshape(shape)[top : top + height, left : left + width]


def _runs(places: NDArray[np.int64], shape: tuple[int, int], corner: tuple[int, int]) -> Runs:
    """Runs of pixels from numbers of instances, times the number of pixels, plus a pixel's number in an area of this
    shape, whose first column and row are `corner`."""
    places = np.unique(places)
    # A run ends where the next pixel doesn't follow, or a row ends.
    begins = np.flatnonzero((np.diff(places, prepend=-2) != 1) | (places % shape[1] == 0))
    number, pixel = np.divmod(places[begins], shape[0] * shape[1])
    row, column = np.divmod(pixel, shape[1])
    lengths = np.diff(begins, append=len(places))
    return np.stack([number, column + corner[0], row + corner[1], lengths], axis=1).astype(np.int32)


def merge_runs(runs: Runs, objects: Mapping[int, Sequence[int]]) -> Runs:
    """The runs of objects from those of their parts. objects: the numbers of each one's parts, by its own."""
    whole = {part: number for number, parts in objects.items() for part in parts if len(parts) > 1}
    is_part = np.isin(runs[:, 0], list(whole))
    parts, others = runs[is_part].astype(np.int64), runs[~is_part]
    if not len(parts):
        return others
    # Runs of parts may overlap, so they are expanded to pixels (index: the run of each) and made anew.
    index = np.repeat(np.arange(len(parts)), parts[:, 3])
    begins = np.cumsum(parts[:, 3]) - parts[:, 3]
    number = np.array([whole[part] for part in parts[:, 0].tolist()])[index]
    column, row = parts[index, 1] + np.arange(len(index)) - begins[index], parts[index, 2]
    left, top = int(column.min()), int(row.min())
    shape = int(row.max()) - top + 1, int(column.max()) - left + 1
    places = (number * shape[0] + row - top) * shape[1] + column - left
    return np.concatenate([others, _runs(places, shape, (left, top))])


def read_runs(runs: Runs, visible: dict[int, Mask]) -> dict[int, Silhouette]:
    """Silhouettes by instance's number from runs (N, 4). visible: the masks (height, width) of what pictures show."""
    found = {}
    ordered = runs[np.argsort(runs[:, 0], kind="stable")]
    for number, seen in visible.items():
        begin, end = np.searchsorted(ordered[:, 0], (number, number + 1))
        own_runs = ordered[begin:end]
        mask = np.zeros_like(seen)
        for _, x, y, length in own_runs.tolist():
            if 0 <= y < len(mask):
                mask[y, max(x, 0) : max(x + length, 0)] = True
        # At edges the renderer of the masks may see a pixel more than the rays: a run of one pixel each.
        row, column = np.nonzero(seen & ~mask)
        extra = np.stack([0 * row, column, row, 0 * row + 1], axis=1)
        all_runs = np.concatenate([own_runs, extra])
        found[number] = Silhouette(mask | seen, seen, int(all_runs[:, 3].sum()), _box_of(all_runs))
    return found


def _box_of(runs: Runs) -> Box:
    """The smallest box around runs: left column, top row, width, height."""
    if not len(runs):
        return 0, 0, 0, 0
    left, top = runs[:, 1:3].min(axis=0).tolist()
    right = int((runs[:, 1] + runs[:, 3]).max())
    bottom = int(runs[:, 2].max()) + 1
    return left, top, right - left, bottom - top
