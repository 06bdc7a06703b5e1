"""The frames of a sequence, one at a time: from EXR files or from arrays."""

from __future__ import annotations

import hashlib
import itertools
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.host_array import host_array
from solari_vk.output.sequences.layers import Layers, find_layers, read_channels
from solari_vk.output.sequences.motion import BLENDER, OWN, Convention, check_direction, from_cameras, position_of_depth

Floats = NDArray[np.float32]
_CHECKED_PAIRS = 6
_NUMBERS = re.compile(r"\d+")
_HOLES = re.compile(r"%\d*d|#+")


@dataclass
class Frame:
    """The layers of a frame, (height, width, 3) or (height, width); None are missing.

    motion and motion_next: offsets in pixels (height, width, 2), x to the right and y down, to the previous and the
    next frame.
    """

    color: Floats
    alpha: Floats | None = None
    albedo: Floats | None = None
    normal: Floats | None = None
    depth: Floats | None = None
    position: Floats | None = None
    motion: Floats | None = None
    motion_next: Floats | None = None


class Source(ABC):
    """Frames by index."""

    names: Sequence[str]
    conventions: tuple[Convention, Convention]
    """Of the first pair of motion vectors and of the second, which is about the other neighbor."""

    @abstractmethod
    def read(self, index: int) -> Frame:
        """A frame, checked. Raises SolariError for one that can't be used."""


class ArraySource(Source):
    """Frames in arrays (frames, height, width, n)."""

    def __init__(self, arrays: Mapping[str, Any], convention: Convention) -> None:
        """Raises SolariError for wrong shapes."""
        self.conventions = (convention, convention.of_second_pair())
        self._arrays: dict[str, NDArray[Any]] = {}
        shape: tuple[int, ...] = ()
        for name, values in arrays.items():
            if values is None:
                continue
            try:
                array = host_array(values)
                number = np.issubdtype(array.dtype, np.floating)
            except (TypeError, ValueError):
                number = False
            if not number:
                raise SolariError(f"denoise: {name} must be an array of floating-point numbers, linear, not sRGB codes")
            shape = shape or array.shape[:3]
            widths = {"depth": ((),), "motion": ((2,), (4,))}.get(name, ((3,),))
            if array.ndim < 3 or 0 in array.shape or array.shape[:3] != shape or array.shape[3:] not in widths:
                ends = " or ".join(str((*("frames", "height", "width"), *width)) for width in widths).replace("'", "")
                raise SolariError(f"denoise: {name} has the shape {array.shape}; it must be {ends}, {shape} in colors")
            self._arrays[name] = array
        self.names = [f"frame {index}" for index in range(shape[0])]

    def read(self, index: int) -> Frame:
        layers = {name: np.asarray(array[index], np.float32) for name, array in self._arrays.items()}
        motion = layers.pop("motion", None)
        if motion is not None:
            second = motion[..., 2:] if motion.shape[2] == 4 else None
            _add_motion(layers, self.conventions, motion[..., :2], second)
        return checked(Frame(**layers), f"denoise: {self.names[index]}")


class ExrSource(Source):
    """Frames in EXR files, whose layers are found by their names."""

    def __init__(
        self, paths: Sequence[Path], chosen: Mapping[str, str], convention: Convention | None, layered: bool = True
    ) -> None:
        """Raises SolariError for a first file that can't be used. layered: whether more than colors is read."""
        self.paths = paths
        self.names = [str(path) for path in paths]
        self._layered = layered
        first = read_channels(paths[0])
        self.layers: Layers = find_layers(list(first), chosen, self.names[0])
        self._size = first[self.layers.channels["color"][0]].shape
        is_blender = self.layers.is_blender
        first_pair = convention or (BLENDER if is_blender else OWN if self.layers.is_own else Convention())
        second_pair = first_pair.of_second_pair(turned=is_blender)
        if "motion" not in self.layers.channels and first_pair.leads_to_next:
            second_pair = first_pair  # said of the only layer, `forward`
        self.conventions = (first_pair, second_pair)
        self._digests: dict[int, str] = {}

    def digest(self, index: int) -> str:
        """A hash of a file's content."""
        if index not in self._digests:
            with open(self.paths[index], "rb") as file:
                self._digests[index] = hashlib.file_digest(file, "sha256").hexdigest()
        return self._digests[index]

    def read(self, index: int) -> Frame:
        who = self.names[index]
        found = read_channels(self.paths[index])
        layers: dict[str, Floats] = {}
        for name, channels in self.layers.channels.items():
            if not self._layered and name not in ("color", "alpha"):
                continue
            missing = [channel for channel in channels if channel not in found]
            if missing:
                raise SolariError(f"{who}: lacks {', '.join(missing)}, which {self.names[0]} has: render it with it")
            planes = [found[channel] for channel in channels]
            if planes[0].shape != self._size:
                height, width = self._size
                raise SolariError(
                    f"{who}: has {planes[0].shape[1]}x{planes[0].shape[0]} pixels, {self.names[0]} {width}x{height}: "
                    "render all frames at one size"
                )
            layers[name] = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
        self._turn_motion(layers)
        return checked(Frame(**layers), who)

    def _turn_motion(self, layers: dict[str, Floats]) -> None:
        vectors = layers.pop("motion", None)
        second = layers.pop("motion_next", None)
        if vectors is not None and vectors.shape[2] == 4:
            second = vectors[..., 2:]
        _add_motion(layers, self.conventions, None if vectors is None else vectors[..., :2], second)


def _add_motion(
    layers: dict[str, Floats], conventions: tuple[Convention, Convention], first: Floats | None, second: Floats | None
) -> None:
    for convention, vectors in zip(conventions, (first, second), strict=True):
        if vectors is not None:
            layers["motion_next" if convention.leads_to_next else "motion"] = convention.offsets(vectors)


def checked(frame: Frame, who: str) -> Frame:
    """The frame. Raises SolariError for values that aren't finite; depths may be infinite."""
    for name, values in vars(frame).items():
        if values is None:
            continue
        bad = np.isnan(values) if name == "depth" else ~np.isfinite(values)
        if bad.any():
            rows, columns = np.nonzero(bad.reshape(*bad.shape[:2], -1).any(axis=-1))
            raise SolariError(
                f"{who}: {name} has values that aren't finite in {len(rows)} pixels, the first at column {columns[0]}, "
                f"row {rows[0]}: render this frame again, or replace them"
            )
    return frame


def find_files(sequence: Any) -> list[Path]:
    """The files of a sequence in the order of their numbers.

    sequence: a folder, a pattern (frame_####.exr, frame_%04d.exr, frame_*.exr), or a list of files. Raises SolariError
    where there are none, and for numbers that are missing between the first and the last.
    """
    if isinstance(sequence, list | tuple):
        paths = [Path(path) for path in sequence]
        missing_file = next((path for path in paths if not path.is_file()), None)
        if missing_file is not None or not paths:
            raise SolariError(f"denoise: there is no file {missing_file or 'in the list'}")
        return paths
    place = Path(sequence)
    pattern = None
    if place.is_dir():
        paths = [path for path in place.iterdir() if path.suffix.lower() == ".exr"]
        what = "in the folder"
    else:
        paths = list(place.parent.glob(_HOLES.sub("*", place.name))) if place.parent.is_dir() else []
        if _HOLES.search(place.name):
            parts = [re.escape(part).replace(r"\*", ".*").replace(r"\?", ".") for part in _HOLES.split(place.name)]
            pattern = re.compile(r"(\d+)".join(parts))
            paths = [path for path in paths if pattern.fullmatch(path.name)]
        what = "by this pattern"
    if not paths:
        raise SolariError(f"{sequence}: there are no EXR files {what}: give a folder, a pattern or a list of files")
    if len(paths) == 1:
        return paths
    numbered = sorted(zip(_numbers(paths, pattern), [path.name for path in paths], paths, strict=True))
    numbers = [number for number, _, _ in numbered]
    step = min(b - a for a, b in itertools.pairwise(numbers))
    if numbers[0] < 0 or step == 0:
        raise SolariError(f"{sequence}: not all files have numbers of their own, as frame_0001.exr: give a pattern")
    gaps = itertools.chain.from_iterable(range(a + step, b, step) for a, b in itertools.pairwise(numbers))
    missing = list(itertools.islice(gaps, 9))
    if missing:
        some = ", ".join(map(str, missing[:8])) + (" ..." if len(missing) > 8 else "")
        raise SolariError(f"{sequence}: frames are missing: {some}: render them, or give a list of the files")
    return [path for _, _, path in numbered]


def _numbers(paths: Sequence[Path], pattern: re.Pattern[str] | None) -> list[int]:
    """The numbers of frames: of the pattern's last hole, else the last ones in the names that aren't all the same; -1
    where there are none."""
    if pattern is not None:
        matches = [pattern.fullmatch(path.name) for path in paths]
        found = [[int(number) for number in match.groups()] if match else [] for match in matches]
    else:
        found = [[int(number) for number in _NUMBERS.findall(path.stem)] for path in paths]
    if pattern is None and len({len(numbers) for numbers in found}) == 1:
        columns = list(zip(*found, strict=True))
        return list(next((column for column in reversed(columns) if len(set(column)) > 1), [-1] * len(paths)))
    return [numbers[-1] if numbers else -1 for numbers in found]


def add_camera_motion(frame: Frame, index: int, cameras: NDArray[np.float64]) -> None:
    """Give a frame without motion that of resting surfaces between the cameras, (frames, 3, 4)."""
    weight: Floats | float = 1.0
    position = frame.position
    if position is None and frame.depth is not None:
        position, weight = position_of_depth(frame.depth, cameras[index])
    if position is None:
        raise SolariError("denoise: cameras need positions or depths of surfaces, to say where these were: render one")
    if index > 0:
        frame.motion = from_cameras(position, cameras[index - 1], weight)
    if index + 1 < len(cameras):
        frame.motion_next = from_cameras(position, cameras[index + 1], weight)


def check_motion(source: Source) -> None:
    """Raise SolariError if the motion vectors of some frames lead the wrong way."""
    last = len(source.names) - 1
    first_is_right = False
    for convention in source.conventions:
        step = 1 if convention.leads_to_next else -1
        # The frames that have neighbors on both sides, or the two of a short sequence.
        indices = {*np.linspace(1, last - 1, _CHECKED_PAIRS).astype(int)} if last > 1 else {0, last}
        pairs = []
        for index in sorted(indices):
            if not 0 <= index + step <= last:
                continue
            frame = source.read(index)
            offsets = frame.motion if step < 0 else frame.motion_next
            if offsets is not None:
                pairs.append((_compared(frame), _compared(source.read(index + step)), offsets))
        check_direction(pairs, convention, source.names[0], second=first_is_right)
        first_is_right = bool(pairs)


def _compared(frame: Frame) -> Floats:
    """What tells surfaces apart, the best that a frame has."""
    if frame.position is not None:
        return frame.position
    guides = [guide for guide in (frame.albedo, frame.normal) if guide is not None]
    return np.concatenate(guides, axis=-1) if guides else frame.color


def read_cameras(cameras: Any, count: int) -> NDArray[np.float64]:
    """Camera matrices (frames, 3, 4). Raises SolariError for others."""
    try:
        found = np.asarray(host_array(cameras), np.float64)
    except (TypeError, ValueError):
        raise SolariError(f"denoise: cameras must be matrices ({count}, 3, 4), not {quoted(cameras)}") from None
    if found.shape != (count, 3, 4) or not np.isfinite(found).all():
        raise SolariError(f"denoise: cameras must be finite matrices ({count}, 3, 4), not {quoted(found.shape)}")
    singular = np.flatnonzero(np.linalg.matrix_rank(found) < 3)
    if len(singular):
        raise SolariError(f"denoise: the matrix of camera {singular[0]} is singular: it shows no picture")
    return found
