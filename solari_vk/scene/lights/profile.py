"""Light profiles: how bright a luminaire is in each direction, as manufacturers' files say it (ANSI/IES LM-63)."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.budget import charge, load_budget
from solari_vk.base.errors import SolariError, checked_constructor, quoted, warn
from solari_vk.base.files import read_regular

ROWS, COLUMNS = 361, 360
"""Of the table that the device has: vertical angles from 0 to 180 degrees, and horizontal angles below 360."""
LARGEST_FILE = 2**24  # bytes
_TYPES = {1: "C", 2: "B", 3: "A"}
_WHOLE_CIRCLE = {(0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 360.0), (90.0, 270.0)}  # what type C's planes may span
_BYTES_PER_NUMBER = 120  # while it is read: the text's part, the number and its place in a list
_SEPARATORS = b" ,\t\n\v\f\r\x1c\x1d\x1e\x1f\x85\xa0"  # what `str.split` and `str.splitlines` part words at, and commas
_WITHOUT_PHOTOMETRIC_FACTOR = ("IESNA:LM-63-1995", "IESNA:LM-63-2002", "IES:LM-63-")  # first lines, the last of 2019
_STEP = 180 / (ROWS - 1)  # in degrees, between the table's vertical angles
_MOST_AROUND, _MOST_SAMPLES = 16, 256  # between two columns of the table, and between four entries
TILT_REMARK = "factors for tilted lamps (TILT) aren't applied"

FloatArray = NDArray[np.float64]


@checked_constructor
class LightProfile:
    """The luminous intensity of a luminaire in the directions that were measured; between them it is linear.

    vertical (V,), horizontal (H,): angles in degrees, rising. candelas (H, V): intensities in cd. photometry: what the
    angles mean. "C", of most luminaires: vertical is the angle from `PointLight.direction`, horizontal the angle around
    it, from `PointLight.horizontal` on. "A" and "B", of floodlights and headlamps: both angles are 0 in that direction,
    positive vertical angles turn towards `horizontal`, and positive horizontal ones clockwise. In A the vertical, in B
    the horizontal angle is from the plane in which the other one is measured. Planes that are left out because of
    symmetry (horizontal angles from 0 to 0, 90 or 180, or 90 to 270, of C; from 0 on, of A and B) are mirrored.
    Directions outside the measured angles are dark. Raises SolariError if these numbers don't fit together.

    The device has a table of it, every half degree of type C's vertical angles and every degree of its horizontal ones,
    between which it is linear. Where the measured angles are closer together, entries of the table are means, so that
    narrow beams keep their flux but are wider and less bright than measured: those of half a degree by a half degree.
    The edge of what is dark is as soft. A warning says where the measured angles are too close together even for means.
    """

    def __init__(
        self,
        vertical: ArrayLike,
        horizontal: ArrayLike,
        candelas: ArrayLike,
        photometry: str = "C",
        *,
        name: str = "light profile",
    ) -> None:
        self.name = name
        self.photometry = photometry
        if photometry not in _TYPES.values():
            self._refuse(f"photometry must be A, B or C, not {photometry!r}")
        self.vertical = self._angles(vertical, "vertical", (0, 180) if photometry == "C" else (-90, 90))
        self.horizontal = self._angles(horizontal, "horizontal", (0, 360) if photometry == "C" else (-90, 90))
        self.candelas = self._numbers(candelas, "candelas")
        if self.candelas.shape != (len(self.horizontal), len(self.vertical)):
            self._refuse(
                f"candelas have the shape {self.candelas.shape}, where the angles make "
                f"{(len(self.horizontal), len(self.vertical))}"
            )
        if not 0 <= self.candelas.min() <= self.candelas.max() <= 1e15:
            self._refuse("candelas must lie between 0 and 1e15")
        span = (float(self.horizontal[0]), float(self.horizontal[-1]))
        if photometry == "C" and span not in _WHOLE_CIRCLE:
            self._refuse(
                f"horizontal angles of type C must reach from 0 to 0, 90, 180 or 360, or from 90 to 270, not "
                f"from {span[0]:g} to {span[1]:g}"
            )

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> LightProfile:
        """The profile in a file. Raises SolariError naming the file for what isn't one."""
        file = Path(path)
        with load_budget():
            return cls.parse(read_regular(file, str(file), LARGEST_FILE + 1), str(file))

    @classmethod
    def parse(cls, data: bytes, name: str, remark: Callable[[str], None] | None = None) -> LightProfile:
        """The profile in the text of a file; errors begin with `name`.

        Intensities are multiplied by the file's factors for all of them: the multiplier, the ballast factor, and in
        files of 1986 and 1991 the ballast-lamp photometric factor, in whose place later ones have other numbers.
        Factors for tilted lamps (TILT) aren't applied: `remark` is called with words that say so, by default a warning.
        """
        charge(_BYTES_PER_NUMBER * (len(data) - len(data.translate(None, _SEPARATORS))), name, "its numbers")
        # LM-63: header lines, TILT=, and then numbers that may be broken into lines anywhere.
        lines = data[: LARGEST_FILE + 1].rstrip(b"\x1a").decode("latin-1").splitlines()  # DOS ends files by \x1a
        tilt = next((number for number, line in enumerate(lines) if line.lstrip().upper().startswith("TILT=")), None)
        if len(data) > LARGEST_FILE or tilt is None:
            raise SolariError(f"{name}: not a light profile: a file after IES LM-63 of at most 16 MiB has a line TILT=")
        numbers = _Numbers(" ".join(lines[tilt + 1 :]).replace(",", " ").split(), name)
        kind = lines[tilt].split("=", 1)[1].strip().upper()
        if kind == "INCLUDE":
            numbers.read(1)
            # The lamp's position, the number of angles, the angles, and a factor for each.
            count = numbers.count("angles of tilt")
            numbers.read(2 * count)
        if kind != "NONE":
            if remark is None:
                warn(f"{name}: {TILT_REMARK}")
            else:
                remark(TILT_REMARK)
        numbers.read(2)
        # After the number of lamps and their lumens.
        factor = numbers.factor("the multiplier")
        rows, columns = numbers.count("vertical angles"), numbers.count("horizontal angles")
        [photometry] = numbers.read(1)
        if photometry not in _TYPES:
            raise SolariError(f"{name}: the photometric type must be 1, 2 or 3 (C, B or A), not {photometry:g}")
        # The units and the sizes of the opening, which a point doesn't have.
        numbers.read(4)
        factor *= numbers.factor("the ballast factor")
        # In place of the photometric factor, later files have one that is reserved, or say how they were made.
        if lines[0].strip().upper().startswith(_WITHOUT_PHOTOMETRIC_FACTOR):
            numbers.read(1)
        else:
            factor *= numbers.factor("the ballast-lamp photometric factor")
        numbers.read(1)
        vertical, horizontal = numbers.read(rows), numbers.read(columns)
        # For each horizontal angle the candelas at all vertical ones.
        candelas = numbers.read(rows * columns).reshape(columns, rows) * factor
        return cls(vertical, horizontal, candelas, _TYPES[int(photometry)], name=name)

    @property
    def peak(self) -> float:
        """The largest intensity, in cd."""
        return float(self.candelas.max())

    @cached_property
    def shares(self) -> NDArray[np.float32]:
        """Intensities divided by the largest one, at vertical angles of C from 0 to 180 degrees, and horizontal ones of
        0, 1, ... 359 degrees (361, 360); (361, 1) if all planes are alike. Means where measured angles are closer."""
        table = self._rings(np.linspace(0, math.pi, ROWS))
        step = math.radians(_STEP)
        finest, around = self._fineness
        most = _MOST_SAMPLES * COLUMNS // (table.shape[1] * self._samples_around(1.0))
        if finest.min() < _STEP / most or around < 1 / _MOST_AROUND:
            warn(
                f"{self.name}: angles only {min(finest.min(), around):g} degrees apart are too close: narrow "
                "beams may lose light: leave angles out"
            )
        # A row is a mean if the measured angles are finer than the table on either side of it.
        fine = np.pad(np.isfinite(finest), 1)
        means = fine[:-1] | fine[1:]
        sums = np.zeros_like(table)
        weights = np.zeros((ROWS, 1))
        for gap in np.flatnonzero(means[:-1] | means[1:]):
            count = int(np.clip(np.ceil(4 * _STEP / finest[gap]), 8, most))
            along = (np.arange(count) + 0.5) / count
            # Each sample counts for both rows around it, as much as linear interpolation takes of them, by its ring's
            # area: the flux stays.
            light = self._rings((gap + along) * step)
            area = np.sin((gap + along) * step)
            for row, share in ((gap, (1 - along) * area), (gap + 1, along * area)):
                sums[row] += share @ light / count
                weights[row] += share.sum() / count
        table[means] = sums[means] / weights[means]
        found: NDArray[np.float32] = (table / (self.peak or 1.0)).astype(np.float32)
        found.setflags(write=False)
        return found

    @cached_property
    def solid_angle(self) -> float:
        """The integral of intensities over all directions, divided by the largest one, in steradians."""
        step = math.radians(_STEP)
        # The integral of sin(angle) times the hat function of each row, on which interpolation is linear.
        areas = np.sin(np.linspace(0, math.pi, ROWS)) * (2 - 2 * math.cos(step)) / step
        areas[[0, -1]] = 1 - math.sin(step) / step  # of each row, which counts up to the next ones
        return float(2 * math.pi * areas @ self.shares.mean(axis=1, dtype=np.float64))

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

    @cached_property
    def _fineness(self) -> tuple[FloatArray, float]:
        """The smallest step of measured angles between two rows of the table each (360,), and between its columns, in
        degrees; infinite where none is smaller than the table's."""
        finest = np.full(ROWS - 1, np.inf)
        steps = np.diff(self.vertical)
        around = float(np.diff(self.horizontal).min(initial=np.inf))
        if self.photometry == "C":
            fine = steps < _STEP * (1 - 1e-6)
            for gaps in (np.floor(self.vertical[:-1] / _STEP), np.ceil(self.vertical[1:] / _STEP) - 1):
                np.minimum.at(finest, gaps[fine].astype(int), steps[fine])
            return finest, around if around < 1 else math.inf
        around = min(around, float(steps.min(initial=np.inf)))
        around = around if around < _STEP else math.inf
        # Neither angle alone is the one from the axis; both together are no less than it.
        reach = abs(self.vertical).max() + abs(self.horizontal).max()  # beyond this polar angle it is dark
        finest[: min(math.ceil(reach / _STEP), ROWS // 2)] = around
        return finest, around

    def _samples_around(self, width: float) -> int:
        """How many directions make a mean between two columns, which are `width` degrees apart; 1: no mean."""
        return int(np.clip(math.ceil(4 * width / self._fineness[1]), 1, _MOST_AROUND))

    def _rings(self, polar: FloatArray) -> FloatArray:
        """The intensity at vertical angles of C (N,), in radians, for each column of the table (N, 360 or 1), in cd."""
        alike = self.photometry == "C" and len(self.horizontal) == 1
        count = self._samples_around(1.0 if self.photometry == "C" else float(np.sin(polar).max()))
        if count == 1:
            return self._at(polar[:, None], np.radians(np.arange(1 if alike else COLUMNS)))
        along = (np.arange(count) + 0.5) / count
        turns = np.radians(np.add.outer(np.arange(COLUMNS), along).ravel())
        light = self._at(polar[:, None], turns).reshape(len(polar), COLUMNS, count)
        return (light @ (1 - along) + np.roll(light @ along, 1, axis=1)) / count

    def _at(self, vertical: Any, horizontal: Any) -> FloatArray:
        """The intensity in directions by their angles of type C, in radians, in cd."""
        if self.photometry == "C":
            return self._interpolated(*np.broadcast_arrays(np.degrees(vertical), self._plane(np.degrees(horizontal))))
        # Types A and B: a direction by its parts along the two axes of the lamp and to the right.
        forward = np.cos(vertical)
        up = np.sin(vertical) * np.cos(horizontal)
        right = -np.sin(vertical) * np.sin(horizontal)
        if self.photometry == "B":
            angles = np.arctan2(up, forward), np.arcsin(np.clip(right, -1, 1))
        else:
            angles = np.arcsin(np.clip(up, -1, 1)), np.arctan2(right, forward)
        mirrored = (
            abs(angle) if measured[0] == 0 else angle
            for angle, measured in zip(angles, (self.vertical, self.horizontal), strict=True)
        )
        return self._interpolated(*np.broadcast_arrays(*map(np.degrees, mirrored)))

    def _plane(self, horizontal: Any) -> Any:
        """The measured plane that is like the one at an angle in degrees."""
        first, last = self.horizontal[0], self.horizontal[-1]
        if first == last:
            return np.full_like(horizontal, first)
        # LM-63: one half from 90 to 270 degrees, whose mirror is the plane from 90 to 270.
        if first == 90:
            return np.where((horizontal < 90) | (horizontal > 270), (180 - horizontal) % 360, horizontal)
        folded = np.minimum(horizontal, 360 - horizontal) if last < 360 else horizontal
        return np.minimum(folded, 180 - folded) if last == 90 else folded

    def _interpolated(self, vertical: FloatArray, horizontal: FloatArray) -> FloatArray:
        """Between the four measured directions around; 0 outside."""
        # Bilinear between the four measured directions around.
        row, along = _between(self.vertical, vertical)
        column, across = _between(self.horizontal, horizontal)
        below = np.minimum(row + 1, len(self.vertical) - 1)
        right = np.minimum(column + 1, len(self.horizontal) - 1)
        near, far = (self.candelas[at, row] * (1 - along) + self.candelas[at, below] * along for at in (column, right))
        inside = np.ones(vertical.shape, bool)
        for angles, measured in ((vertical, self.vertical), (horizontal, self.horizontal)):
            inside &= (angles >= measured[0] - 1e-6) & (angles <= measured[-1] + 1e-6)
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
            self._refuse(
                f"{what} angles must rise and lie between {limits[0]} and {limits[1]} degrees in type {self.photometry}"
            )
        return found

    def _refuse(self, reason: str) -> NoReturn:
        raise SolariError(f"{self.name}: {reason}")


class _Numbers:
    """The numbers of a file, read one after the other."""

    def __init__(self, words: list[str], name: str) -> None:
        self._words = words
        self._name = name
        self._at = 0

    def read(self, count: int) -> FloatArray:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise SolariError(f"{self._name}: ends early: {count - len(words)} further numbers are missing")
        self._at += count
        try:
            if not any("_" in word for word in words):  # Python reads 1_00 as 100
                return np.array(words, np.float64)
        except ValueError:
            pass
        wrong = next(word for word in words if not _is_number(word))
        raise SolariError(f"{self._name}: has the word {quoted(wrong)} where a number belongs, after TILT=")

    def count(self, what: str) -> int:
        [number] = self.read(1)
        if not (0 < number < 2**24 and number == int(number)):
            raise SolariError(f"{self._name}: the number of {what} must be a count of at least 1, not {number:g}")
        return int(number)

    def factor(self, what: str) -> float:
        [number] = self.read(1)
        if not 0 <= number < math.inf:
            raise SolariError(f"{self._name}: {what} must be a finite number of at least 0, not {number:g}")
        return float(number)


def _is_number(word: str) -> bool:
    try:
        return "_" not in word and float(word) is not None
    except ValueError:
        return False


def _between(measured: FloatArray, angles: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """For each angle the measured one below, and the share of the way to the next."""
    at = np.clip(np.searchsorted(measured, angles, side="right") - 1, 0, max(len(measured) - 2, 0))
    step = np.append(np.diff(measured), 1.0)[at]
    return at, np.clip((angles - measured[at]) / step, 0, 1)
