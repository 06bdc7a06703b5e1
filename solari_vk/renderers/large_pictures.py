"""Pictures larger than a device holds: the path tracer renders them in bands of rows."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_name
from solari_vk.gpu.device.device import Device
from solari_vk.output import oidn
from solari_vk.output.tone_mapping import auto_exposure
from solari_vk.passes.reference import numbered_seed
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.scene_frame import checked_device
from solari_vk.scene.model import Camera, Scene

GUIDES = ("guide_albedo", "guide_normal")
LARGEST_BAND = 1 << 26  # pixels, for all the buffers of which there is memory on most devices


def checked_size(who: str, size: Any) -> tuple[int, int]:
    """A picture's size as two ints. Raises SolariError unless it is two whole numbers from 1 on."""
    try:
        width, height = (operator.index(side) for side in size)
    except (TypeError, ValueError):
        width = height = 0
    if width < 1 or height < 1:
        raise SolariError(f"{who}: size must be two whole numbers from 1 on (width, height), not {quoted(size)}")
    return width, height


def band_rows(device: Device, size: tuple[int, int], most: int | None = None) -> int:
    """The rows of each band of a picture but the last; all of them where the device holds the picture.

    most: the most pixels of a band, if that is less than what the device holds and LARGEST_BAND. Raises SolariError for
    a size that isn't two whole numbers above 0, and where not even a row fits.
    """
    width, height = checked_size("render_large", size)
    limits = checked_device(device, "render_large").properties.limits
    pixels_of_device = int(limits.maxStorageBufferRange) // PathTracer.LARGEST_PIXEL_BYTES
    most_rows = min(pixels_of_device, LARGEST_BAND, most or pixels_of_device) // width
    if most_rows < 1:
        raise SolariError(f"render_large: a band holds fewer than the {width} pixels of a row")
    # As few bands as possible, and all of nearly the same height.
    band_count = math.ceil(height / most_rows)
    return math.ceil(height / band_count)


def band_camera(camera: Camera, size: tuple[int, int], top: int, rows: int) -> Camera:
    """The camera of some rows of a picture of this size, from the row `top` on. Raises SolariError for a lens."""
    if camera.has_lens:
        raise SolariError(
            f"{camera.describe()}: a picture in bands, larger than the device holds, has no distortion "
            "and no fisheye: render a smaller one"
        )
    share = rows / size[1]
    x, y = camera.principal_point
    offset = top + rows / 2 - size[1] * y  # from the principal point down to the middle of the band, in pixels
    # The film of a pinhole camera is flat, so that a part of it is the film of a camera with a smaller field of view
    # whose principal point is elsewhere; the jitter carries that offset.
    return dataclasses.replace(
        camera,
        vertical_fov=2 * math.atan(share * math.tan(camera.vertical_fov / 2)),
        auto_exposure=False,
        orthographic_height=share * camera.orthographic_height,
        jitter=camera.jitter + np.array((0, offset)),
        principal_point=np.array((x, 0.5)),
    )


@checked_keywords(who="solari_vk")
def render_large(
    device: Device,
    scene: Scene,
    size: tuple[int, int],
    *,
    camera: Camera | None = None,
    samples: int = 256,
    denoise: bool = False,
    layers: Sequence[str] = (),
    band_pixels: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> dict[str, NDArray[Any]]:
    """A picture of any size by the path tracer, in bands of rows that the device holds: arrays (height, width, ...).

    The result has "radiance" (height, width, 3) in cd/m^2, and what `layers` names, as frames have them. samples per
    pixel, denoise and options (max_bounces, seed, ...) are those of PathTracer; the whole picture is denoised at once.
    band_pixels: the most of a band, by default what the device holds. progress: is called with the samples per pixel of
    all bands so far, and how many there will be. A camera with auto_exposure gets the EV100 that suits the picture;
    `save_image` takes `exposure=camera.exposure`. Raises SolariError as PathTracer does.
    """
    rows = band_rows(device, size, band_pixels)
    width, height = size
    seed = options.get("seed", 0)
    if denoise:
        oidn.check_installed()
    _check_layers(layers)
    pictures: dict[str, NDArray[Any]] = {}
    with PathTracer(device, scene, (width, rows), **options) as tracer:
        shown = scene.camera_for(width / height) if camera is None else camera
        # The exposure is that of surfaces where there is an environment behind them.
        meters_surfaces = shown.auto_exposure and scene.environment is not None
        names = {"radiance", *layers}
        if meters_surfaces:
            names.add("depth")
        tops = range(0, height, rows)
        for band, top in enumerate(tops):
            row_count = min(rows, height - top)
            if tracer.size[1] != row_count:
                tracer.resize((width, row_count))
            # Bands with one seed would have the same noise, which shows as a pattern.
            tracer.seed = numbered_seed(seed, band)
            report = None if progress is None else partial(_report, progress, band * samples, samples * len(tops))
            tracer.render(band_camera(shown, size, top, row_count), samples, progress=report)
            found = {name: tracer[name] for name in names}
            if denoise:
                found |= zip(GUIDES, tracer.read_guides(), strict=True)
            _store_rows(pictures, found, top, height)
    if denoise:  # the whole picture at once, since bands denoised one by one would show their borders
        guides = [pictures.pop(name) for name in GUIDES]
        pictures["radiance"] = oidn.denoise(pictures["radiance"], *guides)
    if shown.auto_exposure:
        surfaces = np.isfinite(pictures["depth"]) if meters_surfaces else None
        shown.ev100 = auto_exposure(pictures["radiance"], surfaces)
    return {name: pictures[name] for name in ("radiance", *layers)}


def _check_layers(layers: Sequence[str]) -> None:
    """Raise SolariError for names of results that the path tracer hasn't."""
    unknown = set(layers) - set(PathTracer.OUTPUTS)
    if unknown:
        raise unknown_name("render_large: there is no result", min(unknown), PathTracer.OUTPUTS)


def _store_rows(pictures: dict[str, NDArray[Any]], found: dict[str, NDArray[Any]], top: int, height: int) -> None:
    """Store the results of a band in the pictures, which are made of the first one."""
    for name, values in found.items():
        if name not in pictures:
            pictures[name] = np.empty((height, *values.shape[1:]), values.dtype)
        pictures[name][top : top + len(values)] = values


def _report(progress: Callable[[int, int], None], before: int, total: int, done: int) -> None:
    progress(before + done, total)
