"""Depth cameras that measure the phase of modulated light."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor, quoted
from solari_vk.data.annotate.surfaces import check_view, pixel_grid
from solari_vk.data.sensors.echoes import Echoes, checked_numbers, find_echoes
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.checks import check_whole
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
SPEED_OF_LIGHT = 299792458.0  # m/s
MOST_TURNS = 10_000  # of the phase of the highest frequency, which are tried


class DepthImage(NamedTuple):
    """What a depth camera measured, (height, width) each. numpy takes it for its depth."""

    depth: Floats
    """In meters along the view axis, of wide lenses along the ray, as `frame["depth"]`; NaN where nothing was
    measured."""
    distance: Floats
    """In meters from the camera."""
    amplitude: Floats | None = None
    """Of the modulated light, in electrons, the mean of all frequencies; also where nothing was measured. None of a
    camera that measures none."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self.depth, dtype)


@checked_constructor
@dataclass(frozen=True, kw_only=True)
class TimeOfFlightCamera:
    """A camera that lights the scene with modulated light and measures its phase in four samples for each frequency.

    Source of the model: Lange and Seitz, "Solid-State Time-of-Flight Range Camera" (2001). Samples have the mean
    B + A cos(phase - k pi / 2) electrons and Poisson noise, so that the deviation of a distance is about
    c / (4 sqrt(2) pi f) * sqrt(B) / A.

    frequencies: of the modulation, in Hz. Distances are known up to multiples of c / 2f, the unambiguous range, where f
    is the greatest common divisor of all, in whole Hz, and farther surfaces seem nearer. Of several frequencies the
    distance up to max_range is taken that fits all best.
    signal: electrons in a sample from a white Lambertian surface that faces the camera 1 m away; it falls with the
    squared distance, and the BRDF and the angle count. background: electrons from other light and the dark signal.
    contrast: A over the signal. min_amplitude: electrons, below which nothing is measured, such as six times
    sqrt(background / 2), its noise; full_well: electrons, above which a sample is saturated, and nothing is measured.
    min_range, max_range: in meters; max_range 0 is the unambiguous range. rays_per_pixel: along each axis; at edges,
    and through glass, light of several surfaces adds up to one phase between them ("flying pixels"). max_surfaces: that
    a ray meets, through glass. Raises SolariError for numbers out of range.
    """

    frequencies: tuple[float, ...] = (20e6,)
    signal: float = 50_000.0
    background: float = 2_000.0
    contrast: float = 0.8
    min_amplitude: float = 200.0
    full_well: float = 1e6
    min_range: float = 0.1
    max_range: float = 0.0
    rays_per_pixel: int = 1
    max_surfaces: int = 4

    def __post_init__(self) -> None:
        try:
            frequencies = tuple(float(f) for f in self.frequencies)
            if not frequencies or not all(1e3 <= f <= 1e11 and f == round(f) for f in frequencies):
                raise ValueError
        except (TypeError, ValueError):
            raise SolariError(
                "TimeOfFlightCamera: frequencies are whole numbers between 1e3 and 1e11 Hz, at least "
                f"one, not {quoted(self.frequencies)}"
            ) from None
        object.__setattr__(self, "frequencies", frequencies)
        checked_numbers(
            self,
            {
                "signal": (0, 1e15, "electrons"),
                "background": (0, 1e15, "electrons"),
                "contrast": (1e-3, 1, ""),
                "min_amplitude": (0, 1e15, "electrons"),
                "full_well": (1, 1e15, "electrons"),
                "min_range": (0, 1e6, "m"),
                "max_range": (0, 1e6, "m"),
            },
        )
        for name in ("rays_per_pixel", "max_surfaces"):
            check_whole(f"TimeOfFlightCamera: {name}", getattr(self, name), 1, 64)
        if len(set(frequencies)) < len(frequencies):
            raise SolariError(f"TimeOfFlightCamera: frequencies must differ, or they measure the same: {frequencies}")
        if self.max_range > self.unambiguous_range:
            raise SolariError(
                f"TimeOfFlightCamera: max_range, {self.max_range:g} m, is beyond the unambiguous range "
                f"of these frequencies, {self.unambiguous_range:g} m: add a frequency, so that their "
                "greatest common divisor is smaller"
            )
        # Every turn up to the farthest distance is tried for every pixel.
        turns = self.farthest * 2 * max(frequencies) / SPEED_OF_LIGHT
        if turns > MOST_TURNS:
            raise SolariError(
                f"TimeOfFlightCamera: up to {self.farthest:g} m {max(frequencies):g} Hz have more than "
                f"{MOST_TURNS:,} turns: give a smaller max_range"
            )

    @property
    def unambiguous_range(self) -> float:
        """c / 2f of the frequencies' greatest common divisor, in meters."""
        return SPEED_OF_LIGHT / (2 * math.gcd(*map(round, self.frequencies)))

    @property
    def farthest(self) -> float:
        """The largest distance that is measured, in meters."""
        return self.max_range or self.unambiguous_range

    def capture(
        self, tracer: RayTracer, camera: Camera, size: tuple[int, int], *, seed: int = 0, noise: bool = True
    ) -> DepthImage:
        """A picture of depths, of a camera of any projection but orthographic, and of the size (width, height).

        noise: Poisson's, by numpy's `default_rng(seed)`. The light comes from the camera's own position. Raises
        SolariError for an orthographic camera and a wrong seed.
        """
        check_view("TimeOfFlightCamera.capture", tracer, camera, size)
        check_whole("TimeOfFlightCamera.capture: seed", seed)
        if camera.orthographic_height:
            raise SolariError(
                f"TimeOfFlightCamera.capture: {camera.describe()}: an orthographic camera sends no light "
                "out of one point"
            )
        count = self.rays_per_pixel
        centers = pixel_grid(size)
        # Rays through a grid of places in each pixel.
        steps = (np.arange(count) + 0.5) / count - 0.5
        within = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
        pixels = (centers[:, None] + within).reshape(-1, 2)
        origins, directions = camera.rays(pixels, size)
        found = find_echoes(tracer, origins, directions, 0.0, np.inf, self.max_surfaces)
        rng = np.random.default_rng(seed) if noise else None
        phases, amplitude, saturated = self._sample(found, size[0] * size[1], rng)
        distance = self._distance(phases)
        # Saturated samples have lost their phase, and weak ones are mostly noise.
        valid = (amplitude >= self.min_amplitude) & ~saturated & (amplitude > 0)
        valid &= (distance >= self.min_range) & (distance <= self.farthest)
        distance = np.where(valid, distance, np.nan)
        _, rays = camera.rays(centers, size)
        along = rays @ -camera.transform[:3, 2] / np.linalg.norm(camera.transform[:3, 2])
        depth = distance * along if camera.projection == "perspective" else distance
        shape = size[1], size[0]
        return DepthImage(depth.reshape(shape), distance.reshape(shape), amplitude.reshape(shape))

    def _sample(
        self, found: Echoes, pixel_count: int, rng: np.random.Generator | None
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Four samples of each frequency: the phases (frequencies, N) in radians, the mean amplitude (N), and whether a
        sample of the pixel is saturated (N). rng: draws Poisson's noise; without it there is none."""
        count = self.rays_per_pixel
        pixel = found.ray // count**2
        electrons = self.signal * found.strength / np.maximum(found.distance, 1e-6) ** 2 / count**2
        offset = self.background + np.bincount(pixel, electrons, pixel_count)
        phases = []
        amplitudes = []
        saturated = np.zeros(pixel_count, np.bool_)
        for frequency in self.frequencies:
            # Light goes there and back, so the phase turns once in half a wavelength of the modulation.
            turn = 4 * math.pi * frequency / SPEED_OF_LIGHT * found.distance
            # Echoes of a pixel add up as phasors: at edges the phase lies between those of both surfaces.
            cosine = self.contrast * np.bincount(pixel, electrons * np.cos(turn), pixel_count)
            sine = self.contrast * np.bincount(pixel, electrons * np.sin(turn), pixel_count)
            samples = offset + np.stack([cosine, sine, -cosine, -sine])
            if rng is not None:
                samples = rng.poisson(np.maximum(samples, 0.0)).astype(np.float64)
            saturated |= (samples > self.full_well).any(axis=0)
            # Lange and Seitz: the differences of opposite samples are free of the background.
            real, imaginary = samples[0] - samples[2], samples[1] - samples[3]
            phases.append(np.arctan2(imaginary, real) % (2 * math.pi))
            amplitudes.append(np.hypot(real, imaginary) / 2)
        return np.array(phases), np.mean(amplitudes, axis=0), saturated

    def _distance(self, phases: Floats) -> Floats:
        """The distance (N,) that fits the phases (frequencies, N) best, up to the range."""
        meters = SPEED_OF_LIGHT / (2 * np.array(self.frequencies))  # of a turn
        finest = int(meters.argmin())
        base: Floats = phases[finest] / (2 * math.pi) * meters[finest]
        if len(meters) == 1:
            return base
        # Every number of whole turns of the highest frequency is tried; the others' phases decide which one fits.
        best = base.copy()
        least = np.full(base.shape, np.inf)
        for turns in range(math.ceil(self.farthest / meters[finest])):
            candidate = base + turns * meters[finest]
            turned = phases / (2 * math.pi) - candidate / meters[:, None]
            error = (((turned - np.round(turned)) * meters[:, None]) ** 2).sum(axis=0)
            best[error < least] = candidate[error < least]
            least = np.minimum(error, least)
        return best
