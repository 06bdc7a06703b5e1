"""From radiance to pictures: exposure, tone mapping, and the files that hold them. Pure numpy.

Curves take exposed linear Rec. 709 colors (..., 3) and give display-linear ones in [0, 1]; `encode_srgb`
then makes them what an 8-bit picture holds.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.errors import SolariError

Colors = NDArray[np.float32]
SUFFIXES = (".png", ".exr", ".npy")
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear Rec. 709
MIDDLE_GREY = 0.18

# ---- curves -----------------------------------------------------------------------------------------


def clip(color: Colors) -> Colors:
    """No curve: everything above 1 is white."""
    return np.clip(color, 0, 1)


def reinhard(color: Colors) -> Colors:
    """L / (1 + L) on luminance, hue kept. Reinhard et al., "Photographic Tone Reproduction ...", SIGGRAPH 2002."""
    luminance: Colors = np.maximum(color @ LUMINANCE, 0)[..., None]
    mapped: Colors = np.clip(color / (1 + luminance), 0, 1)
    return mapped


def aces(color: Colors) -> Colors:
    """Fit of the ACES filmic curve. Narkowicz, "ACES Filmic Tone Mapping Curve", 2015 (with its 0.6 pre-exposure)."""
    x = np.clip(color, 0, 1e6) * np.float32(0.6)
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


_AGX_INSET = np.array([
    [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
    [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
    [0.0423756549057051, 0.0784336, 0.879142973793104],
])  # fmt: skip
_AGX_OUTSET = np.linalg.inv(_AGX_INSET).astype(np.float32)
_AGX_CURVE = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)
_AGX_LOWEST, _AGX_HIGHEST = -12.47393, 4.026069  # in stops


def agx(color: Colors) -> Colors:
    """AgX base look (Sobotka), as the polynomial fit of Wrensch, "Minimal AgX Implementation", 2023."""
    inset = np.maximum(color, 0) @ _AGX_INSET.T.astype(np.float32)
    stops = np.log2(np.maximum(inset, np.float32(1e-10)))
    x = np.clip((stops - _AGX_LOWEST) / (_AGX_HIGHEST - _AGX_LOWEST), 0, 1)
    shaped = np.polyval(np.array(_AGX_CURVE, np.float32), x)
    return np.clip(shaped @ _AGX_OUTSET.T, 0, 1) ** np.float32(2.2)


CURVES: dict[str, Callable[[Colors], Colors]] = {"none": clip, "reinhard": reinhard, "aces": aces, "agx": agx}


def tonemap(radiance: ArrayLike, *, exposure: float = 1.0, curve: str = "agx") -> Colors:
    """Display-linear colors (..., 3) in [0, 1] of radiance (..., 3) times exposure.

    curve is a name of `CURVES`. NaN becomes black, infinity white.
    """
    if curve not in CURVES:
        raise SolariError(f"there is no tone mapping '{curve}'; there are {', '.join(CURVES)}")
    with np.errstate(over="ignore"):  # becomes infinity, which is white
        exposed = np.asarray(radiance, np.float32) * np.float32(exposure)
    return CURVES[curve](np.nan_to_num(exposed, nan=0.0, posinf=1e6, neginf=0.0)).astype(np.float32)


def encode_srgb(linear: ArrayLike) -> Colors:
    """The sRGB transfer function (IEC 61966-2-1): linear [0, 1] to encoded [0, 1]."""
    x = np.clip(np.asarray(linear, np.float32), 0, 1)
    curved = 1.055 * x ** np.float32(1 / 2.4) - 0.055
    return np.where(x <= 0.0031308, x * 12.92, curved).astype(np.float32)


def decode_srgb(encoded: ArrayLike) -> Colors:
    """The inverse of `encode_srgb`."""
    x = np.clip(np.asarray(encoded, np.float32), 0, 1)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def auto_exposure(radiance: ArrayLike) -> float:
    """The EV100 that shows the log-average luminance of radiance (..., 3), in cd/m^2, as middle grey, 0.18.

    Black, and what is a million times darker than the mean, is left out, so a black background does not
    brighten the picture; a picture without light gives 0.
    """
    luminance = np.asarray(radiance, np.float64) @ LUMINANCE.astype(np.float64)
    luminance = luminance[np.isfinite(luminance) & (luminance > 0)]
    if not luminance.size:
        return 0.0
    luminance = luminance[luminance >= 1e-6 * luminance.mean()]
    average = np.exp(np.log(luminance).mean())
    return float(np.clip(np.log2(average / (1.2 * MIDDLE_GREY)), -100, 100))


# ---- files ------------------------------------------------------------------------------------------


def check_output(path: str | os.PathLike[str], suffixes: Sequence[str] = SUFFIXES) -> None:
    """Raise SolariError when nothing could be written there: none of the suffixes, or no such folder."""
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
    """Write radiance (height, width, 3), and layers (height, width) or (height, width, 1 to 4), by the path's suffix.

    .png: exposed, tone mapped, sRGB, 8 bits. .exr and .npy: radiance as it is, in cd/m^2; an .exr notes
    exposure and metadata (text by key). Layers become channels of the .exr ("depth", "normal.X", "albedo.R"),
    otherwise files of their own beside it ("picture.depth.npy"). Files appear whole or not at all.
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
        linear = globals()["tonemap"](picture, exposure=exposure, curve=tonemap)
        write_png(target, np.round(encode_srgb(linear) * 255).astype(np.uint8))
    for name, layer in layers.items():
        _write_npy(target.with_name(f"{target.stem}.{name}.npy"), layer)


def _write_npy(path: Path, array: NDArray[Any]) -> None:
    with whole_file(path) as temporary, open(temporary, "wb") as file:
        np.save(file, array)


def write_png(path: Path, codes: NDArray[np.uint8]) -> None:
    """Write what a screen shows, (height, width, 3 or 4), such as a frame's "display"."""
    from PIL import Image

    with whole_file(path) as temporary:
        Image.fromarray(codes).save(temporary, format="PNG")


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
    """A temporary path in the same folder that takes the path's place once it is written."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise SolariError(f"{path}: can't be written: {getattr(error, 'strerror', None) or error}") from None
    finally:
        temporary.unlink(missing_ok=True)
