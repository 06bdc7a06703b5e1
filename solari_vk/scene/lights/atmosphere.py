"""A clear sky with its sun, from the scattering of sunlight in the air.

Hillaire, "A Scalable and Production Ready Sky and Atmosphere Rendering Technique" (EGSR 2020), in numpy: single
scattering along each ray, and all further scattering as if it were the same in all directions. The air is that of
Bruneton and Neyret, "Precomputed Atmospheric Scattering" (EGSR 2008), with as much haze as the turbidity says.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]

# Lengths in km, coefficients in 1/km for red, green and blue.
GROUND, TOP = 6360.0, 6460.0  # radii of the ground and of the end of the atmosphere
EYE = GROUND + 0.002
RAYLEIGH = np.array((5.802, 13.558, 33.1)) * 1e-3
RAYLEIGH_HEIGHT = 8.0
HAZE_HEIGHT = 1.2
HAZE_ALBEDO = 0.9
HAZE_FORWARD = 0.8  # the mean cosine by which haze scatters light: Cornette and Shanks (1992)
OZONE = np.array((0.650, 1.881, 0.085)) * 1e-3
OZONE_CENTER, OZONE_HALF_WIDTH = 25.0, 15.0  # of a layer that is densest in its middle
HEIGHT, WIDTH = 256, 512  # of the map
_ROWS, _TURNS = 48, 33  # of the grid of rays over the sky
_STEPS = 48  # along each ray


@dataclass(frozen=True)
class Atmosphere:
    """Air with haze over even ground. turbidity: optical depth of air and haze over that of air alone, in green.

    albedo: of the ground, by color.
    """

    turbidity: float
    albedo: tuple[float, float, float]

    @functools.cached_property
    def haze(self) -> float:
        """What haze takes from light at the ground, in 1/km."""
        # The optical depth of a layer that thins out exponentially is its coefficient at the ground times its height.
        return float((self.turbidity - 1) * RAYLEIGH[1] * RAYLEIGH_HEIGHT / HAZE_HEIGHT)

    def scattering(self, height: Floats) -> tuple[Floats, Floats, Floats]:
        """Light that air and haze scatter, (..., 3) each, and that the atmosphere takes from a ray, at a height."""
        air = np.exp(-height / RAYLEIGH_HEIGHT)[..., None] * RAYLEIGH
        haze = np.exp(-height / HAZE_HEIGHT)[..., None] * np.full(3, self.haze)
        ozone = np.maximum(1 - np.abs(height - OZONE_CENTER) / OZONE_HALF_WIDTH, 0)[..., None] * OZONE
        return air, HAZE_ALBEDO * haze, air + haze + ozone

    @functools.cached_property
    def _transmittances(self) -> Floats:
        """Of rays to the top, over the radius (32) and the ray's length (128), in the coordinates of `_place`."""
        horizon = np.sqrt(TOP**2 - GROUND**2)
        radius = np.sqrt((np.linspace(0, 1, 32)[:, None] * horizon) ** 2 + GROUND**2)
        # As in Bruneton's implementation of 2017, rays are told apart by the length of their way to the top, from
        # straight up to along the horizon, which spends the table where the transmittance changes fast.
        shortest = TOP - radius
        longest = np.sqrt(np.maximum(radius**2 - GROUND**2, 0)) + horizon
        length = shortest + np.linspace(0, 1, 128) * (longest - shortest)
        cosine = np.ones_like(length)
        np.divide(TOP**2 - radius**2 - length**2, 2 * radius * length, out=cosine, where=length > 0)
        # Steps grow with the square, since the air is densest where most rays begin.
        share = (np.arange(64) + 0.5) / 64
        along = length[..., None] * share**2
        weight = length[..., None] * (2 * share / 64)
        height = np.sqrt(radius[..., None] ** 2 + along**2 + 2 * radius[..., None] * cosine[..., None] * along) - GROUND
        _, _, extinction = self.scattering(height)
        found: Floats = np.exp(-(extinction * weight[..., None]).sum(axis=-2))
        return found

    def transmittance(self, radius: Floats, cosine: Floats) -> Floats:
        """The share (..., 3) of sunlight that arrives at a radius, for a cosine at the zenith; 0 behind the ground."""
        horizon = np.sqrt(TOP**2 - GROUND**2)
        rim = np.sqrt(np.maximum(radius**2 - GROUND**2, 0))
        under_root = radius**2 * (cosine**2 - 1)
        length = -radius * cosine + np.sqrt(np.maximum(under_root + TOP**2, 0))
        shortest = TOP - radius
        longest = rim + horizon
        share = (length - shortest) / np.maximum(longest - shortest, 1e-9)
        found = interpolate(self._transmittances, rim / horizon * 31, share * 127)
        # A ray that goes down and meets the ground brings no sunlight.
        found[(cosine < 0) & (under_root + GROUND**2 > 0)] = 0
        return found

    @functools.cached_property
    def _scattered_often(self) -> Floats:
        """Light scattered at least twice, over the height (16) and the sun's cosine (32), for a sun of 1 lux."""
        height = np.linspace(0, 1, 16)[:, None] ** 2 * (TOP - GROUND - 0.01) + 0.005
        cosine = np.broadcast_to(np.linspace(-0.3, 1, 32), (16, 32))
        radius = np.broadcast_to(GROUND + height, cosine.shape)
        up = 1 - 2 * (np.arange(8) + 0.5) / 8
        # 64 directions, as in the paper, over one half of the sphere. The other half is its mirror image.
        turn = np.pi * (np.arange(8) + 0.5) / 8
        up, turn = (axis.ravel() for axis in np.meshgrid(up, turn))
        shape = (*radius.shape, len(up))
        radius, cosine = (np.broadcast_to(of[..., None], shape) for of in (radius, cosine))
        light, passed = self._gather(radius, cosine, np.broadcast_to(up, shape), np.broadcast_to(turn, shape))
        # Hillaire, equation 10: all orders of scattering after the second are a geometric series of the share that
        # comes back.
        found: Floats = light.mean(axis=-2) / (1 - passed.mean(axis=-2))
        return found

    def _gather(self, radius: Floats, cosine: Floats, up: Floats, turn: Floats) -> tuple[Floats, Floats]:
        """The second scattering along rays: its light, and the share of even light that comes back (..., 3) each."""
        # 20 steps a ray, as in the paper: what is scattered several times is smooth.
        steps = 20
        under_root = radius**2 * (up**2 - 1)
        to_ground = (up < 0) & (under_root + GROUND**2 > 0)
        end = np.where(
            to_ground,
            -radius * up - np.sqrt(np.maximum(under_root + GROUND**2, 0)),
            -radius * up + np.sqrt(np.maximum(under_root + TOP**2, 0)),
        )
        toward_sun = up * cosine + np.sqrt((1 - up**2) * (1 - cosine**2)) * np.cos(turn)
        light, back, seen = (np.zeros((*up.shape, 3)) for _ in range(3))
        seen += 1
        for step in range(steps):
            at = end * ((step + 0.5) / steps)
            here = np.sqrt(radius**2 + at**2 + 2 * radius * up * at)
            sun = (radius * cosine + at * toward_sun) / here
            air, haze, extinction = self.scattering(here - GROUND)
            # Within a step the light that is scattered towards the eye is integrated exactly: (1 - lost) / extinction.
            lost = np.exp(-extinction * (end / steps)[..., None])
            share = seen * (air + haze) * (1 - lost) / np.maximum(extinction, 1e-12)
            light += share * self.transmittance(here, sun) / (4 * np.pi)
            back += share
            seen = seen * lost
        here = np.sqrt(radius**2 + end**2 + 2 * radius * up * end)
        sun = (radius * cosine + end * toward_sun) / here
        ground = np.asarray(self.albedo) / np.pi * (np.maximum(sun, 0)[..., None] * self.transmittance(here, sun))
        # The ground reflects sunlight too, as a matte surface.
        light += np.where(to_ground[..., None], seen * ground, 0)
        return light, back

    def scattered_often(self, height: Floats, cosine: Floats) -> Floats:
        """Light (..., 3) scattered at least twice at a height, the same in all directions, for a sun of 1 lux."""
        row = np.sqrt(np.clip(height, 0, None) / (TOP - GROUND)) * 15
        return interpolate(self._scattered_often, row, (cosine + 0.3) / 1.3 * 31)


def interpolate(table: Floats, row: Floats, column: Floats) -> Floats:
    """Bilinear interpolation in a table (R, C, ...) at rows and columns, which are clamped to it."""
    row, column = (np.clip(at, 0, size - 1.000001) for at, size in zip((row, column), table.shape, strict=False))
    top, left = row.astype(int), column.astype(int)
    down, right = (row - top)[..., None], (column - left)[..., None]
    upper = table[top, left] * (1 - right) + table[top, left + 1] * right
    lower = table[top + 1, left] * (1 - right) + table[top + 1, left + 1] * right
    found: Floats = upper * (1 - down) + lower * down
    return found


@functools.lru_cache(maxsize=4)
def atmosphere(turbidity: float, albedo: tuple[float, float, float]) -> Atmosphere:
    """The atmosphere, whose tables are kept while only the sun moves."""
    return Atmosphere(turbidity, albedo)


def sky_map(air: Atmosphere, sun_height: float) -> Floats:
    """The radiance (HEIGHT, WIDTH, 3) of a sky under a sun of 1 lux whose direction's sine above the horizon is given.

    The sun stands over the middle column. It is not in the map. The lower half is the ground.
    """
    # Light is gathered for a coarse grid of rays, and without the phase functions, which vary faster than it: they
    # follow for each texel.
    rows = np.linspace(0, 1, _ROWS) ** 2 * (np.pi / 2)  # elevations, densest at the horizon
    turns = np.linspace(0, np.pi, _TURNS)
    up = np.sin(rows)[:, None] * np.ones(_TURNS)
    turn = turns * np.ones((_ROWS, 1))
    toward_sun = up * sun_height + np.sqrt((1 - up**2) * (1 - sun_height**2)) * np.cos(turn)
    end = -EYE * up + np.sqrt(EYE**2 * (up**2 - 1) + TOP**2)
    seen = np.ones((*up.shape, 3))
    by_air, by_haze, by_all = (np.zeros((*up.shape, 3)) for _ in range(3))
    for step in range(_STEPS):
        # As above, steps grow with the square.
        first = (step / _STEPS) ** 2
        last = ((step + 1) / _STEPS) ** 2
        at = end * ((step + 0.5) / _STEPS) ** 2
        length = end * (last - first)
        here = np.sqrt(EYE**2 + at**2 + 2 * EYE * up * at)
        sun = (EYE * sun_height + at * toward_sun) / here
        air_here, haze_here, extinction = air.scattering(here - GROUND)
        lost = np.exp(-extinction * length[..., None])
        share = seen * (1 - lost) / np.maximum(extinction, 1e-12)
        arriving = air.transmittance(here, sun)
        by_air += share * air_here * arriving
        by_haze += share * haze_here * arriving
        by_all += share * (air_here + haze_here) * air.scattered_often(here - GROUND, sun)
        seen = seen * lost

    elevation = np.pi / 2 - np.pi * (np.arange(HEIGHT // 2) + 0.5) / HEIGHT
    longitude = np.abs(2 * np.pi * ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5))
    row, column = np.meshgrid(
        np.sqrt(elevation / (np.pi / 2)) * (_ROWS - 1), longitude / np.pi * (_TURNS - 1), indexing="ij"
    )
    cosine = np.sin(elevation)[:, None] * sun_height + np.cos(elevation)[:, None] * np.cos(longitude) * np.sqrt(
        1 - sun_height**2
    )
    g = HAZE_FORWARD
    # Rayleigh's phase function, and that of Cornette and Shanks for haze.
    phase_of_air = 3 / (16 * np.pi) * (1 + cosine**2)
    phase_of_haze = 3 / (8 * np.pi) * (1 - g**2) * (1 + cosine**2) / ((2 + g**2) * (1 + g**2 - 2 * g * cosine) ** 1.5)
    upper = (
        interpolate(by_air, row, column) * phase_of_air[..., None]
        + interpolate(by_haze, row, column) * phase_of_haze[..., None]
        + interpolate(by_all, row, column)
    )
    # The ground is lit by the whole sky and the sun, and reflects it evenly.
    weights = (np.sin(elevation) * np.cos(elevation) * (np.pi / HEIGHT) * (2 * np.pi / WIDTH))[:, None, None]
    arriving = max(sun_height, 0.0) * air.transmittance(np.array([EYE]), np.array([sun_height]))[0]
    ground = np.asarray(air.albedo) / np.pi * ((upper * weights).sum(axis=(0, 1)) + arriving)
    return np.concatenate([upper, np.broadcast_to(ground, upper.shape)])
