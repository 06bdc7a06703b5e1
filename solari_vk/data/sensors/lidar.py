"""Spinning lidars: channels at fixed elevations, which turn about the vertical axis."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import Hints, SolariError, checked_constructor
from solari_vk.data.sensors.echoes import Echoes, check_tracer, checked_numbers, find_echoes, from_preset
from solari_vk.data.sensors.lidar_scan import LidarScan
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene import checks

Floats = NDArray[np.float64]
THRESHOLD_TO_NOISE = 6.0  # standard deviations: noise alone passes in one of 1e9 pulses
NINETY_PERCENT = 1.2815515655446004  # standard deviations below which a normal number lies in nine of ten cases
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
FWHM_PER_SIGMA = 2 * math.sqrt(2 * math.log(2))


def _spread(first: float, last: float, count: int) -> tuple[float, ...]:
    return tuple(np.radians(np.linspace(first, last, count)).tolist())


# Of the makers' documents; what neither names has Lidar's default.
# VLP-16: Velodyne's data sheet 63-9229 and user manual 63-9243. elevations: "vertical angle" of table 9-1, every 2
# degrees; azimuth_steps and period: "rotation rate" 10 Hz, and its "angular resolution (horizontal)" of 0.2 degrees;
# max_range: "measurement range"; range_noise: "range accuracy, typical", taken as a standard deviation;
# range_resolution: "granularity" of distances in packets; returns: "dual return". min_range is an estimate.
# OS1-64, OS1-128: Ouster's data sheet "OS1, High Resolution Imaging LIDAR", first generation. elevations: "field of
# view, vertical", spaced evenly; azimuth_steps: "horizontal resolution"; period: "rotation rate" 10 Hz; min_range,
# max_range: "range" at a reflectivity of 80 %; reference: "range" at 10 %; range_noise: "range repeatability, 1 sigma"
# at a high signal; range_resolution: "range resolution"; divergence: "beam divergence, FWHM"; returns: "# of returns".
PRESETS: dict[str, dict[str, Any]] = {
    "VLP-16": {
        "elevations": _spread(-15, 15, 16),
        "azimuth_steps": 1800,
        "period": 0.1,
        "min_range": 0.5,
        "max_range": 100.0,
        "range_noise": 0.03,
        "range_resolution": 0.002,
        "returns": 2,
    },
    "OS1-64": {
        "elevations": _spread(-16.6, 16.6, 64),
        "azimuth_steps": 1024,
        "period": 0.1,
        "min_range": 0.8,
        "max_range": 120.0,
        "range_noise": 0.015,
        "range_resolution": 0.012,
        "divergence": math.radians(0.13),
        "reference": (40.0, 0.1),
    },
    "OS1-128": {
        "elevations": _spread(-22.5, 22.5, 128),
        "azimuth_steps": 2048,
        "period": 0.1,
        "min_range": 0.8,
        "max_range": 120.0,
        "range_noise": 0.015,
        "range_resolution": 0.012,
        "divergence": math.radians(0.18),
        "reference": (40.0, 0.1),
    },
}


@checked_constructor
@dataclass(frozen=True, kw_only=True)
class Lidar(Hints):
    """A spinning lidar. In its own frame y is up, and at the azimuth 0 it looks along -z, as cameras do; it turns to
    the right, clockwise as seen from above.

    elevations (channels,) in radians above the horizon. azimuth_steps: columns of a turn, in which all channels fire;
    azimuths: of the first column, and of the one after the last, in radians. period: seconds that these take.
    min_range, max_range: meters between which echoes count. returns: of a pulse at most; of more the strongest count.
    separation: meters; echoes of a pulse that are closer are one, at their mean distance by power.

    divergence: of the beam, in radians, between the angles of half the power of a Gaussian. rays_per_beam: rays that
    sample it; 1 has none. max_surfaces: that a ray meets, through glass and blended surfaces; those that
    are fully transparent don't count.

    range_noise: the standard deviation of distances, in meters. range_resolution: distances are multiples of it.
    reference: a distance in meters and a reflectivity: a Lambertian surface there that faces the sensor is detected in
    nine of ten pulses; (0, 0): echoes however faint are. The received power falls with the squared distance; noise of
    the receiver is Gaussian, also of the intensity, and the threshold six standard deviations (Richmond and Cain,
    "Direct-Detection LADAR Systems", 2010).

    `Lidar.preset(name)` has the numbers of a data sheet: PRESETS. Raises SolariError for numbers out of range.
    """

    elevations: tuple[float, ...]
    azimuth_steps: int = 1024
    azimuths: tuple[float, float] = (0.0, 2 * math.pi)
    period: float = 0.1
    min_range: float = 0.1
    max_range: float = 100.0
    returns: int = 1
    separation: float = 0.5
    divergence: float = 0.0
    rays_per_beam: int = 1
    max_surfaces: int = 8
    range_noise: float = 0.0
    range_resolution: float = 0.0
    reference: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, length in (("elevations", None), ("azimuths", 2), ("reference", 2)):
            try:
                values = checks.array(length, dtype=np.float64)(getattr(self, name))
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"Lidar: {name} {error}") from None
            object.__setattr__(self, name, tuple(values.tolist()))
        for name in ("azimuth_steps", "returns", "rays_per_beam", "max_surfaces"):
            checks.check_whole(f"Lidar: {name}", getattr(self, name), 1)
        checked_numbers(
            self,
            {
                "period": (0, 1e6, "s"),
                "min_range": (0, 1e6, "m"),
                "max_range": (1e-3, 1e6, "m"),
                "separation": (0, 1e6, "m"),
                "divergence": (0, 1, "radians"),
                "range_noise": (0, 1e3, "m"),
                "range_resolution": (0, 1e3, "m"),
            },
        )
        if not self.elevations or max(map(abs, self.elevations)) > math.pi / 2 + 1e-9:
            raise SolariError(
                "Lidar: elevations are angles between -pi/2 and pi/2 radians, at least one: "
                "np.radians(...) takes degrees"
            )
        if not self.min_range < self.max_range:
            raise SolariError(f"Lidar: min_range, {self.min_range:g} m, must be below max_range, {self.max_range:g} m")
        if any(self.reference) and not min(self.reference) > 0:
            raise SolariError(
                f"Lidar: reference is a distance and a reflectivity above 0, or (0, 0), not {self.reference}"
            )

    @classmethod
    def preset(cls, name: str, **fields: Any) -> Lidar:
        """A lidar by the numbers of its maker's documents, changed by these fields.

        "VLP-16" (Velodyne 63-9229, 63-9243): 16 channels of table 9-1; 0.2 degrees and 10 Hz of "rotation rate"; 100 m
        of "measurement range"; "range accuracy, typical" as range_noise; 2 mm of packets; two returns of "dual return".
        Its min_range is an estimate, and detection isn't named. "OS1-64" and "OS1-128" (Ouster OS1, first generation):
        "field of view", spaced evenly; "horizontal resolution" at 10 Hz; "range" at 80 % as limits, and at 10 % as
        reference; "range repeatability" at a high signal as range_noise; "range resolution"; "beam divergence".
        """
        made: Lidar = from_preset(cls, PRESETS, name, fields)
        return made

    @property
    def column_azimuths(self) -> Floats:
        """The azimuth of each column, (azimuth_steps,) in radians."""
        first, end = self.azimuths
        return first + (end - first) * np.arange(self.azimuth_steps) / self.azimuth_steps

    @property
    def column_times(self) -> Floats:
        """When each column fires, (azimuth_steps,) in seconds since the scan began."""
        return np.asarray(self.period * np.arange(self.azimuth_steps) / self.azimuth_steps, np.float64)

    @property
    def directions(self) -> Floats:
        """The axis of each beam in the sensor's frame, (channels, azimuth_steps, 3)."""
        return self._axes()[2]

    def _axes(self) -> tuple[Floats, Floats, Floats]:
        """What is right of each beam, above it, and along it, (channels, azimuth_steps, 3) each."""
        elevation, azimuth = np.meshgrid(self.elevations, self.column_azimuths, indexing="ij")
        level, height = np.cos(elevation), np.sin(elevation)
        sine, cosine = np.sin(azimuth), np.cos(azimuth)
        right = np.stack([cosine, np.zeros_like(elevation), sine], -1)
        up = np.stack([-height * sine, level, height * cosine], -1)
        along = np.stack([level * sine, height, -level * cosine], -1)
        return right, up, along

    def scan(
        self, tracer: RayTracer, pose: ArrayLike | Callable[[float], ArrayLike], *, seed: int = 0, noise: bool = True
    ) -> LidarScan:
        """One turn of the sensor through a tracer's scene.

        pose: world from sensor, a transform (4, 4) or a position (3,); one for each column, (azimuth_steps, 4, 4); or a
        function of the time in seconds since the scan began, for a sensor that moves meanwhile. noise: of distances
        and of the receiver, by numpy's `default_rng(seed)`; without it an echo is detected above the threshold. The
        scene stands still. Rays meet the backs of surfaces too. Raises SolariError for a wrong pose or seed.
        """
        check_tracer("Lidar.scan", tracer)
        checks.check_whole("Lidar.scan: seed", seed)
        poses = self._poses(pose)
        right, up, along = self._axes()
        shape = (*along.shape[:2], self.rays_per_beam)
        # Angles are so small that their tangents are they themselves; FWHM / 2.355 is a Gaussian's standard deviation.
        offsets = _beam_profile(self.rays_per_beam) * self.divergence / FWHM_PER_SIGMA
        rays = along[:, :, None] + right[:, :, None] * offsets[:, :1] + up[:, :, None] * offsets[:, 1:]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        # Each column (s) of each channel (c) has rays (r), which the pose of the column turns.
        rays = np.einsum("sij,csrj->csri", poses[:, :3, :3], rays).reshape(-1, 3)
        origins = np.broadcast_to(poses[None, :, None, :3, 3], (*shape, 3)).reshape(-1, 3)
        found = find_echoes(tracer, origins, rays, 0.0, self.max_range, self.max_surfaces)
        return self._detect(found, poses, np.einsum("sij,csj->csi", poses[:, :3, :3], along), seed, noise)

    def _detect(self, found: Echoes, poses: Floats, along: Floats, seed: int, noise: bool) -> LidarScan:
        """What the receiver makes of echoes: those of a beam that are close are one, and weak ones are lost."""
        channels, steps = along.shape[:2]
        rng = np.random.default_rng(seed)
        # The echoes by beam, and of a beam by distance.
        valid = np.flatnonzero(found.distance >= self.min_range)
        order = valid[np.lexsort((found.distance[valid], found.ray[valid] // self.rays_per_beam))]
        beam = found.ray[order] // self.rays_per_beam
        distance = found.distance[order]
        instance = found.instance[order]
        # A beam's rays have equal shares of its power, which falls with the squared distance.
        power = found.strength[order] / self.rays_per_beam / distance**2
        # Echoes of a beam that follow each other within the separation are one.
        apart = np.diff(distance, prepend=-np.inf) > self.separation
        begins = np.flatnonzero((np.diff(beam, prepend=-1) != 0) | apart)
        total = _sums(power, begins)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(total > 0, _sums(power * distance, begins) / total, distance[begins])
        beam = beam[begins]
        brightest = _brightest(power, begins)
        threshold, sigma = self._receiver()
        amplitude = total
        measured = mean
        if noise:
            amplitude = total + sigma * rng.standard_normal(len(total))
            measured = mean + self.range_noise * rng.standard_normal(len(total))
        if self.range_resolution:
            measured = np.round(measured / self.range_resolution) * self.range_resolution
        # Of a beam the strongest returns count, and those then stand by distance.
        seen = np.flatnonzero((amplitude > threshold) & (total > 0))
        seen = seen[np.lexsort((-amplitude[seen], beam[seen]))]
        seen = seen[_rank(beam[seen]) < self.returns]
        seen = seen[np.lexsort((mean[seen], beam[seen]))]
        channel, column = np.divmod(beam[seen], steps)
        place = channel, column, _rank(beam[seen])
        shape = channels, steps, self.returns
        distances = np.full(shape, np.nan)
        distances[place] = measured[seen]
        # The power times the squared distance is the reflectivity of a Lambertian surface.
        intensity = np.zeros(shape)
        intensity[place] = amplitude[seen] * mean[seen] ** 2
        instances = np.full(shape, -1, np.int32)
        instances[place] = instance[brightest[seen]]
        positions = np.full((*shape, 3), np.nan)
        positions[place] = poses[column, :3, 3] + measured[seen, None] * along[channel, column]
        return LidarScan(distances, intensity, instances, positions, self.column_times, poses, self.directions)

    def _receiver(self) -> tuple[float, float]:
        """The threshold of the received power, relative to a white surface at 1 m, and the deviation of its noise."""
        distance, reflectivity = self.reference
        if not distance:
            return 0.0, 0.0
        # The reference's power lies so far above the threshold that nine of ten numbers of the noise leave it there:
        # power = threshold + 1.28 sigma, and sigma = threshold / 6.
        threshold = reflectivity / distance**2 / (1 + NINETY_PERCENT / THRESHOLD_TO_NOISE)
        return threshold, threshold / THRESHOLD_TO_NOISE

    def _poses(self, pose: Any) -> Floats:
        """One for each column, (azimuth_steps, 4, 4)."""
        steps = self.azimuth_steps
        poses = [pose(time) for time in self.column_times.tolist()] if callable(pose) else pose
        try:
            if np.shape(poses) in ((3,), (3, 4), (4, 4)):
                return np.broadcast_to(checks.affine_transform(poses), (steps, 4, 4))
            if len(poses) != steps:
                raise ValueError(f"are one transform, or one for each of {steps} columns, not {len(poses)}")
            return np.stack([checks.affine_transform(one) for one in poses])
        except (TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"Lidar.scan: poses {error}") from None


def _beam_profile(count: int) -> Floats:
    """Places (N, 2) of rays of equal power in a Gaussian beam of the standard deviation 1, on a spiral: Vogel, "A
    Better Way to Construct the Sunflower Head" (1979)."""
    if count == 1:
        return np.zeros((1, 2))
    # Each ray stands for a ring of equal power: the radius inverts the Gaussian's share of power inside it. Turning by
    # the golden angle from ray to ray spreads them evenly for any count.
    number = np.arange(count)
    radius = np.sqrt(-2 * np.log1p(-(number + 0.5) / count))
    around = np.stack([np.cos(number * GOLDEN_ANGLE), np.sin(number * GOLDEN_ANGLE)], -1)
    return np.asarray(radius[:, None] * around, np.float64)


# ---- groups of neighboring elements, by the index at which each begins ------------------------------


def _sums(values: Floats, begins: NDArray[np.int64]) -> Floats:
    return np.add.reduceat(values, begins) if len(begins) else np.zeros(0)


def _brightest(power: Floats, begins: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of the strongest echo of each group."""
    group = np.repeat(np.arange(len(begins)), np.diff(begins, append=len(power)))
    order = np.lexsort((-power, group))
    return order[begins] if len(begins) else np.zeros(0, np.int64)


def _rank(beam: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of each element among those of its beam; beams stand together."""
    begins = np.flatnonzero(np.diff(beam, prepend=-1) != 0)
    return np.arange(len(beam)) - np.repeat(begins, np.diff(begins, append=len(beam)))
