"""`denoise`: the frames of a sequence without noise and flicker, whatever renderer made them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.base.files import make_folder, read_regular
from solari_vk.base.host_array import host_array
from solari_vk.output import oidn
from solari_vk.output.picture import write_picture
from solari_vk.output.sequences.layers import NAMES, WITHOUT, read_channels, read_header
from solari_vk.output.sequences.motion import Convention
from solari_vk.output.sequences.source import (
    ArraySource,
    ExrSource,
    Source,
    add_camera_motion,
    check_motion,
    find_files,
    read_cameras,
)
from solari_vk.output.sequences.temporal import Prepared, blended, change, prepare
from solari_vk.scene.images.exr import IDENTIFIER, is_whole

WINDOW = 4
MAX_WINDOW = 32
_MARK = "solari_vk.denoise"
"""The attribute of the EXR files that says what they were made of."""
_VERSION = 2  # of what is computed: frames of another one aren't kept


_Map = NDArray[np.float32] | None


class Denoised(NamedTuple):
    """What `denoise` made."""

    frames: NDArray[np.float32] | None
    """(frames, height, width, 3), where frames were given as an array."""
    error: NDArray[np.float32] | None
    """The standard error of each pixel, (frames, height, width), with maps=True."""
    flicker: NDArray[np.float32] | None
    """How far each pixel differs from the previous frame's along the motion, (frames, height, width), with
    maps=True."""
    files: list[Path]
    """The files of the frames, where they were given as files."""


@checked_keywords(who="solari_vk")
def denoise(
    frames: Any,
    output: str | os.PathLike[str] | None = None,
    *,
    albedo: Any = None,
    normal: Any = None,
    depth: Any = None,
    position: Any = None,
    motion: Any = None,
    cameras: Any = None,
    convention: str | None = None,
    layers: Mapping[str, str] | None = None,
    window: int = WINDOW,
    maps: bool = False,
    overwrite: bool = False,
    progress: Callable[[int], None] | None = None,
) -> Denoised:
    """Denoise the frames of an animation that any renderer made, with the frames before and after each.

    frames: linear colors (frames, height, width, 3), or EXR files: a folder, a pattern such as "frame_####.exr", or a
    list of paths; then `output` is the folder for the denoised files, which have the same names, and layers are found
    in the files. layers: names of layers that aren't found, as {"albedo": "MyAlbedo"}; those of `color`, `albedo`,
    `normal`, `depth`, `position`, `motion` and `motion_next`. Arrays may come with: albedo and normal (frames, height,
    width, 3); depth along the camera's axis (frames, height, width), inf where nothing is; position in the world
    (frames, height, width, 3); motion (frames, height, width, 2), offsets in pixels to where each surface was in the
    frame before, x to the right and y down, or 4 numbers with those to the next frame (with a
    convention about the next frame: first those, then those to the previous one). Each may be missing: without
    albedo and normal textures and edges blur, without depth pixels that come into view may take light of what hid them,
    without motion only what rests in the picture is averaged over frames. cameras: (frames, 3, 4), matrices from (x, y,
    z, 1) to (column, row, 1) times depth, in pixels: with positions or depths they give the motion of resting surfaces
    where there are no motion vectors. convention: what motion vectors mean, such as "to-previous,y-up,pixels"; by
    default that of the files' renderer. window: frames before and after that are looked at. maps: also give, or write
    as layers `error` and `flicker`, maps of the standard error, without what OIDN blurs, and of the change since the
    previous frame along the motion. overwrite: replace files in `output` of other frames or settings, or that aren't
    whole; frames that are written already are kept. progress: called with the number of finished frames.

    Memory: about 90 bytes a pixel for each of 2 * window + 1 frames. Spatial denoising is by Intel Open Image Denoise,
    the package solari-vk[oidn]; the weights over time are those of non-local means with guides (Rousselle et al.,
    2013). Raises SolariError without that package; for files that are no EXR, damaged, of differing sizes or layers, or
    missing in the sequence; for values that aren't finite; for motion vectors that lead the wrong way; for files in
    `output` of other frames or settings, without `overwrite`.
    """
    if not (isinstance(window, int) and 0 <= window <= MAX_WINDOW):
        raise SolariError(f"denoise: window is a number of frames from 0 to {MAX_WINDOW}, not {quoted(window)}")
    if progress is not None and not callable(progress):
        raise SolariError(f"denoise: progress is a function of the number of finished frames, not {quoted(progress)}")
    if not isinstance(layers, Mapping | None):
        raise SolariError(f"denoise: layers are names, as {{'albedo': 'MyAlbedo'}}, not {quoted(layers)}")
    oidn.check_installed()
    meaning = None if convention is None else Convention.parse(convention)
    chosen = dict(layers or {})
    for name in chosen:
        if name not in NAMES:
            raise unknown_name("denoise: there is no layer", name, NAMES)
    arrays = {"albedo": albedo, "normal": normal, "depth": depth, "position": position, "motion": motion}
    if isinstance(frames, list | tuple) and frames and not isinstance(frames[0], str | os.PathLike):
        frames = _stacked(frames)
    if isinstance(frames, str | os.PathLike | list | tuple):
        extra = [name for name, value in arrays.items() if value is not None]
        if extra:
            raise SolariError(
                f"denoise: {extra[0]} is for arrays: of files name the layer by layers={{'{extra[0]}': ...}}"
            )
        if output is None:
            raise SolariError("denoise: give the folder for the denoised files as output")
        source = ExrSource(find_files(frames), chosen, meaning)
        return _denoise_files(source, Path(output), cameras, window, maps, overwrite, progress)
    if output is not None or chosen:
        raise SolariError("denoise: output and layers are for files: of arrays the result is returned")
    if frames is None:
        raise SolariError("denoise: give frames as an array (frames, height, width, 3), a folder, a pattern or a list")
    arrays_source = ArraySource({"color": frames, **arrays}, meaning or Convention())
    work = _Work(arrays_source, _read_cameras(cameras, arrays_source), window)
    made = []
    for index in range(len(work.source.names)):
        made.append(work.result(index, maps))
        if progress is not None:
            progress(index + 1)
    results = [np.stack(parts) if parts[0] is not None else None for parts in zip(*made, strict=True)]
    return Denoised(results[0], results[1], results[2], [])


def _stacked(frames: Sequence[Any]) -> NDArray[Any]:
    try:
        return np.stack([host_array(frame) for frame in frames])
    except (TypeError, ValueError):
        raise SolariError(
            "denoise: a list of frames has either paths of files or arrays (height, width, 3) of one shape"
        ) from None


def _read_cameras(cameras: Any, source: Source) -> NDArray[np.float64] | None:
    return None if cameras is None else read_cameras(cameras, len(source.names))


def lost_without(source: ExrSource, cameras: bool) -> Iterator[str]:
    """What the sequence loses by each layer that it lacks, in a line."""
    for name, loss in WITHOUT.items():
        replaced = name == "depth" and cameras and "position" in source.layers.channels
        if name == "motion":
            replaced = cameras or "motion_next" in source.layers.channels
        if name not in source.layers.channels and not replaced:
            yield f"no {name}: {loss}"


def _denoise_files(
    source: ExrSource,
    folder: Path,
    cameras: Any,
    window: int,
    maps: bool,
    overwrite: bool,
    progress: Callable[[int], None] | None,
) -> Denoised:
    files = [folder / path.name for path in source.paths]
    if len(set(files)) < len(files):
        raise SolariError(f"{folder}: two frames of the sequence have one name: denoise each folder on its own")
    if any(file.resolve() == path.resolve() for file, path in zip(files, source.paths, strict=True)):
        raise SolariError(f"{folder}: is the folder of the sequence itself: choose another one for the denoised frames")
    matrices = _read_cameras(cameras, source)
    make_folder(folder)
    settings = f"{_VERSION} {window} {maps} {source.conventions[0]} {source.layers.described()} {_digest(matrices)}"
    marks = [_mark(source, index, max(window, int(maps)), settings) for index in range(len(files))]
    kept = [file.exists() and _is_kept(file, mark, overwrite) for file, mark in zip(files, marks, strict=True)]
    work = _Work(source, matrices, window, check=not all(kept))
    for index, file in enumerate(files):
        if not kept[index]:
            if work.previous is None and index > 0 and maps:
                work.previous = _picture(files[index - 1])
            picture, error, flicker = work.result(index, maps)
            found = {"error": error, "flicker": flicker}
            extra = {name: layer for name, layer in found.items() if layer is not None}
            header = {_MARK: marks[index]}
            write_picture(file, picture, layers=extra, metadata=header, alpha=work.alpha[index])
        else:
            work.previous = None
        if progress is not None:
            progress(index + 1)
    return Denoised(None, None, None, files)


def _digest(cameras: NDArray[np.float64] | None) -> str:
    return "" if cameras is None else hashlib.sha256(cameras.tobytes()).hexdigest()


def _mark(source: ExrSource, index: int, window: int, settings: str) -> str:
    """Says what a frame is made of: its window's files and the settings."""
    around = range(max(0, index - window), min(len(source.names), index + window + 1))
    return hashlib.sha256(" ".join([settings, str(index), *map(source.digest, around)]).encode()).hexdigest()


def _is_kept(file: Path, mark: str, overwrite: bool) -> bool:
    """Whether a file is the frame that would be written. Raises SolariError for another one, without `overwrite`."""
    data = read_regular(file, str(file))
    whole = data.startswith(IDENTIFIER) and is_whole(data)
    if whole and read_header(file).get(_MARK) == mark:
        return True
    if overwrite:
        return False
    wrong = "made of other frames or with other settings" if whole else "but isn't a whole EXR file"
    raise SolariError(
        f"{file}: is there already, {wrong}: choose another folder, or overwrite=True (--overwrite) to replace it"
    )


def _picture(file: Path) -> NDArray[np.float32]:
    channels = read_channels(file)
    return np.stack([channels[name] for name in "RGB"], axis=-1)


class _Work:
    """The frames around the one that is denoised; older ones are dropped."""

    def __init__(self, source: Source, cameras: NDArray[np.float64] | None, window: int, check: bool = True) -> None:
        self.source = source
        self.alpha: dict[int, NDArray[np.float32] | None] = {}
        self.previous: NDArray[np.float32] | None = None
        """The denoised frame before the next one, for its flicker."""
        self._cameras = cameras
        self._window = window
        self._prepared: dict[int, Prepared] = {}
        if check:
            check_motion(source)

    def result(self, index: int, maps: bool) -> tuple[NDArray[np.float32], _Map, _Map]:
        """The picture, and with `maps` its error and flicker."""
        first, last = max(0, index - self._window), min(len(self.source.names) - 1, index + self._window)
        # Flicker needs the frame before, whatever the window.
        oldest = min(first, max(0, index - 1)) if maps else first
        self._prepared = {number: frame for number, frame in self._prepared.items() if number >= oldest}
        for number in range(oldest, last + 1):
            if number not in self._prepared:
                self._prepared[number] = self._prepare(number)
        picture, error = blended({number: self._prepared[number] for number in range(first, last + 1)}, index)
        if not maps:
            return picture, None, None
        flicker = np.zeros(picture.shape[:2], np.float32)
        if self.previous is not None and index - 1 in self._prepared:
            flicker = change(self._prepared, index, picture, self.previous)
        self.previous = picture
        return picture, error, flicker

    def _prepare(self, number: int) -> Prepared:
        frame = self.source.read(number)
        if self._cameras is not None and frame.motion is None and frame.motion_next is None:
            add_camera_motion(frame, number, self._cameras)
        self.alpha = {index: alpha for index, alpha in self.alpha.items() if number - index <= 2 * self._window}
        self.alpha[number] = frame.alpha
        return prepare(frame.color, frame.albedo, frame.normal, frame.depth, frame.motion, frame.motion_next)
