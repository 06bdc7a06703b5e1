"""One frame of a sequence from a window of frames before and after it.

Each frame is denoised by OIDN alone, with albedo and normals that OIDN has cleaned first. Then a pixel takes the mean
over the frames in which its surface is seen, along the motion, as far as light and albedo are the same there. What OIDN
leaves of the noise differs from frame to frame, so that the mean has less of it, and hardly flickers. Weights are those
of non-local means with guides (Rousselle et al., "Robust Denoising using Feature and Color Information", 2013): a
difference counts against the noise that it would have by chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.output import oidn
from solari_vk.output.sequences.motion import inverted
from solari_vk.output.sequences.resample import (
    bilinear,
    bilinear_taps,
    box_mean,
    limited,
    nearest,
    pixel_grid,
    spline,
    spline_coefficients,
)

Floats = NDArray[np.float32]
_LEAST_ALBEDO = 0.05  # light is radiance over albedo: of darker surfaces it would be all noise
_NOISE_RADIUS = 2
_PATCH_RADIUS = 2
_LEFT_BY_OIDN = 0.03  # of the variance of the noise of a frame, about
_MARGIN = _NOISE_RADIUS + _PATCH_RADIUS
_BAND_PIXELS = 1 << 19
# How far normals and logarithms of depth of one surface may differ.
_NORMALS = 0.3
_DEPTHS = 0.1
# Squared differences count against these shares of the noise's variance, and against what eyes don't see of light or
# albedo anyway.
_LIGHT_NOISE, _LIGHT_SHARE = 2.0, 0.05
_ALBEDO_NOISE, _ALBEDO_STEP = 1.0, 0.03


@dataclass
class Prepared:
    """A frame that OIDN has denoised alone, and what tells how far others may be averaged with it."""

    clean: Floats
    """(height, width, 3), by OIDN."""
    coefficients: Floats
    """Of the splines through it."""
    tests: Floats
    """(height, width, 8): light, albedo, and the variance of the noise of each."""
    normal: Floats | None
    log_depth: Floats | None
    to_previous: Floats | None
    """(height, width, 2): offsets in pixels; None at rest, as the next one."""
    to_next: Floats | None

    @property
    def mean_light(self) -> float:
        """Of the whole picture."""
        return float(self.tests[..., :3].mean())

    def rows(self, first: int, last: int) -> Prepared:
        """Some rows of it, without motion."""
        normal = None if self.normal is None else self.normal[first:last]
        depth = None if self.log_depth is None else self.log_depth[first:last]
        clean, tests = self.clean[first:last], self.tests[first:last]
        return Prepared(clean, self.coefficients[first:last], tests, normal, depth, None, None)


def prepare(
    color: Floats,
    albedo: Floats | None,
    normal: Floats | None,
    depth: Floats | None,
    to_previous: Floats | None,
    to_next: Floats | None,
) -> Prepared:
    """Denoise a frame alone. Raises SolariError without OIDN."""
    smooth_albedo = None if albedo is None else oidn.prefilter("albedo", albedo)
    smooth_normal = None if normal is None else oidn.prefilter("normal", normal)
    clean = oidn.denoise(color, smooth_albedo, smooth_normal)
    tests = np.zeros((*color.shape[:2], 8), np.float32)
    divisor: Floats | float = 1.0
    if albedo is not None and smooth_albedo is not None:
        divisor = np.maximum(smooth_albedo, _LEAST_ALBEDO)
        tests[..., 3:6] = smooth_albedo
        tests[..., 7] = box_mean(((albedo - smooth_albedo) ** 2).mean(axis=-1), _NOISE_RADIUS)
    tests[..., :3] = clean / divisor
    tests[..., 6] = box_mean((((color - clean) / divisor) ** 2).mean(axis=-1), _NOISE_RADIUS)
    log_depth = None if depth is None else np.log(np.clip(depth, 1e-6, 1e6))
    return Prepared(clean, spline_coefficients(clean), tests, smooth_normal, log_depth, to_previous, to_next)


class Blend(NamedTuple):
    """A denoised frame."""

    picture: Floats
    """(height, width, 3)."""
    error: Floats
    """The standard error of each pixel, (height, width), by how much the frames of the mean differ."""


def blended(window: Mapping[int, Prepared], middle: int) -> Blend:
    """The mean of a window's frames for the frame `middle`. window: frames by number, without gaps."""
    height, width = window[middle].clean.shape[:2]
    # Bands of rows bound what is computed at a time; patches reach into the next one.
    rows = max(_BAND_PIXELS // width, 4 * _MARGIN)
    bands = []
    for top in range(0, height, rows):
        first, last = max(0, top - _MARGIN), min(height, top + rows + _MARGIN)
        band = _blended_rows(window, middle, first, last)
        bands.append([part[top - first : top - first + rows] for part in band])
    return Blend(*(np.concatenate(parts) for parts in zip(*bands, strict=True)))


def _blended_rows(window: Mapping[int, Prepared], middle: int, first: int, last: int) -> Blend:
    frame = window[middle].rows(first, last)
    total = frame.clean.copy()
    squared = (frame.clean**2).mean(axis=-1)
    weights = np.ones(total.shape[:2], np.float32)
    squared_weights = np.ones(total.shape[:2], np.float32)
    for number, places, inside in _trajectories(window, middle, first, last):
        other = window[number]
        weight = inside * _surface_share(frame, other, places) * _agreement(frame, other, places)
        value = limited(spline(other.coefficients, places), other.clean, places)
        total += weight[..., None] * value
        squared += weight * (value**2).mean(axis=-1)
        weights += weight
        squared_weights += weight * weight
    mean = total / weights[..., None]
    # The scatter of the frames around their mean says how far one of them is off, over the square of the light, so that
    # a lamp isn't pooled with the wall beside it. Few frames say little: a share of the noise before OIDN counts as one
    # more.
    level = (np.maximum(mean, 0) ** 2).mean(axis=-1) + 1e-4 * float(window[middle].clean.mean()) ** 2 + 1e-20
    scatter = np.maximum(squared / level - weights * (mean**2).mean(axis=-1) / level, 0)
    light = (frame.tests[..., :3] ** 2).mean(axis=-1) + 1e-20
    alone = _LEFT_BY_OIDN * np.minimum(frame.tests[..., 6] / light, 1)
    variance = level * box_mean(scatter + alone, _NOISE_RADIUS) / box_mean(weights, _NOISE_RADIUS)
    return Blend(np.maximum(mean, 0), np.sqrt(variance * squared_weights / weights**2))


def _trajectories(
    window: Mapping[int, Prepared], middle: int, first: int, last: int
) -> Iterator[tuple[int, Floats, NDArray[np.bool_]]]:
    """Of each other frame: its number, where it shows the pixels of some rows of the middle one, and whether that is in
    the picture."""
    height, width = window[middle].clean.shape[:2]
    limits = np.array((width, height)) - 0.5
    for step in (-1, 1):
        places = pixel_grid(height, width)[first:last]
        inside = np.ones(places.shape[:2], np.bool_)
        number = middle
        while number + step in window:
            offsets = _offsets(window, number, step)
            if offsets is not None:
                places = places + nearest(offsets, places)
            number += step
            inside = inside & ((places > -0.5) & (places < limits)).all(axis=-1)
            yield number, places, inside


def _offsets(window: Mapping[int, Prepared], number: int, step: int) -> Floats | None:
    """Where the pixels of a frame are in the next one (step 1), or the previous one (-1)."""
    here, there = window[number], window[number + step]
    if step > 0:
        if here.to_next is None and there.to_previous is not None:
            here.to_next = inverted(there.to_previous)
        return here.to_next
    if here.to_previous is None and there.to_next is not None:
        here.to_previous = inverted(there.to_next)
    return here.to_previous


def change(window: Mapping[int, Prepared], number: int, picture: Floats, previous: Floats) -> Floats:
    """How far a denoised frame differs from the one before it, (height, width), where that shows the same surfaces."""
    frame, other = window[number], window[number - 1]
    places = pixel_grid(*picture.shape[:2])
    offsets = _offsets(window, number, -1)
    if offsets is not None:
        places = places + offsets
    inside = ((places >= 0) & (places <= np.array(picture.shape[1::-1]) - 1)).all(axis=-1)
    difference = ((bilinear(previous, places) - picture) ** 2).mean(axis=-1)
    return np.asarray(inside * _surface_share(frame, other, places) * np.sqrt(difference), np.float32)


def _surface_share(frame: Prepared, other: Prepared, places: Floats) -> Floats:
    """How much of the four pixels around a place shows a surface with the same normal and depth."""
    share = np.zeros(places.shape[:2], np.float32)
    for rows, columns, weight in bilinear_taps(places, *other.clean.shape[:2]):
        difference = np.zeros(places.shape[:2], np.float32)
        if frame.normal is not None and other.normal is not None:
            difference += ((other.normal[rows, columns] - frame.normal) ** 2).sum(axis=-1) / _NORMALS**2
        if frame.log_depth is not None and other.log_depth is not None:
            difference += ((other.log_depth[rows, columns] - frame.log_depth) / _DEPTHS) ** 2
        share += weight * np.exp(-difference)
    return share


def _agreement(frame: Prepared, other: Prepared, places: Floats) -> Floats:
    """How far light and albedo of patches are the same, but for noise, from 0 to 1."""
    found = bilinear(other.tests, places)
    squares = (found[..., :6] - frame.tests[..., :6]) ** 2
    # The smaller noise of the two: what is bright has more of it, and would pass for anything that is dark.
    # Where chance finds the sun in one path of many, both have so much that all would agree: never more than the light.
    noise = 2 * np.minimum(found[..., 6:], frame.tests[..., 6:])
    level = (frame.tests[..., :3] ** 2).mean(axis=-1)
    unseen = level + 0.01 * other.mean_light**2
    light = box_mean(squares[..., :3].mean(axis=-1), _PATCH_RADIUS)
    albedo = box_mean(squares[..., 3:6].mean(axis=-1), _PATCH_RADIUS)
    difference = light / (_LIGHT_NOISE * np.minimum(noise[..., 0], 2 * level) + _LIGHT_SHARE**2 * unseen + 1e-20)
    difference += albedo / (_ALBEDO_NOISE * noise[..., 1] + _ALBEDO_STEP**2)
    agreement: Floats = np.exp(-difference)
    return agreement
