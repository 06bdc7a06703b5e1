"""Pictures as files: .png, .jpg, .exr, .npy and .npz."""

from __future__ import annotations

import errno
import io
import os
import shutil
import subprocess
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.base.files import check_writable, followed, whole_file, write_whole
from solari_vk.output.tone_mapping import Colors, encode_picture
from solari_vk.output.transparency import encode_transparent
from solari_vk.scene.images import exr

JPEG = (".jpg", ".jpeg")
EIGHT_BIT = (".png", *JPEG)
WITH_ALPHA = (".png", ".exr")
WITH_LAYERS = (".exr", ".npz")  # others have a file beside them for each layer
SUFFIXES = (*EIGHT_BIT, *WITH_LAYERS, ".npy")
PATIENCE = 5.0  # seconds to wait for an error; on some desktops xdg-open stays until its program is closed


@checked_keywords(who="solari_vk")
def check_output(path: str | os.PathLike[str], suffixes: Sequence[str] = SUFFIXES) -> None:
    """Raise SolariError if the path has none of the suffixes, or if no file can be written there."""
    target = Path(path)
    _check_suffix(target, suffixes)
    check_writable(target)


def _check_suffix(target: Path, suffixes: Sequence[str]) -> None:
    if target.suffix.lower() not in suffixes:
        raise SolariError(f"{target}: pictures are written as {', '.join(suffixes)}, not '{target.suffix}'")


@checked_keywords(who="solari_vk")
def save_image(
    path: str | os.PathLike[str],
    radiance: ArrayLike,
    *,
    exposure: float = 1.0,
    tonemap: str = "agx",
    layers: Mapping[str, NDArray[Any]] | None = None,
    metadata: Mapping[str, str] | None = None,
    alpha: NDArray[np.float32] | None = None,
) -> None:
    """Write radiance (height, width, 3) in cd/m^2, and layers, in the format of the path's suffix.

    .png, .jpg: 8-bit sRGB after exposure and tone mapping. .exr, .npy, .npz: radiance unchanged; the header of an .exr
    holds the exposure and the metadata. Layers, (height, width) or (height, width, 1 to 4), become channels of an .exr
    ("depth", "normal.X", "albedo.R"), arrays of an .npz beside its "radiance", or .npy files next to the picture
    ("picture.depth.npy"). alpha (height, width): the share of each pixel that surfaces cover, for a .png, in which it
    is straight, or an .exr, in which the radiance, which is that of the surfaces, is multiplied by it. A file that
    can't be written whole isn't written. Raises SolariError for wrong shapes and for files that can't be written.
    """
    if not isinstance(path, str | os.PathLike):
        raise SolariError(f"save_image: the path of a file comes first, then the radiance, not {type(path).__name__}")
    _check_suffix(Path(path), SUFFIXES)
    write_picture(
        Path(path),
        radiance,
        place=followed(Path(path)),
        exposure=exposure,
        tonemap=tonemap,
        layers=layers,
        metadata=metadata,
        alpha=alpha,
    )


def write_picture(
    target: Path,
    radiance: ArrayLike,
    *,
    place: Path | None = None,
    exposure: float = 1.0,
    tonemap: str = "agx",
    layers: Mapping[str, NDArray[Any]] | None = None,
    metadata: Mapping[str, str] | None = None,
    alpha: NDArray[np.float32] | None = None,
) -> None:
    """`save_image` for a name that the user hasn't given: what links lead to isn't replaced. place: where the picture
    is written instead of at `target`, which names its layers."""
    place = place or target
    picture = _as_picture(target, radiance)
    arrays = {name: np.asarray(layer) for name, layer in (layers or {}).items()}
    _check_layers(target, picture, arrays, has_alpha=alpha is not None)
    if alpha is not None:
        check_alpha(target)
    suffix = target.suffix.lower()
    if suffix == ".exr":
        header = {"exposure": repr(float(exposure)), **(metadata or {})}
        _write_exr(place, picture, arrays if alpha is None else arrays | {"A": alpha}, header)
    elif suffix == ".npz":
        _write_npz(place, {"radiance": picture} | arrays)
    else:
        if suffix == ".npy":
            write_npy(place, picture)
        else:
            write_codes(place, _codes(picture, alpha, exposure, tonemap))
        write_beside(target, arrays)


def write_beside(target: Path, layers: Mapping[str, NDArray[Any]]) -> None:
    """Write layers as .npy files beside a picture."""
    for name, layer in layers.items():
        write_npy(target.with_name(f"{target.stem}.{name}.npy"), layer)


def _codes(picture: Colors, alpha: NDArray[np.float32] | None, exposure: float, curve: str) -> NDArray[np.uint8]:
    if alpha is None:
        return encode_picture(picture, exposure=exposure, curve=curve)
    return encode_transparent(picture, alpha, exposure=exposure, curve=curve)


def _as_picture(target: Path, radiance: ArrayLike) -> Colors:
    picture = np.asarray(radiance, np.float32)
    if picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise SolariError(f"{target}: a picture has the shape (height, width, 3), not {picture.shape}")
    return picture


def _check_layers(target: Path, picture: Colors, layers: Mapping[str, NDArray[Any]], has_alpha: bool) -> None:
    """Raise SolariError for layers of another size than the picture, and for names that it has itself in the file."""
    names: tuple[str, ...] = ()
    if target.suffix.lower() == ".npz":
        names = ("radiance",)
    elif target.suffix.lower() == ".exr":
        names = ("R", "G", "B", "A") if has_alpha else ("R", "G", "B")
    for name, layer in layers.items():
        if name in names:
            raise SolariError(f"{target}: the picture itself has the name '{name}' there: call the layer otherwise")
        if layer.shape[:2] != picture.shape[:2] or layer.ndim not in (2, 3) or layer.shape[2:] > (4,):
            raise SolariError(f"{target}: layer '{name}' has the shape {layer.shape}, the picture {picture.shape}")
        if layer.dtype.names and target.suffix.lower() == ".exr":
            fields = ", ".join(layer.dtype.names)
            raise SolariError(f"{target}: layer '{name}' has records, of {fields}: .npz and .npy files take them")


def check_alpha(path: Path) -> None:
    """Raise SolariError for a file that can't hold a transparent background."""
    if path.suffix.lower() not in WITH_ALPHA:
        raise SolariError(f"{path}: a transparent background is written as {' or '.join(WITH_ALPHA)}")


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write an array as a .npy file. Raises SolariError for a file that can't be written."""
    # Not into the file itself: numpy doesn't report when it can't write the end of a file.
    content = io.BytesIO()
    np.save(content, array)
    write_whole(path, content.getbuffer())


def _write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    content = io.BytesIO()
    # Not by numpy.savez, which takes names such as "file" for its own arguments.
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as part:
                np.lib.format.write_array(part, array, allow_pickle=False)
    write_whole(path, content.getbuffer())


def write_codes(path: Path, codes: NDArray[np.uint8]) -> None:
    """Write sRGB codes (height, width, 3 or 4), such as a frame's "display": as a .jpg without alpha, or unchanged as a
    .png, by the path's suffix."""
    write_whole(path, jpeg_bytes(codes) if path.suffix.lower() in JPEG else png_bytes(codes))


def png_bytes(codes: NDArray[np.uint8]) -> bytes:
    """sRGB codes (height, width, 3 or 4) as the content of a .png file."""
    return _encoded(codes, "PNG")


def jpeg_bytes(codes: NDArray[np.uint8], quality: int = 95) -> bytes:
    """sRGB codes (height, width, 3 or 4) as the content of a .jpg file, without alpha, colors at full resolution."""
    return _encoded(codes[..., :3], "JPEG", quality=quality, subsampling=0)


def _encoded(codes: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(codes)).save(content, format=kind, **options)
    return content.getvalue()


def _write_exr(path: Path, picture: Colors, layers: dict[str, NDArray[Any]], metadata: dict[str, str]) -> None:
    import OpenEXR

    channels = {letter: picture[..., i] for i, letter in enumerate("RGB")}
    for name, layer in layers.items():
        channels |= _channels(name, layer)
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": "solari_vk",
        **metadata,
    }
    with whole_file(path) as temporary:
        OpenEXR.File(header, {name: np.ascontiguousarray(c) for name, c in channels.items()}).write(str(temporary))
        # OpenEXR doesn't report a full disk, and nothing else is known to cut a file short.
        if not exr.is_whole(temporary.read_bytes()):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _channels(name: str, layer: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The channels of a layer by their names in an .exr: floats of 16 or 32 bits, or integers of 32 without a sign."""
    if layer.dtype not in (np.float16, np.float32, np.uint32):
        layer = layer.astype(np.uint32 if layer.dtype.kind in "bu" else np.float32)
    if layer.ndim == 2 or layer.shape[2] == 1:
        return {name: layer.reshape(layer.shape[:2])}
    # Programs show R, G and B as a color, and X, Y and Z as a vector.
    is_vector = layer.shape[2] == 2 or any(word in name for word in ("normal", "position", "motion", "direction"))
    letters = "XYZW" if is_vector else "RGBA"
    return {f"{name}.{letters[i]}": layer[..., i] for i in range(layer.shape[2])}


def why_no_desktop() -> str:
    """Why no file can be opened in a desktop's program, "" if one can."""
    if hasattr(os, "startfile"):  # Windows
        return ""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return "this session has no desktop (DISPLAY and WAYLAND_DISPLAY aren't set)"
    return "" if shutil.which("xdg-open") else "xdg-open is missing: install xdg-utils"


def open_on_desktop(path: Path) -> str:
    """Open a file in the desktop's program for its kind; returns what went wrong, "" if nothing did."""
    reason = why_no_desktop()
    if reason:
        return reason
    start = getattr(os, "startfile", None)
    if start is not None:
        try:
            start(path.resolve())
        except OSError as error:
            return f"Windows found no program for {path.suffix} files ({error.strerror})"
        return ""
    # In a session of its own, so that Ctrl-C in the terminal doesn't close the program that shows the picture.
    none = subprocess.DEVNULL
    process = subprocess.Popen(
        ["xdg-open", str(path.resolve())], stdin=none, stdout=none, stderr=none, start_new_session=True
    )
    try:
        status = process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        return ""
    return f"xdg-open found no program for {path.suffix} files (exit status {status})" if status else ""
