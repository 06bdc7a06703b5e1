"""Lights at a point, or spheres: point lights and spotlights, as glTF's extension KHR_lights_punctual has them."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, field

import numpy as np

from solari_vk.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.light import Light
from solari_vk.scene.observed import checked

MIN_RADIUS = 1e-5  # meters: the radiance of smaller spheres overflows
MIN_COSINE_STEP = 1e-3  # between the cones of a spotlight, from the code that KHR_lights_punctual recommends


@checked
class PunctualLight(Light):
    """What point lights and spotlights share."""

    position: FloatArray
    _: KW_ONLY
    intensity: float = 100.0
    color: FloatArray = field(default_factory=lambda: np.ones(3, np.float32))
    radius: float = 0.0
    range: float | None = None
    name: str = ""

    _converters = {
        "name": checks.text,
        "position": checks.array(3, max_abs=checks.LARGEST_COORDINATE),
        "intensity": checks.number(0, 1e15, "cd"),
        "color": checks.color(0, 1e6),
        "radius": checks.number(0, 1e6, "m"),
        "range": checks.number(1e-5, 1e18, "m", optional=True),
    }

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        return self.intensity > 0 and bool((self.color > 0).any())

    @property
    def axis(self) -> FloatArray:
        """The direction (3,) in which the light is as bright as `intensity` says."""
        return np.array((0, -1, 0), np.float32)

    @property
    def falloff(self) -> tuple[float, float]:
        """A scale and an offset. In a direction whose cosine to the axis is c, the share of the intensity is
        clamp(scale c + offset, 0, 1)^2."""
        return 0.0, 1.0

    @property
    def solid_angle(self) -> float:
        """The integral of the share of the intensity over all directions, in steradians."""
        return 4 * math.pi

    def _validate(self) -> None:
        if 0 < self.radius < MIN_RADIUS:
            raise SolariError(f"{self.describe()}: radius must be 0 or at least {MIN_RADIUS:g} m, not {self.radius:g}")


@checked
class PointLight(PunctualLight):
    """A lamp that sends the same light in all directions.

    position (3,): in meters. intensity: in cd; the illuminance of a surface that faces the light at distance d is
    intensity / d^2. color (3,): linear. radius: in meters; 0 is a point, which no ray meets. A larger radius makes a
    sphere of the same intensity, with soft shadows; cameras and mirrors see it, and it casts no shadow itself. range:
    in meters; light is dimmed towards this distance and ends there, by the window that glTF recommends; None: without
    end, as real light.
    """


@checked
class SpotLight(PunctualLight):
    """A lamp that sends light into a cone.

    direction (3,): of the cone's axis, away from the lamp, of any length. inner_cone_angle, outer_cone_angle: from the
    axis, in radians. Inside the inner cone the intensity is whole; from there it falls smoothly to 0 at the outer one,
    as glTF recommends: by the square of a share that is linear in the angle's cosine. The outer angle is at most pi / 2
    and larger than the inner one. Of a lamp with a radius, the angle is that from its center to what it lights. All
    other fields are those of PointLight.
    """

    direction: FloatArray
    _: KW_ONLY
    inner_cone_angle: float = 0.0
    outer_cone_angle: float = math.pi / 4

    _converters = {
        **PunctualLight._converters,
        "direction": checks.direction,
        "inner_cone_angle": checks.number(0, math.pi / 2, "radians"),
        "outer_cone_angle": checks.number(0, math.pi / 2 + 1e-6, "radians"),
    }

    @property
    def axis(self) -> FloatArray:
        """The direction (3,) in which the light is as bright as `intensity` says."""
        return self.direction

    @property
    def _cosines(self) -> tuple[float, float]:
        outer = math.cos(self.outer_cone_angle)
        return max(math.cos(self.inner_cone_angle), outer + MIN_COSINE_STEP), outer

    @property
    def falloff(self) -> tuple[float, float]:
        """A scale and an offset. In a direction whose cosine to the axis is c, the share of the intensity is
        clamp(scale c + offset, 0, 1)^2."""
        inner, outer = self._cosines
        return 1 / (inner - outer), -outer / (inner - outer)

    @property
    def solid_angle(self) -> float:
        """The integral of the share of the intensity over all directions, in steradians."""
        inner, outer = self._cosines
        return 2 * math.pi * (max(1 - inner, 0.0) + (inner - outer) / 3)

    def _validate(self) -> None:
        super()._validate()
        if not self.inner_cone_angle < self.outer_cone_angle:
            raise SolariError(
                f"{self.describe()}: inner_cone_angle must be smaller than outer_cone_angle, but is "
                f"{self.inner_cone_angle:g} where the other is {self.outer_cone_angle:g}"
            )
