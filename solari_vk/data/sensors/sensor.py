"""Image sensors: how radiance becomes digital numbers.

The noise is the linear model of EMVA Standard 1288 (release 4.0): photons become electrons with the quantum efficiency,
their number has Poisson's noise, the electronics add Gaussian noise, and the gain makes digital numbers (DN) of them.
Nonuniformity is of the response to light, before Poisson's noise, and of the dark signal, added to the electrons.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_constructor, quoted, unknown_name
from solari_vk.base.files import read_json
from solari_vk.data.sensors import optics
from solari_vk.data.sensors.echoes import checked_numbers
from solari_vk.scene import checks
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
PHOTONS = 4.0907e15  # of a lumen second at 555 nm: 1 / (683.002 lm/W * h c / 555 nm)
SATURATION = 78.0  # ISO 12232: a sensor of the speed S is white at an exposure of 78 / S lx s
ISO_Q = 0.65  # ISO 12232: lx s on the sensor for each cd/m^2, at f/1 in one second
GREEN = 1


@checked_constructor
@dataclass(frozen=True, kw_only=True)
class Sensor:
    """An image sensor behind a lens: it turns radiance in cd/m² into raw digital numbers.

    A pixel of radiance L has the exposure H = q L t / N² in lx s, with the f-number N and exposure_time t in seconds; q
    is 0.65, as of ISO 12232. Without an exposure_time it is that at which the camera's ev100 makes the same radiance
    white as in pictures. Each color counts as light of 555 nm: pixel_pitch² * H * 4.09e15 photons/(lm s) *
    quantum_efficiency electrons. pixel_pitch is in meters; quantum_efficiency is one number, or three for red, green
    and blue.

    full_well: electrons that a pixel holds. gain: DN for each electron; or iso, with which white (78 / iso lx s) is
    the largest number. Its default and smallest value is the sensor's own speed, `base_iso`, at which the well is full
    then; below it the well would be full before white. bit_depth: of the digital numbers. black_level: DN without
    light. shot_noise: whether numbers of electrons have Poisson's noise. read_noise: its standard deviation in
    electrons. dark_current: electrons a second. prnu, dsnu: fixed patterns of the sensor numbered pattern_seed, as
    standard deviations: of the relative response to light, and of the dark signal in electrons, which is added as read
    noise is.

    vignetting: "none"; "cos4", the natural one of a perspective camera; or the coefficients a1, a2, ... of 1 + a1 r² +
    a2 r⁴ + ..., where r is 1 at half the picture's diagonal from the principal point (Goldman, "Vignette and Exposure
    Calibration and Compensation", 2010). chromatic_aberration: by how much red and blue are magnified more than green,
    such as (0.001, -0.001). bayer: "RGGB", "BGGR", "GRBG", "GBRG", the colors of the first two rows; "" for three
    colors at each pixel. Raises SolariError for numbers out of range.
    """

    iso: float | None = None
    gain: float | None = None
    f_number: float = 4.0
    exposure_time: float | None = None
    pixel_pitch: float = 3.45e-6
    quantum_efficiency: float | tuple[float, float, float] = 0.6
    full_well: float = 10_000.0
    bit_depth: int = 12
    black_level: float = 64.0
    shot_noise: bool = True
    read_noise: float = 2.5
    dark_current: float = 0.0
    prnu: float = 0.0
    dsnu: float = 0.0
    pattern_seed: int = 0
    vignetting: str | tuple[float, ...] = "none"
    chromatic_aberration: tuple[float, float] = (0.0, 0.0)
    bayer: str = ""

    def __post_init__(self) -> None:
        self._check_ranges()
        self._check_vectors()
        self._check_choices()
        self._check_levels()

    def _check_ranges(self) -> None:
        ranges: dict[str, tuple[float, float, str]] = {
            "iso": (1e-3, 1e9, ""),
            "gain": (1e-9, 1e9, "DN for each electron"),
            "f_number": (0.1, 1e3, ""),
            "exposure_time": (1e-9, 1e6, "s"),
            "pixel_pitch": (1e-8, 1e-2, "m"),
            "full_well": (1, 1e12, "electrons"),
            "black_level": (0, 65535, "DN"),
            "read_noise": (0, 1e9, "electrons"),
            "dark_current": (0, 1e12, "electrons a second"),
            "prnu": (0, 1, ""),
            "dsnu": (0, 1e9, "electrons"),
        }
        checked_numbers(self, {name: limits for name, limits in ranges.items() if getattr(self, name) is not None})
        checks.check_whole("Sensor: bit_depth", self.bit_depth, 1, 16)
        checks.check_whole("Sensor: pattern_seed", self.pattern_seed)

    def _check_vectors(self) -> None:
        """Make tuples of one number for each color, and check them."""
        for name, length in (("quantum_efficiency", 3), ("chromatic_aberration", 2)):
            try:
                values = np.broadcast_to(checks.real(getattr(self, name), np.float64), (length,))
                checks.refuse_not_finite(values)
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"Sensor: {name}: {error}") from None
            object.__setattr__(self, name, tuple(values.tolist()))  # the dataclass is frozen
        if not all(0 < efficiency <= 1 for efficiency in self._efficiency):
            raise SolariError(f"Sensor: quantum_efficiency lies between 0 and 1, not {self.quantum_efficiency}")
        if max(map(abs, self.chromatic_aberration)) > 0.1:
            raise SolariError(f"Sensor: chromatic_aberration lies within 0.1, not {self.chromatic_aberration}")

    def _check_choices(self) -> None:
        if self.bayer not in ("", *optics.BAYER_PATTERNS):
            raise unknown_name("Sensor: there is no Bayer pattern", self.bayer, optics.BAYER_PATTERNS)
        if isinstance(self.vignetting, str) and self.vignetting not in ("none", "cos4"):
            raise SolariError(f'Sensor: vignetting is "none", "cos4" or coefficients, not {quoted(self.vignetting)}')
        if self.iso is not None and self.gain is not None:
            raise SolariError("Sensor: iso and gain say the same: give one of them")

    def _check_levels(self) -> None:
        """Check the numbers that depend on each other."""
        # base_iso is printed with few digits, and must be taken back as it was printed.
        if self.iso is not None and self.iso < self.base_iso * (1 - 1e-3):
            well = self.full_well * self.base_iso / self.iso
            raise SolariError(
                f"Sensor: iso, {self.iso:g}, is below base_iso, {self.base_iso:.5g}: the well is full "
                f"before white: give base_iso or more, a full_well of {well:.5g}, or gain"
            )
        if not self.black_level < self.white_level:
            raise SolariError(
                f"Sensor: black_level, {self.black_level:g} DN, must be below the largest number of "
                f"{self.bit_depth:g} bits"
            )

    @classmethod
    def load(cls, source: str | os.PathLike[str]) -> Sensor:
        """The sensor of a JSON file, or of a JSON object as text, whose keys are the fields. Raises SolariError for an
        unknown key and for numbers out of range, which names the file."""
        text = str(source)
        if text.lstrip().startswith("{"):
            who = "Sensor"
            try:
                values = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise SolariError(f"Sensor: {quoted(text)} isn't JSON: {error}") from None
        else:
            who = f"Sensor {Path(text)}"
            values = read_json(Path(text), who)
        if not isinstance(values, dict):
            raise SolariError(f'{who}: is a JSON object, such as {{"iso": 400, "bayer": "RGGB"}}, not {quoted(values)}')
        known = [field.name for field in fields(cls)]
        for name in values:
            if name not in known:
                raise unknown_name(f"{who}: a sensor has no", name, known)
        # JSON has lists where the fields are tuples.
        arguments: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
        try:
            return cls(**arguments)
        except SolariError as error:
            raise SolariError(str(error).replace("Sensor", who, 1)) from None

    # ---- numbers ------------------------------------------------------------------------------------

    @property
    def _efficiency(self) -> tuple[float, float, float]:
        return self.quantum_efficiency  # type: ignore[return-value]

    @property
    def white_level(self) -> int:
        """The largest digital number."""
        return int(2**self.bit_depth - 1)

    @property
    def electrons_per_exposure(self) -> Floats:
        """Electrons for each lx s, (3,) for red, green and blue."""
        return self.pixel_pitch**2 * PHOTONS * np.array(self._efficiency)

    @property
    def electrons_per_radiance(self) -> Floats:
        """Electrons for each cd/m², (3,) for red, green and blue."""
        return self.electrons_per_exposure * (ISO_Q * self.seconds / self.f_number**2)

    @property
    def base_iso(self) -> float:
        """The speed at which the full well is the largest number."""
        return float(SATURATION * self.electrons_per_exposure[GREEN] / self.full_well)

    @property
    def dn_per_electron(self) -> float:
        """The gain, whether given or by iso."""
        if self.gain is not None:
            return self.gain
        white = SATURATION / (self.iso or self.base_iso) * self.electrons_per_exposure[GREEN]
        return float((self.white_level - self.black_level) / white)

    @property
    def seconds(self) -> float:
        """The exposure time, without one that for an EV100 of 0."""
        found = self.for_ev100(0.0).exposure_time if self.exposure_time is None else self.exposure_time
        assert found is not None
        return found

    def _for(self, camera: Camera | None) -> Sensor:
        """The sensor with an exposure time."""
        if self.exposure_time is not None:
            return self
        return self.for_ev100(0.0 if camera is None else camera.ev100)

    def for_ev100(self, ev100: float) -> Sensor:
        """The same sensor with the exposure time at which a camera's ev100 makes the same radiance white."""
        # With a gain, the speed follows from the exposure at which digital numbers end: ISO 12232's saturation speed.
        iso = self.iso or SATURATION / (self._white_electrons / self.electrons_per_exposure[GREEN])
        return dataclasses.replace(self, exposure_time=float(self.f_number**2 * 100 / iso / 2**ev100))

    @property
    def _white_electrons(self) -> float:
        return (self.white_level - self.black_level) / self.dn_per_electron

    # ---- pictures -----------------------------------------------------------------------------------

    def expose(self, radiance: ArrayLike, camera: Camera | None = None, *, seed: int = 0) -> NDArray[np.uint16]:
        """Raw digital numbers, (height, width) with a Bayer pattern, else (height, width, 3).

        radiance: (height, width, 3) in cd/m², such as a frame, whose camera is taken. camera: which took it, for its
        ev100, the principal point and vignetting. The same seed gives the same numbers: `rng =
        numpy.random.default_rng(seed)` draws `rng.poisson` of all pixels and then `rng.standard_normal`. Raises
        SolariError for wrong shapes and seeds, radiance that isn't finite, and vignetting that needs a camera.
        """
        checks.check_whole("Sensor.expose: seed", seed)
        light, dark = self._light_and_dark(radiance, camera)
        rng = np.random.default_rng(seed)
        response, offset = self._fixed_pattern(light.shape)
        # The linear model of EMVA 1288: light and dark current make electrons, whose number has Poisson's noise ...
        electrons = light * np.maximum(1 + self.prnu * response, 0.0) + dark
        if self.shot_noise:
            most = 4 * self.full_well  # numpy's Poisson numbers have a limit; these pixels are full in any case
            electrons = rng.poisson(np.minimum(electrons, most)).astype(np.float64)
        # ... a full well holds no more; reading it adds the noise of the electronics ...
        electrons = np.minimum(electrons, self.full_well)
        electrons = electrons + self.read_noise * rng.standard_normal(electrons.shape) + self.dsnu * offset
        # ... and the converter rounds to whole numbers.
        numbers = np.floor(self.black_level + self.dn_per_electron * electrons + 0.5)
        return np.clip(numbers, 0, self.white_level).astype(np.uint16)

    def _fixed_pattern(self, shape: tuple[int, ...]) -> tuple[Floats | float, Floats | float]:
        """Standard normal numbers for the response of each pixel and for its dark signal, always the same."""
        if not self.prnu and not self.dsnu:
            return 0.0, 0.0
        rng = np.random.default_rng(self.pattern_seed)
        return rng.standard_normal(shape), rng.standard_normal(shape)

    def mean_electrons(self, radiance: ArrayLike, camera: Camera | None = None) -> Floats:
        """The expected electrons in each pixel, with those of the dark current, without the fixed patterns: the shape
        of `expose`, whose arguments these are."""
        light, dark = self._light_and_dark(radiance, camera)
        return light + dark

    def _light_and_dark(self, radiance: ArrayLike, camera: Camera | None) -> tuple[Floats, float]:
        """The expected electrons of light in each pixel, and those of the dark current."""
        camera = getattr(radiance, "camera", None) if camera is None else camera
        timed = self._for(camera)
        light = np.asarray(radiance, np.float64)
        if light.ndim != 3 or light.shape[2] != 3 or 0 in light.shape:
            raise SolariError(f"Sensor.expose: radiance has the shape (height, width, 3), not {light.shape}")
        if not np.isfinite(light).all():
            raise SolariError("Sensor.expose: radiance must be finite")
        light = np.maximum(light, 0.0)  # denoisers may leave small negative numbers
        center = optics.principal_point(camera, light.shape[1], light.shape[0])
        if any(self.chromatic_aberration):
            light = optics.magnify_colors(light, center, self.chromatic_aberration)
        light = light * optics.relative_illumination(self.vignetting, camera, center, light.shape[:2])[..., None]
        electrons = light * timed.electrons_per_radiance
        if self.bayer:
            colors = optics.bayer_colors(self.bayer, light.shape[:2])
            electrons = np.take_along_axis(electrons, colors[..., None], axis=2)[..., 0]
        return electrons, self.dark_current * timed.seconds

    def develop(self, raw: ArrayLike, camera: Camera | None = None) -> Floats:
        """Radiance (height, width, 3) in cd/m² from raw digital numbers: without the black level and the mean dark
        signal, over the gain; a Bayer pattern is interpolated bilinearly. Vignetting stays. camera: as of `expose`."""
        timed = self._for(camera)
        numbers = np.asarray(raw, np.float64)
        if numbers.ndim != (2 if self.bayer else 3):
            shape = "(height, width)" if self.bayer else "(height, width, 3)"
            raise SolariError(f"Sensor.develop: raw numbers have the shape {shape}, not {numbers.shape}")
        electrons = (numbers - self.black_level) / self.dn_per_electron - self.dark_current * timed.seconds
        if self.bayer:
            colors = optics.bayer_colors(self.bayer, (numbers.shape[0], numbers.shape[1]))
            electrons = optics.demosaic(electrons, colors)
        found: Floats = electrons / timed.electrons_per_radiance
        return found

    @property
    def saturation_radiance(self) -> float:
        """The radiance in cd/m² of green at which digital numbers or the well end."""
        most = min(self._white_electrons, self.full_well) - self.dark_current * self.seconds
        return float(most / self.electrons_per_radiance[GREEN])

    def describe(self) -> str:
        """The numbers of EMVA 1288 in a line: gain; saturation, in electrons of light; absolute threshold, at which the
        signal is about the noise, sqrt(read_noise² + dark electrons + 1 / (12 gain²)) + 1/2 electrons; dynamic range,
        of both; and the largest signal-to-noise ratio. Without an exposure_time, dark electrons are those at EV100 0.
        """
        dark = self.dark_current * self.seconds
        most = max(min(self._white_electrons, self.full_well) - dark, 0.0)
        # Rounding to whole numbers has the variance of a uniform distribution one number wide, 1/12.
        variance = self.read_noise**2 + (dark if self.shot_noise else 0.0) + 1 / 12 / self.dn_per_electron**2
        threshold = math.sqrt(variance) + 0.5
        dynamic_range = signal_to_noise = -math.inf
        if most:
            dynamic_range = 20 * math.log10(most / threshold)
            signal_to_noise = 10 * math.log10(most)  # 20 log10(most / sqrt(most)): shot noise alone
        return (
            f"{self.dn_per_electron:.4g} DN/e-, saturation {most:.0f} e-, absolute threshold {threshold:.4g} e-, "
            f"dynamic range {dynamic_range:.1f} dB, SNR {signal_to_noise:.1f} dB"
        )
