"""Moving, turning and scaling by the cursor, axes and typed numbers, with the keys of Blender. Needs no window."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import rotation, unit
from solari_vk.studio.viewer.layout import Area

Vector = NDArray[np.float64]
Cursor = tuple[float, float]
KINDS = ("move", "turn", "scale")
AXES = "XYZ"
FINE = 0.1  # share of the cursor's movement that counts while it is to be precise
ANGLE_STEP = math.radians(5)
FACTOR_STEP = 0.1
STEPS_HIGH = 10.0  # steps of a movement in the picture's height, at least
GRAZING = 0.05  # sine of the smallest angle between a ray and the line or plane that it is to hit
STEEP = 0.15  # sine of the angle between an axis and the view, below which the axis is seen as a point
SMALLEST_FACTOR = 1e-3  # that the cursor gives
LONGEST_NUMBER = 16  # characters


@dataclass(frozen=True)
class Sight:
    """How the user sees the scene: by a camera, in a part of the window."""

    camera: Camera
    area: Area

    def ray(self, cursor: Cursor, distance: float) -> tuple[Vector, Vector]:
        """A point of the ray through the cursor, this far from the camera, and the ray's unit direction."""
        pixel = cursor[0] - self.area.x - 0.5, cursor[1] - self.area.y - 0.5
        size = max(self.area.width, 1), max(self.area.height, 1)
        near, far = (self.camera.unproject(pixel, depth, size) for depth in (0.5 * distance, distance))
        return far, unit(far - near)

    def project(self, point: Vector) -> Vector:
        """Where a point (3,) is in the window, (2,); NaN if the camera doesn't see it."""
        size = max(self.area.width, 1), max(self.area.height, 1)
        found: Vector = self.camera.project(point[None], size)[0] + 0.5 + (self.area.x, self.area.y)
        return found

    def depth(self, point: Vector) -> float:
        """How far a point is before the camera, along its view axis."""
        return float((self.camera.transform[:3, 3] - point) @ self.back)

    @property
    def back(self) -> Vector:
        """The unit direction from what is seen to the camera."""
        return unit(self.camera.transform[:3, 2])


class Transforming:
    """A transform about `pivot` that isn't decided yet: its `kind`, its axes, and how far.

    own_axes (3, 3): columns are the unit axes of the object itself. cursor: where the mouse is at the start. The cursor
    says how far until a number is typed, and again once all of its characters are erased.
    """

    def __init__(self, kind: str, sight: Sight, pivot: ArrayLike, own_axes: ArrayLike, cursor: Cursor) -> None:
        self.sight = sight
        self.pivot = np.asarray(pivot, np.float64)
        self.own_axes = np.asarray(own_axes, np.float64)
        self.snaps = False
        """Whether the cursor moves in steps."""
        self._start = self._at = self._cursor = np.asarray(cursor, np.float64)
        self.begin(kind)

    def begin(self, kind: str) -> None:
        """Do another of KINDS instead, from the start."""
        self.kind = kind
        self.axis: int | None = None
        """The number of the axis that is chosen, None for all."""
        self.is_plane = False
        """Whether the axis is the one that stays as it is."""
        self.is_own = False
        """Whether axes are the object's, not the world's."""
        self.numbers = [""]
        """What is typed."""
        self._start = self._at = self._cursor
        self._angle = 0.0  # by which the cursor went around the pivot, counter-clockwise
        self._vector = np.zeros(3)  # by which the cursor moves

    # ---- input --------------------------------------------------------------------------------------

    def constrain(self, axis: int, plane: bool = False) -> None:
        """Choose an axis of the world, or with `plane` the other two. Again: the object's own, and then none."""
        if (self.axis, self.is_plane) != (axis, plane):
            self.axis, self.is_plane = axis, plane
            # What is scaled along other axes than its own would be sheared.
            self.is_own = self.kind == "scale"
        elif not self.is_own:
            self.is_own = True
        else:
            self.axis = None
            self.is_plane = self.is_own = False
        self.numbers = self.numbers[: self._number_count]
        self._vector = np.zeros(3)

    @property
    def _number_count(self) -> int:
        """How many numbers can be typed."""
        if self.kind == "turn" or (self.axis is not None and not self.is_plane):
            return 1
        return 3 if self.axis is None else 2

    def move_cursor(self, cursor: Cursor, fine: bool = False) -> None:
        """Follow the cursor; fine: by a tenth of its way."""
        before = self._at
        self._at = before + (np.asarray(cursor) - self._cursor) * (FINE if fine else 1.0)
        self._cursor = np.asarray(cursor, np.float64)
        # A full turn of the cursor is a full turn, so the angle grows by differences, each below half a turn.
        turned = self._heading(self._at) - self._heading(before)
        if math.isfinite(turned):
            self._angle += (turned + math.pi) % (2 * math.pi) - math.pi

    def _heading(self, cursor: Vector) -> float:
        """The angle in the window from the pivot to a place, counter-clockwise."""
        right, down = cursor - self.sight.project(self.pivot)
        return math.atan2(-down, right)

    def type(self, character: str) -> bool:
        """Take a character of a number; returns whether it is one. "-" changes the sign wherever it is typed."""
        text = self.numbers[-1]
        if character == "-":
            text = text[1:] if text.startswith("-") else f"-{text}"
        elif character in ".,":
            text += "" if "." in text else "."
        elif character in "0123456789":
            text += character
        else:
            return False
        if len(text) <= LONGEST_NUMBER:
            self.numbers[-1] = text
        return True

    def erase(self) -> None:
        """Take the last character back."""
        if not self.numbers[-1] and len(self.numbers) > 1:
            self.numbers.pop()
        self.numbers[-1] = self.numbers[-1][:-1]

    def next_number(self) -> None:
        """Type the number of the next axis."""
        if len(self.numbers) < self._number_count:
            self.numbers.append("")

    # ---- how far ------------------------------------------------------------------------------------

    @property
    def is_typed(self) -> bool:
        """Whether numbers say how far, and not the cursor."""
        return any(self.numbers)

    @property
    def axes(self) -> Vector:
        """The axes in use, as columns (3, 3)."""
        return self.own_axes if self.is_own else np.eye(3)

    @property
    def _chosen(self) -> list[int]:
        """The numbers of the axes along which something changes."""
        if self.axis is None:
            return [0, 1, 2]
        return [number for number in range(3) if (number == self.axis) != self.is_plane]

    def _typed(self) -> list[float]:
        # Until there is a digit, nothing changes but the sign of a factor.
        nothing = 1.0 if self.kind == "scale" else 0.0
        return [
            float(text) if any(map(str.isdigit, text)) else math.copysign(nothing, -1 if text[:1] == "-" else 1)
            for text in self.numbers
        ]

    @property
    def vector(self) -> Vector:
        """The movement (3,) in the world, in meters."""
        parts = np.zeros(3)
        if self.is_typed:
            typed = self._typed()
            parts[self._chosen[: len(typed)]] = typed
        else:
            parts = self.axes.T @ self._dragged()
            if self.snaps:
                step = self._step
                parts = np.round(parts / step) * step
        found: Vector = self.axes @ parts
        return found

    @property
    def _step(self) -> float:
        """A power of ten in meters: a hundredth to a tenth of the picture's height where the pivot is."""
        x, y = map(float, self._start)
        points = [self.sight.ray((x, y + down), self._depth)[0] for down in (0, self.sight.area.height)]
        shown = max(float(np.linalg.norm(points[1] - points[0])), 1e-9)
        return float(10.0 ** math.floor(math.log10(shown / STEPS_HIGH)))

    @property
    def _center(self) -> Cursor:
        """Where the pivot is in the window."""
        x, y = self.sight.project(self.pivot)
        return float(x), float(y)

    @property
    def _depth(self) -> float:
        return max(self.sight.depth(self.pivot), 1e-6)

    def _dragged(self) -> Vector:
        """The way (3,) from where the cursor began, along the chosen axes; the latest one where the cursor points to
        no place on them."""
        start, end = self._hit(self._start), self._hit(self._at)
        if start is not None and end is not None:
            self._vector = end - start
        return self._vector

    def _hit(self, cursor: Vector) -> Vector | None:
        """The point under the cursor on the line or plane through the pivot, or the nearest one; None without one."""
        point, direction = self.sight.ray((float(cursor[0]), float(cursor[1])), self._depth)
        if self.axis is not None and not self.is_plane:
            return self._nearest_on_line(self.axes[:, self.axis], point, direction)
        normal = self.sight.back if self.axis is None else self.axes[:, self.axis]
        slope = float(direction @ normal)
        if abs(slope) < GRAZING:
            return None
        found: Vector = point + direction * float((self.pivot - point) @ normal) / slope
        return found if self.sight.depth(found) > 0 else None

    def _nearest_on_line(self, along: Vector, point: Vector, direction: Vector) -> Vector | None:
        """The point of the line through the pivot that is nearest to a ray."""
        # Whether the axis points along the view is asked at the pivot: the answer is the same wherever the cursor is.
        _, view = self.sight.ray(self._center, self._depth)
        if 1 - float(along @ view) ** 2 < STEEP**2:
            # Then up in the picture is away from the camera.
            up = unit(self.sight.camera.transform[:3, 1])
            found: Vector = self.pivot + along * math.copysign(1.0, float(along @ view)) * float(
                (point - self.pivot) @ up
            )
            return found
        cosine = float(along @ direction)
        sine_squared = max(1 - cosine**2, GRAZING**2)
        apart = self.pivot - point
        found = self.pivot + along * (float(apart @ direction) * cosine - float(apart @ along)) / sine_squared
        return found if self.sight.depth(found) > 0 else None

    @property
    def angle(self) -> float:
        """By how much it turns about `turn_axis`, in radians."""
        if self.is_typed:
            return math.radians(self._typed()[0])
        # What turns about an axis that points away from the camera goes round the other way in the window.
        angle = self._angle if self.turn_axis @ self.sight.back >= 0 else -self._angle
        return round(angle / ANGLE_STEP) * ANGLE_STEP if self.snaps else angle

    @property
    def turn_axis(self) -> Vector:
        """The unit axis (3,) of a turn, by default from what is seen to the camera."""
        return self.sight.back if self.axis is None else self.axes[:, self.axis]

    @property
    def factors(self) -> Vector:
        """By how much it scales along `axes`, (3,)."""
        found = np.ones(3)
        if len(self.numbers) > 1:
            typed = self._typed()
            found[self._chosen[: len(typed)]] = typed
        elif self.is_typed:
            found[self._chosen] = self._typed()[0]
        else:
            center = self.sight.project(self.pivot)
            factor = float(np.linalg.norm(self._at - center)) / max(float(np.linalg.norm(self._start - center)), 1.0)
            if self.snaps:
                factor = round(factor / FACTOR_STEP) * FACTOR_STEP
            if math.isfinite(factor):
                found[self._chosen] = max(factor, SMALLEST_FACTOR)
        return found

    # ---- results ------------------------------------------------------------------------------------

    def place(self, start: Vector, own_pivot: Vector) -> Vector:
        """Where an object goes whose transform (4, 4) was `start`, and its own pivot (3,) at `own_pivot`."""
        made = start.copy()
        if self.kind == "move":
            made[:3, 3] += self.vector
            return made
        if self.kind == "turn":
            turn = rotation(self.turn_axis, self.angle)
            made[:3, :3] = turn @ start[:3, :3]
            made[:3, 3] = self.pivot + turn @ (start[:3, 3] - self.pivot)
            return made
        # Each object is scaled along its own axes, so that none is sheared, and its own pivot goes where the axes in
        # use say.
        factors = self.factors
        made[:3, :3] = start[:3, :3] * factors
        goal = self.pivot + self.axes @ (factors * (self.axes.T @ (own_pivot - self.pivot)))
        inside = np.linalg.solve(start[:3, :3], own_pivot - start[:3, 3])
        made[:3, 3] = goal - made[:3, :3] @ inside
        return made

    def guides(self) -> list[tuple[int, Vector, Vector]]:
        """The chosen axes through the pivot: their numbers, and two places (2,) in the window on each."""
        if self.axis is None:
            return []
        numbers = [self.axis] if self.kind == "turn" else self._chosen
        found = []
        for number in numbers:
            # Short of the camera, beyond which nothing is seen.
            way = 0.4 * self._depth * self.axes[:, number]
            ends = [self.sight.project(self.pivot + sign * way) for sign in (-1, 1)]
            found.append((number, ends[0], ends[1]))
        return found

    @property
    def text(self) -> str:
        """What is done and how far, for the user."""
        return f"{self.kind} {self._amount}{self._along}"

    @property
    def _amount(self) -> str:
        unit_of = {"move": " m", "turn": "\N{DEGREE SIGN}", "scale": ""}[self.kind]
        if self.is_typed:
            return ", ".join(f"[{text}]" for text in self.numbers) + unit_of
        if self.kind == "turn":
            return f"{math.degrees(self.angle):.1f}{unit_of}"
        if self.kind == "scale":
            return f"by {self.factors[self._chosen[0]]:.3f}"
        parts = self.axes.T @ self.vector
        return ", ".join(f"{parts[number]:.4g}" for number in self._chosen) + unit_of

    @property
    def _along(self) -> str:
        if self.axis is None:
            return ""
        whose = "its own " if self.is_own else ""
        if self.kind == "turn":
            return f" about {whose}{AXES[self.axis]}"
        return f" along {whose}{' and '.join(AXES[number] for number in self._chosen)}"
