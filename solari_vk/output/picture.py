"""Pictures as files: .png, .exr and .npy."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError
from solari_vk.output.tone_mapping import Colors, encode_picture

SUFFIXES = (".png", ".exr", ".npy")



def check_output(path: str | os.PathLike[str], suffixes: Sequence[str] = SUFFIXES) -> None:
    """Raise SolariError if the path has none of the suffixes, is a folder, or is in a folder that doesn't exist."""
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise SolariError(f"{target}: pictures are written as {', '.join(suffixes)}, not '{target.suffix}'")
    if not target.parent.is_dir():
        raise SolariError(f"{target}: there is no folder {target.parent}: make it first")
    if target.is_dir():
        raise SolariError(f"{target}: is a folder: give the name of a file")


def save_image(
    path: str | os.PathLike[str],
    radiance: ArrayLike,
    *,
    exposure: float = 1.0,
    tonemap: str = "agx",
    layers: Mapping[str, NDArray[Any]] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write radiance (height, width, 3) in cd/m^2, and layers, in the format of the path's suffix.

    .png: 8-bit sRGB after exposure and tone mapping. .exr and .npy: radiance unchanged; the header of an .exr holds the
    exposure and the metadata. Layers, (height, width) or (height, width, 1 to 4), become channels of an .exr ("depth",
    "normal.X", "albedo.R") or .npy files next to the picture ("picture.depth.npy"). A file that can't be written whole
    isn't written. Raises SolariError for wrong shapes and for files that can't be written.
    """
    check_output(path)
    target = Path(path)
    picture = np.asarray(radiance, np.float32)
    if picture.ndim != 3 or picture.shape[2] != 3 or 0 in picture.shape:
        raise SolariError(f"{target}: a picture has the shape (height, width, 3), not {picture.shape}")
    layers = {name: np.asarray(layer) for name, layer in (layers or {}).items()}
    for name, layer in layers.items():
        if layer.shape[:2] != picture.shape[:2] or layer.ndim not in (2, 3) or layer.shape[2:] > (4,):
            raise SolariError(f"{target}: layer '{name}' has the shape {layer.shape}, the picture {picture.shape}")
    suffix = target.suffix.lower()
    if suffix == ".exr":
        _write_exr(target, picture, layers, {"exposure": repr(float(exposure)), **(metadata or {})})
        return
    if suffix == ".npy":
        _write_npy(target, picture)
    else:
        write_png(target, encode_picture(picture, exposure=exposure, curve=tonemap))
    for name, layer in layers.items():
        _write_npy(target.with_name(f"{target.stem}.{name}.npy"), layer)


def _write_npy(path: Path, array: NDArray[Any]) -> None:
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        np.save(file, array)


def write_png(path: Path, codes: NDArray[np.uint8]) -> None:
    """Write sRGB codes (height, width, 3 or 4), such as a frame's "display", without change."""
    with whole_file(path) as temporary:
        temporary.write_bytes(png_bytes(codes))


def png_bytes(codes: NDArray[np.uint8]) -> bytes:
    """sRGB codes (height, width, 3 or 4) as the content of a .png file."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(codes).save(content, format="PNG")
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


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder; what is written there replaces the file at `path` when the context ends.

    Raises SolariError when writing fails, and leaves the file at `path` as it was.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise SolariError(f"{path}: can't be written: {getattr(error, 'strerror', None) or error}") from None
    finally:
        temporary.unlink(missing_ok=True)
