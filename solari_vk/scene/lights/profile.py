"""Light profiles: how bright a luminaire is in each direction, as manufacturers' files say it (ANSI/IES LM-63)."""

from __future__ import annotations

import math
import os
import warnings
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.budget import charge, load_budget
from solari_vk.errors import SolariError
from solari_vk.files import read_regular

ROWS, COLUMNS = 361, 360
"""Of the table that the device has: vertical angles from 0 to 180 degrees, and horizontal angles below 360."""
LARGEST_FILE = 2**24  # bytes
_TYPES = {1: "C", 2: "B", 3: "A"}
_WHOLE_CIRCLE = {(0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0)}  # what type C's planes may span
_BYTES_PER_NUMBER = 120  # while it is read: the text's part, the number and its place in a list

FloatArray = NDArray[np.float64]


class LightProfile:
    """The luminous intensity of a luminaire in the directions that were measured; between them it is linear.

    vertical (V,), horizontal (H,): angles in degrees, rising. candelas (H, V): intensities in cd. photometry: what the
    angles mean. "C", of most luminaires: vertical is the angle from `PointLight.direction`, horizontal the angle around
    it, from `PointLight.horizontal` on. "A" and "B", of floodlights and headlamps: both angles are 0 in that direction,
    positive vertical angles turn towards `horizontal`, and positive horizontal ones clockwise. In A the vertical, in B
    the horizontal angle is from the plane in which the other one is measured. Planes that are left out because of
    symmetry (horizontal angles from 0 to 0, 90 or 180, or 90 to 270, of C; from 0 on, of A and B) are mirrored.
    Directions outside the given angles are dark. Raises SolariError if these numbers don't fit together.
    """

    def __init__(
        self, vertical: ArrayLike, horizontal: ArrayLike, candelas: ArrayLike, photometry: str = "C", *,
        name: str = "light profile",
    ) -> None:  # fmt: skip
        self.name, self.photometry = name, photometry
        if photometry not in _TYPES.values():
            self._refuse(f"photometry must be A, B or C, not {photometry!r}")
        self.vertical = self._angles(vertical, "vertical", (0, 180) if photometry == "C" else (-90, 90))
        self.horizontal = self._angles(horizontal, "horizontal", (0, 360) if photometry == "C" else (-90, 90))
        self.candelas = self._numbers(candelas, "candelas")
        if self.candelas.shape != (len(self.horizontal), len(self.vertical)):
            self._refuse(f"candelas have the shape {self.candelas.shape}, where the angles make "
                         f"{(len(self.horizontal), len(self.vertical))}")  # fmt: skip
        if not 0 <= self.candelas.min() <= self.candelas.max() <= 1e15:
            self._refuse("candelas must lie between 0 and 1e15")
        span = (float(self.horizontal[0]), float(self.horizontal[-1]))
        if photometry == "C" and span not in _WHOLE_CIRCLE:
            self._refuse(f"horizontal angles of type C must reach from 0 to 0, 90, 180 or 360, or from 90 to 270, not "
                         f"from {span[0]:g} to {span[1]:g}")  # fmt: skip

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> LightProfile:
        """The profile in a file. Raises SolariError naming the file for what isn't one."""
        file = Path(path)
        with load_budget():
            return cls.parse(read_regular(file, str(file), LARGEST_FILE + 1), str(file))

    @classmethod
    def parse(cls, data: bytes, name: str) -> LightProfile:
        """The profile in the text of a file; errors begin with `name`.

        Intensities are multiplied by the file's factors for all of them, of the ballast too. Factors for tilted lamps
        (TILT) aren't applied, which a warning says.
        """
        charge(_BYTES_PER_NUMBER * (data.count(b" ") + data.count(b"\n") + data.count(b",")), name, "its numbers")
        lines = data[: LARGEST_FILE + 1].decode("latin-1").splitlines()
        tilt = next((number for number, line in enumerate(lines) if line.lstrip().upper().startswith("TILT=")), None)
        if len(data) > LARGEST_FILE or tilt is None:
            raise SolariError(f"{name}: not a light profile: a file after IES LM-63 of at most 16 MiB has a line TILT=")
        numbers = _Numbers(" ".join(lines[tilt + 1 :]).replace(",", " ").split(), name)
        kind = lines[tilt].split("=", 1)[1].strip().upper()
        if kind == "INCLUDE":
            numbers.take(1)
            count = numbers.count("angles of tilt")
            numbers.take(2 * count)
        if kind != "NONE":
            warnings.warn(f"{name}: the light of tilted lamps differs (TILT), which isn't applied", stacklevel=3)
        _, _, factor = numbers.take(3)
        rows, columns, kind_of_angles = (numbers.count(what) for what in ("vertical", "horizontal", "photometry"))
        _, _, _, _, ballast, lamps, _ = numbers.take(7)
        vertical, horizontal = numbers.take(rows), numbers.take(columns)
        candelas = numbers.take(rows * columns).reshape(columns, rows) * (factor * ballast * lamps)
        return cls(vertical, horizontal, candelas, _TYPES.get(kind_of_angles, str(kind_of_angles)), name=name)

    @property
    def peak(self) -> float:
        """The largest intensity, in cd."""
        return float(self.candelas.max())

    @cached_property
    def shares(self) -> NDArray[np.float32]:
        """Intensities divided by the largest one, at vertical angles of C from 0 to 180 degrees, and horizontal ones of
        0, 1, ... 359 degrees (361, 360); (361, 1) if all planes are alike."""
        alike = self.photometry == "C" and len(self.horizontal) == 1
        vertical = np.linspace(0, math.pi, ROWS)[:, None]
        horizontal = np.radians(np.arange(1 if alike else COLUMNS))
        found: NDArray[np.float32] = (self._at(vertical, horizontal) / (self.peak or 1.0)).astype(np.float32)
        found.setflags(write=False)
        return found

    @cached_property
    def solid_angle(self) -> float:
        """The integral of intensities over all directions, divided by the largest one, in steradians."""
        polar = np.linspace(0, math.pi, ROWS)
        rings = self.shares.mean(axis=1, dtype=np.float64) * np.sin(polar)
        return float(2 * math.pi * np.trapezoid(rings, polar))

    def text(self) -> str:
        """The profile as a file after LM-63-2002."""
        def listed(values: FloatArray) -> str:
            words = [f"{value:.9g}" for value in values]
            return "\n".join(" ".join(words[at : at + 10]) for at in range(0, len(words), 10))

        kind = next(number for number, letter in _TYPES.items() if letter == self.photometry)
        head = f"1 -1 1 {len(self.vertical)} {len(self.horizontal)} {kind} 2 0 0 0\n1 1 0"
        parts = (listed(self.vertical), listed(self.horizontal), *map(listed, self.candelas))
        return "\n".join(("IESNA:LM-63-2002", "TILT=NONE", head, *parts, ""))

    def __repr__(self) -> str:
        return f"LightProfile({self.name!r}, {self.peak:g} cd)"

    def _at(self, vertical: Any, horizontal: Any) -> FloatArray:
        """The intensity in directions by their angles of type C, in radians, in cd."""
        if self.photometry == "C":
            return self._interpolated(*np.broadcast_arrays(np.degrees(vertical), self._plane(np.degrees(horizontal))))
        forward, up = np.cos(vertical), np.sin(vertical) * np.cos(horizontal)
        right = -np.sin(vertical) * np.sin(horizontal)
        if self.photometry == "B":
            angles = np.arctan2(up, forward), np.arcsin(np.clip(right, -1, 1))
        else:
            angles = np.arcsin(np.clip(up, -1, 1)), np.arctan2(right, forward)
        mirrored = (abs(angle) if given[0] == 0 else angle
                    for angle, given in zip(angles, (self.vertical, self.horizontal), strict=True))  # fmt: skip
        return self._interpolated(*np.broadcast_arrays(*map(np.degrees, mirrored)))

    def _plane(self, horizontal: Any) -> Any:
        """The measured plane that is like the one at an angle in degrees."""
        first, last = self.horizontal[0], self.horizontal[-1]
        if first == last:
            return np.full_like(horizontal, first)
        if first == 90:
            return np.where((horizontal < 90) | (horizontal > 270), (180 - horizontal) % 360, horizontal)
        folded = np.minimum(horizontal, 360 - horizontal) if last < 360 else horizontal
        return np.minimum(folded, 180 - folded) if last == 90 else folded

    def _interpolated(self, vertical: FloatArray, horizontal: FloatArray) -> FloatArray:
        """Between the four measured directions around; 0 outside."""
        row, along = _between(self.vertical, vertical)
        column, across = _between(self.horizontal, horizontal)
        table = np.pad(self.candelas, ((0, 1), (0, 1)), mode="edge")
        near, far = (table[column + at, row] * (1 - along) + table[column + at, row + 1] * along for at in (0, 1))
        inside = np.ones(vertical.shape, bool)
        for angles, given in ((vertical, self.vertical), (horizontal, self.horizontal)):
            inside &= (angles >= given[0] - 1e-6) & (angles <= given[-1] + 1e-6)
        return np.where(inside, near * (1 - across) + far * across, 0.0)

    def _numbers(self, values: ArrayLike, what: str) -> FloatArray:
        try:
            found = np.array(values, np.float64)
        except (TypeError, ValueError):
            self._refuse(f"{what} must be numbers")
        if found.size == 0 or not np.isfinite(found).all():
            self._refuse(f"{what} must be finite numbers, at least one")
        found.setflags(write=False)
        return found

    def _angles(self, values: ArrayLike, what: str, limits: tuple[int, int]) -> FloatArray:
        found = self._numbers(values, f"{what} angles")
        if found.ndim != 1 or (np.diff(found) <= 0).any() or not limits[0] <= found[0] <= found[-1] <= limits[1]:
            self._refuse(f"{what} angles must rise and lie between {limits[0]} and {limits[1]} degrees in type "
                         f"{self.photometry}")  # fmt: skip
        return found

    def _refuse(self, reason: str) -> NoReturn:
        raise SolariError(f"{self.name}: {reason}")


class _Numbers:
    """The numbers of a file, taken one after the other."""

    def __init__(self, words: list[str], name: str) -> None:
        self._words, self._name, self._at = words, name, 0

    def take(self, count: int) -> FloatArray:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise SolariError(f"{self._name}: ends early: {count - len(words)} further numbers are missing")
        self._at += count
        try:
            return np.array(words, np.float64)
        except ValueError:
            raise SolariError(f"{self._name}: has words where numbers belong, after TILT=") from None

    def count(self, what: str) -> int:
        [number] = self.take(1)
        if not (0 < number < 2**24 and number == int(number)):
            raise SolariError(f"{self._name}: the number for {what} must be a count of at least 1, not {number:g}")
        return int(number)


def _between(given: FloatArray, angles: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """For each angle the given one below, and the share of the way to the next."""
    at = np.clip(np.searchsorted(given, angles, side="right") - 1, 0, max(len(given) - 2, 0))
    step = np.append(np.diff(given), 1.0)[at]
    return at, np.clip((angles - given[at]) / step, 0, 1)
