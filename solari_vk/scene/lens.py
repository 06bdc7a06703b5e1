"""Lenses: how directions become positions of the picture, and back; glsl/scene/lens.glsl has the same for shaders.

Positions `at` are in focal lengths from the principal point, x right and y down; directions have x right, y down and z
forward, as in OpenCV.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError

Floats = NDArray[np.float64]
PROJECTIONS = ("perspective", "fisheye", "stereographic", "equirectangular", "cube")
PINHOLE, BROWN_CONRADY, FISHEYE, STEREOGRAPHIC, EQUIRECTANGULAR, CUBE = KINDS = range(6)  # as in glsl/scene/lens.glsl
TERMS = {
    "perspective": (0, 4, 5, 8, 12),
    "fisheye": (0, 4),
    "stereographic": (0,),
    "equirectangular": (0,),
    "cube": (0,),
}
"""How many numbers a distortion may have: k1, k2, p1, p2, k3 to k6, s1 to s4; of a fisheye k1 to k4."""
UNLIMITED = 1e30
NEWTON_STEPS = 20
NO_DISTORTION = (0.0,) * 12
# What is right in the picture of each face of a cube, below, and ahead; the faces are those of CameraRig.cube.
_AHEAD = np.array([(1, 0, 0), (-1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)], np.float64)
_BELOW = np.array([(0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, 1, 0)], np.float64)
CUBE_FACES = np.stack([np.cross(_BELOW, _AHEAD), _BELOW, _AHEAD], axis=1)
BEYOND = 2.0  # pixels around the picture that must be invertible too: filters reach there


class Lens(NamedTuple):
    """A lens as the shaders' struct Lens has it, and half the picture's width and height in focal lengths."""

    kind: int
    limit: float
    """What it sees: up to this angle from the view axis, in radians; of BROWN_CONRADY up to this slope."""
    reach: float
    """How far from the principal point that is in the picture."""
    distortion: tuple[float, ...]
    """Twelve numbers in OpenCV's order; the first of EQUIRECTANGULAR is how far the eye is right, in meters."""
    half: tuple[float, float]

    def starts(self, at: Floats) -> Floats:
        """Where the rays of positions (..., 2) start, (..., 3): not at 0 in omnidirectional stereo alone."""
        start = np.zeros((*at.shape[:-1], 3))
        if self.kind == EQUIRECTANGULAR:
            start[..., 0], start[..., 2] = np.cos(at[..., 0]), -np.sin(at[..., 0])
            start *= self.distortion[0]
        return start

    def directions(self, at: Floats) -> Floats:
        """What positions (..., 2) show, (..., 3); NaN where a lens sees nothing. z is 1, of wide lenses the length."""
        if self.kind == PINHOLE:
            return np.concatenate([at, np.ones_like(at[..., :1])], -1)
        if self.kind == BROWN_CONRADY:
            return np.concatenate([undistort(at, self.distortion), np.ones_like(at[..., :1])], -1)
        x, y = at[..., 0], at[..., 1]
        if self.kind == EQUIRECTANGULAR:
            return np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], -1)
        if self.kind == CUBE:
            # Six faces in a row, each two focal lengths wide, with the principal point between the third and the
            # fourth.
            face = np.clip(np.floor(x / 2 + 3), 0, 5).astype(int)
            local = np.stack([x + 5 - 2 * face, y, np.ones_like(x)], -1)
            local /= np.linalg.norm(local, axis=-1, keepdims=True)
            return np.asarray(np.einsum("...k,...ki->...i", local, CUBE_FACES[face]))
        radius = np.hypot(x, y)
        stereographic = self.kind == STEREOGRAPHIC
        angle = 2 * np.arctan(radius / 2) if stereographic else fisheye_angle(radius, self.distortion, self.limit)
        angle = np.where(radius > self.reach, np.nan, angle)
        # At the middle the ratio of sine and radius is 0 / 0, and the position is 0 anyway.
        around = at * np.divide(np.sin(angle), radius, out=np.ones_like(radius), where=radius > 0)[..., None]
        return np.concatenate([around, np.cos(angle)[..., None]], -1)

    def positions(self, points: Floats) -> Floats:
        """Where points (..., 3) are in the picture, (..., 2): NaN for those that the lens doesn't see."""
        x, y, z = np.moveaxis(points, -1, 0)
        across = np.hypot(x, y)
        if self.kind in (PINHOLE, BROWN_CONRADY):
            slopes = points[..., :2] / np.where(z > 0, z, np.nan)[..., None]
            if self.kind == PINHOLE:
                return slopes
            at = distort(slopes, self.distortion)[0]
            seen = np.linalg.norm(slopes, axis=-1) < self.limit
        elif self.kind == EQUIRECTANGULAR:
            eye = self.distortion[0]
            away = np.hypot(x, z)
            seen = away >= abs(eye)  # the ray to the point touches the circle on which the eye moves
            # Omnidirectional stereo: rays are tangents of the circle on which the eye moves, so that a point, its foot
            # on the circle and the center make a right angle.
            along = np.sqrt(np.maximum(away**2 - eye**2, 0))
            turn = np.arctan2(x, z) - np.arcsin(np.clip(eye / np.maximum(away, 1e-300), -1, 1))
            at = np.stack([turn - 2 * math.pi * np.round(turn / 2 / math.pi), np.arctan2(y, along)], -1)
        elif self.kind == CUBE:
            ahead = points @ _AHEAD.T
            face = ahead.argmax(axis=-1)
            local = np.einsum("...i,...ki->...k", points, CUBE_FACES[face])
            at = local[..., :2] / local[..., 2:] + np.stack([2.0 * face - 5, np.zeros(face.shape)], -1)
            return np.asarray(at)
        else:
            angle = np.arctan2(across, z)
            seen = angle < self.limit
            stereographic = self.kind == STEREOGRAPHIC
            radius = 2 * np.tan(angle / 2) if stereographic else fisheye_radius(angle, self.distortion)
            at = points[..., :2] * np.divide(radius, across, out=np.zeros_like(radius), where=across > 0)[..., None]
        return np.where(seen[..., None], at, np.nan)


def distort(slopes: Floats, distortion: tuple[float, ...]) -> tuple[Floats, Floats]:
    """The model of Brown and Conrady with OpenCV's further terms: where points with these slopes (..., 2) are, and the
    derivatives (..., 2, 2) of both coordinates."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = distortion
    x, y = slopes[..., 0], slopes[..., 1]
    r2 = x * x + y * y
    # The rational model of OpenCV (CALIB_RATIONAL_MODEL), whose radial part is a fraction of two polynomials, with the
    # tangential terms p and those of a thin prism, s.
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    scale = above / below
    slope = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - scale * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / below
    u = x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
    v = y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
    across = 2 * x * y * slope + 2 * (p1 * x + p2 * y)
    first, second = s1 + 2 * s2 * r2, s3 + 2 * s4 * r2
    derivative = np.stack(
        [
            scale + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + 2 * x * first,
            across + 2 * y * first,
            across + 2 * x * second,
            scale + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + 2 * y * second,
        ],
        -1,
    ).reshape(*x.shape, 2, 2)
    return np.stack([u, v], -1), derivative


def undistort(at: Floats, distortion: tuple[float, ...]) -> Floats:
    """The inverse of `distort`, by Newton's method."""
    slopes = at
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS):
            found, derivative = distort(slopes, distortion)
            (a, b), (c, d) = np.moveaxis(derivative, (-2, -1), (0, 1))
            u, v = np.moveaxis(found - at, -1, 0)
            # Newton's step: the inverse of a matrix of 2 x 2 times the error.
            slopes = slopes - np.stack([d * u - b * v, a * v - c * u], -1) / (a * d - b * c)[..., None]
    return slopes


def fisheye_radius(angle: Floats, distortion: tuple[float, ...]) -> Floats:
    """The model of Kannala and Brandt; without distortion the equidistant projection."""
    k1, k2, k3, k4 = distortion[:4]
    a2 = angle * angle
    radius: Floats = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    return radius


def _fisheye_slope(angle: Floats, distortion: tuple[float, ...]) -> Floats:
    k1, k2, k3, k4 = distortion[:4]
    a2 = angle * angle
    slope: Floats = 1 + a2 * (3 * k1 + a2 * (5 * k2 + a2 * (7 * k3 + a2 * 9 * k4)))
    return slope


def fisheye_angle(radius: Floats, distortion: tuple[float, ...], limit: float) -> Floats:
    """The inverse of `fisheye_radius` up to a limit, by Newton's method."""
    angle = np.minimum(radius, limit)
    with np.errstate(all="ignore"):
        for _ in range(NEWTON_STEPS if any(distortion) else 0):
            error = fisheye_radius(angle, distortion) - radius
            angle = np.clip(angle - error / _fisheye_slope(angle, distortion), 0, limit)
    return angle


@lru_cache(maxsize=256)
def make_lens(
    projection: str,
    half: tuple[float, float],
    center: tuple[float, float],
    distortion: tuple[float, ...],
    image_circle: float,
    size: tuple[int, int],
) -> Lens:
    """The lens of a picture. half: half its size in focal lengths. center: the principal point in shares of it.
    distortion: of an equirectangular camera how far the eye is right, in meters.

    Raises SolariError if the distortion isn't invertible in the picture; the text continues a camera's description.
    """
    terms = (*distortion, *NO_DISTORTION)[:12]
    if projection in ("equirectangular", "cube"):
        return Lens(CUBE if projection == "cube" else EQUIRECTANGULAR, UNLIMITED, UNLIMITED, terms, half)
    seen = min(image_circle / 2, math.pi)
    if projection == "stereographic":
        return Lens(STEREOGRAPHIC, seen, 2 * math.tan(seen / 2) if seen < math.pi else UNLIMITED, terms, half)
    if projection == "perspective" and not distortion:
        return Lens(PINHOLE, UNLIMITED, UNLIMITED, terms, half)
    at = _grid(half, center, size)
    lens = _fisheye(terms, seen, half) if projection == "fisheye" else _brown_conrady(terms, at, half)
    _check_invertible(lens, at, seen, distortion, size)
    return lens


def _grid(half: tuple[float, float], center: tuple[float, float], size: tuple[int, int]) -> Floats:
    """Positions (33, 33, 2) all over a picture, and BEYOND pixels around it."""
    steps = np.linspace(0, 1, 33)
    shares = np.stack(np.meshgrid(steps, steps), -1)
    beyond = np.sign(shares - 0.5) * BEYOND / np.array(size)
    return np.asarray((shares - center + beyond) * 2 * np.array(half))


def _check_invertible(
    lens: Lens, at: Floats, seen: float, distortion: tuple[float, ...], size: tuple[int, int]
) -> None:
    """Raise SolariError unless a direction that a position shows is at this position. at: positions in the picture.
    seen: the angle from the view axis that the lens should see."""
    radius = np.linalg.norm(at, axis=-1)
    inside = at[radius < lens.reach] if lens.kind == FISHEYE else at.reshape(-1, 2)
    with np.errstate(all="ignore"):
        error = np.abs(lens.positions(lens.directions(inside)) - inside).max(initial=0.0)
    # A fisheye may fold where nobody looks: outside of the picture or of the image circle.
    folds = lens.kind == FISHEYE and lens.limit < seen and radius.max() > lens.reach
    if error < 1e-6 and not folds:  # an error of NaN is one
        return
    remedy = ": check the order of its numbers, k1, k2, p1, p2, k3, ..."
    if folds:
        remedy = (
            f", beyond {math.degrees(lens.limit):.4g} degrees from the view axis: give image_circle, the "
            "angle in radians that the lens sees"
        )
    raise SolariError(
        f"the distortion {_shown(distortion)} isn't invertible in a picture of {size[0]}x{size[1]}, "
        f"where several directions have one place{remedy}"
    )


def _shown(distortion: tuple[float, ...]) -> str:
    return ", ".join(f"{number:g}" for number in distortion)


def _fisheye(terms: tuple[float, ...], seen: float, half: tuple[float, float]) -> Lens:
    """The fisheye up to where its radius begins to shrink."""
    angles = np.linspace(0, math.pi, 4097)
    # Beyond the angle at which the radius is largest, two directions would have one place.
    shrinks = _fisheye_slope(angles, terms) <= 0
    limit = min(seen, float(angles[max(int(shrinks.argmax()) - 1, 1)])) if shrinks.any() else seen
    reach = float(fisheye_radius(np.array(limit), terms))
    return Lens(FISHEYE, limit, reach, terms, half)


def _brown_conrady(terms: tuple[float, ...], at: Floats, half: tuple[float, float]) -> Lens:
    """The lens up to the first slope at which positions fold; at (..., 2): those of the picture."""
    turns = np.linspace(0, 2 * math.pi, 16, endpoint=False)
    # Even steps of angle, up to almost 90 degrees. Folds are where the derivative's determinant isn't positive.
    radii = np.tan(np.linspace(0, math.atan(1e3), 2049))
    with np.errstate(all="ignore"):
        derivative = distort(radii[:, None, None] * np.stack([np.cos(turns), np.sin(turns)], -1), terms)[1]
        folds = ~(np.linalg.det(derivative) > 0).all(axis=1)
    limit = float(radii[max(int(folds.argmax()) - 1, 1)]) if folds.any() else UNLIMITED
    return Lens(BROWN_CONRADY, limit, UNLIMITED, terms, half)
