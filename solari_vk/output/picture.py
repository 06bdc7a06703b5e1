"""Pictures as files: .png, .jpg, .exr, .npy and .npz."""

from __future__ import annotations

import errno
import io
import os
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.base.files import check_writable, whole_file, write_whole
from solari_vk.output.cutout import encode_cutout
from solari_vk.output.tone_mapping import Colors, encode_picture
from solari_vk.scene.images import exr

JPEG = (".jpg", ".jpeg")
EIGHT_BIT = (".png", *JPEG)
WITH_ALPHA = (".png", ".exr")
WHOLE = (".exr", ".npz")  # have layers inside
SUFFIXES = (*EIGHT_BIT, *WHOLE, ".npy")


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
    target = Path(path)
    _check_suffix(target, SUFFIXES)
    picture = np.asarray(radiance, np.float32)
    if picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise SolariError(f"{target}: a picture has the shape (height, width, 3), not {picture.shape}")
    layers = {name: np.asarray(layer) for name, layer in (layers or {}).items()}
    channels = ("R", "G", "B") if alpha is None else ("R", "G", "B", "A")
    taken = {".npz": ("radiance",), ".exr": channels}.get(target.suffix.lower(), ())
    for name, layer in layers.items():
        if name in taken:
            raise SolariError(f"{target}: the picture itself has the name '{name}' there: call the layer otherwise")
        if layer.shape[:2] != picture.shape[:2] or layer.ndim not in (2, 3) or layer.shape[2:] > (4,):
            raise SolariError(f"{target}: layer '{name}' has the shape {layer.shape}, the picture {picture.shape}")
    suffix = target.suffix.lower()
    alphas = {} if alpha is None else {"A": alpha}
    if alpha is not None:
        check_alpha(target)
    if suffix == ".exr":
        _write_exr(target, picture, layers | alphas, {"exposure": repr(float(exposure)), **(metadata or {})})
        return
    if suffix == ".npz":
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in ({"radiance": picture} | layers).items():  # numpy.savez takes some names for options
                with archive.open(f"{name}.npy", "w", force_zip64=True) as part:
                    np.lib.format.write_array(part, array, allow_pickle=False)
        write_whole(target, content.getbuffer())
        return
    if suffix == ".npy":
        write_npy(target, picture)
    elif alpha is not None:
        write_codes(target, encode_cutout(picture, alpha, exposure=exposure, curve=tonemap))
    else:
        write_codes(target, encode_picture(picture, exposure=exposure, curve=tonemap))
    for name, layer in layers.items():
        write_npy(target.with_name(f"{target.stem}.{name}.npy"), layer)


def check_alpha(path: Path) -> None:
    """Raise SolariError for a file that can't hold a transparent background."""
    if path.suffix.lower() not in WITH_ALPHA:
        raise SolariError(f"{path}: a transparent background is written as {' or '.join(WITH_ALPHA)}")


def write_npy(path: Path, array: NDArray[Any]) -> None:
    """Write an array as a .npy file. Raises SolariError for a file that can't be written."""
    content = io.BytesIO()
    np.save(content, array)  # which doesn't report when it can't write the end of a file
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
        if layer.dtype not in (np.float16, np.float32, np.uint32):
            layer = layer.astype(np.uint32 if layer.dtype.kind in "bu" else np.float32)
        if layer.ndim == 2 or layer.shape[2] == 1:
            channels[name] = layer.reshape(layer.shape[:2])
            continue
        spatial = layer.shape[2] == 2 or any(word in name for word in ("normal", "position", "motion", "direction"))
        for i, letter in zip(range(layer.shape[2]), "XYZW" if spatial else "RGBA", strict=False):
            channels[f"{name}.{letter}"] = layer[..., i]
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": "solari_vk",
        **metadata,
    }
    with whole_file(path) as temporary:
        OpenEXR.File(header, {name: np.ascontiguousarray(c) for name, c in channels.items()}).write(str(temporary))
        if not exr.is_whole(temporary.read_bytes()):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # as far as one can know
