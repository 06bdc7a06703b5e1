"""Motion vectors of sequences: their conventions, what cameras say in place of them, and whether they are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.output.sequences.resample import nearest, pixel_grid

Floats = NDArray[np.float32]
DIRECTIONS = ("to-previous", "from-previous", "to-next", "from-next")
AXES = ("y-down", "y-up")
UNITS = ("pixels", "uv", "ndc")

_PAIRS = 6  # of frames that are compared
_CLEARLY = 0.75  # of the error of the given convention: another one that has less is the right one
_MOVES = 0.25  # pixels: below it nothing can be said about motion


@dataclass(frozen=True)
class Convention:
    """What motion vectors mean.

    direction: where a vector leads: from a pixel "to-previous", where its surface was in the frame before;
    "from-previous" is the negative of it, "to-next" where it will be, "from-next" the negative. axis: whether y points
    down or up. unit: pixels, uv (1 is the picture's width or height) or ndc (2 is).
    """

    direction: str = "to-previous"
    axis: str = "y-down"
    unit: str = "pixels"

    @staticmethod
    def parse(text: str) -> Convention:
        """The convention of words with commas, such as "to-previous,y-up"; what isn't said is the default."""
        if not isinstance(text, str):
            raise SolariError(f"convention {quoted(text)}: give words with commas, such as 'to-previous,y-up'")
        values = {}
        for word in text.split(","):
            field = next(
                (name for name, known in zip(_FIELDS, (DIRECTIONS, AXES, UNITS), strict=True) if word in known), None
            )
            if field is None or field in values:
                known = "; ".join(" or ".join(names) for names in (DIRECTIONS, AXES, UNITS))
                raise SolariError(f"convention {quoted(text)}: give words with commas, at most one each of {known}")
            values[field] = word
        return Convention(**values)

    def __str__(self) -> str:
        return f"{self.direction},{self.axis},{self.unit}"

    def offsets(self, vectors: Floats) -> Floats:
        """Motion (height, width, 2) as offsets in pixels, x to the right and y down, to where the surface was or is."""
        height, width = vectors.shape[:2]
        scale = {"pixels": (1, 1), "uv": (width, height), "ndc": (width / 2, height / 2)}[self.unit]
        sign = -1 if self.direction.startswith("from") else 1
        up = -1 if self.axis == "y-up" else 1
        return vectors * np.array([sign * scale[0], sign * up * scale[1]], np.float32)

    @property
    def leads_to_next(self) -> bool:
        """Whether vectors are about the next frame, not the previous one."""
        return self.direction.endswith("next")

    def of_second_pair(self, turned: bool = False) -> Convention:
        """That of the second of two pairs, which is about the other neighbor. turned: whether it has the other sign."""
        turn, _, frame = self.direction.partition("-")
        turn = {"to": "from", "from": "to"}[turn] if turned else turn
        return Convention(f"{turn}-{'next' if frame == 'previous' else 'previous'}", self.axis, self.unit)

    def flipped(self, x: int, y: int) -> Convention:
        """The convention by which x and y have the factors 1 or -1 beside this one."""
        turn, _, frame = self.direction.partition("-")
        direction = f"{'from' if (turn == 'to') == (x < 0) else 'to'}-{frame}" if x < 0 else self.direction
        # The direction flips both axes.
        flips_y = (y < 0) != (x < 0)
        axis = AXES[1 - AXES.index(self.axis)] if flips_y else self.axis
        return Convention(direction, axis, self.unit)


_FIELDS = ("direction", "axis", "unit")
OWN = Convention(unit="uv")
"""Of this package's layer guides_motion."""
BLENDER = Convention("to-previous", "y-up")
"""Of the first two channels of Blender's pass Vector. The other two are about the next frame, with the other sign."""


def inverted(offsets: Floats) -> Floats:
    """From offsets of a frame to its neighbor, those of the neighbor to the frame.

    A fixed-point iteration, as in Chen et al., "A simple fixed-point approach to invert a deformation field" (2008).
    Where a surface is hidden in the other frame the result is wrong, as the tests of surfaces find.
    """
    grid = pixel_grid(*offsets.shape[:2])
    found = np.zeros_like(offsets)
    for _ in range(4):
        found = -nearest(offsets, grid + found)
    return found


def from_cameras(position: Floats, camera: NDArray[np.float64], weight: Floats | float = 1.0) -> Floats:
    """Offsets in pixels to where resting surfaces are in another frame.

    position: (height, width, 3), of the world. weight: 1, and (height, width, 1) 0 where `position` is a
    direction to what is infinitely far. camera: the other frame's matrix (3, 4), from (x, y, z, 1) to (column,
    row, 1) times the depth, in pixels whose centers are at half numbers.
    """
    shown = position @ camera[:, :3].T + weight * camera[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = shown[..., :2] / shown[..., 2:]
    # What is behind the camera is outside of the picture.
    pixels = np.where((shown[..., 2:] > 0) & np.isfinite(pixels), pixels, -1e6)
    return np.asarray(pixels - 0.5 - pixel_grid(*position.shape[:2]), np.float32)


def position_of_depth(depth: Floats, camera: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Positions (height, width, 3) from depths along the camera's axis and its matrix, and weights, as of
    `from_cameras`: where the depth is 0 or infinite nothing is near. Raises SolariError for a camera without
    perspective."""
    if np.linalg.matrix_rank(camera[:, :3]) < 3:
        raise SolariError("denoise: cameras without perspective (singular matrices) need positions, not depths")
    is_near = np.isfinite(depth) & (depth != 0)
    weight = is_near[..., None].astype(np.float32)
    grid = pixel_grid(*depth.shape) + 0.5
    shown = np.concatenate([grid, np.ones_like(grid[..., :1])], axis=-1) * np.where(is_near, depth, 1)[..., None]
    return np.asarray((shown - weight * camera[:, 3]) @ np.linalg.inv(camera[:, :3]).T, np.float32), weight


def check_direction(
    pairs: Sequence[tuple[Floats, Floats, Floats]], convention: Convention, who: str, *, second: bool = False
) -> None:
    """Raise SolariError if motion vectors lead to the right place with another sign, and don't as they are.

    pairs: of some frames, what is compared (height, width, n), the same of the neighbor that the vectors lead to, and
    the offsets in pixels. Each sign of x and y is tried, and the differences between a pixel and the place it came from
    are compared. second: whether the vectors are the second pair, beside one that is right.
    """
    flips = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    errors = np.zeros(4)
    moved = 0
    for here, there, offsets in pairs[:_PAIRS]:
        grid = pixel_grid(*offsets.shape[:2])
        limits = np.array(offsets.shape[1::-1]) - 1
        places = [grid + offsets * np.array(flip, np.float32) for flip in flips]
        # Pixels that all signs leave in the picture, and that move enough to tell.
        inside = np.all([((place >= 0) & (place <= limits)).all(axis=-1) for place in places], axis=0)
        inside &= np.abs(offsets).max(axis=-1) > _MOVES
        moved += int(inside.sum())
        scale = np.percentile(np.abs(here), 95, axis=(0, 1)) + 1e-6
        for index, place in enumerate(places):
            difference = np.abs(nearest(there, place) - here) / scale
            # Differences count up to a limit, since surfaces that come into view differ whatever the sign.
            errors[index] += float(np.minimum(difference, 0.1)[inside].sum())
    best = int(errors.argmin())
    if moved < 64 or not errors[best] < _CLEARLY * errors[0]:
        return
    right = convention.flipped(*flips[best])
    if second:
        which = "motion vectors of the second pair (of the other neighbor)"
        advice = "the first pair is right, only the second one has the other sign: write it with the sign it is read by"
    else:
        which = "motion vectors"
        advice = f"give convention='{right}' (--convention {right}), or write them so"
    raise SolariError(
        f"{who}: {which} point the wrong way: read as '{convention}' they lead to other surfaces (mean "
        f"difference {errors[0] / moved:.3f}, with the signs of '{right}' {errors[best] / moved:.3f}): {advice}"
    )
