"""Lights at a point, or spheres: point lights and spotlights, as glTF's extension KHR_lights_punctual has them."""

from __future__ import annotations

import math
import os
from dataclasses import KW_ONLY, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.light import Light, kelvin
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.observable import checked

MIN_RADIUS = 1e-5  # meters: the radiance of smaller spheres overflows
_reach = checks.number(1e-5, math.inf, "m", optional=True)
MIN_COSINE_STEP = 1e-3  # between the cones of a spotlight, from the code that KHR_lights_punctual recommends


@checked
class PunctualLight(Light):
    """What point lights and spotlights share."""

    position: NDArray[np.float64]
    _: KW_ONLY
    intensity: float = 100.0
    color: FloatArray = field(default_factory=lambda: np.ones(3, np.float32))
    radius: float = 0.0
    range: float | None = None
    blocks_light: bool = False
    name: str = ""

    _converters = {
        "name": checks.text,
        "blocks_light": checks.flag,
        "position": checks.array(3, dtype=np.float64, max_abs=checks.LARGEST_COORDINATE),
        "intensity": checks.number(0, 1e15, "cd"),
        "color": checks.color(0, 1e6),
        "radius": checks.number(0, 1e6, "m"),
        "range": lambda value: None if value == math.inf else _reach(value),
    }

    _derived: ClassVar[tuple[str, ...]] = ("lumens", "kelvin")

    @classmethod
    def _resolve(cls, fields: dict[str, Any], current: Any) -> dict[str, Any]:
        for name, made in (("lumens", "intensity"), ("kelvin", "color")):
            if name in fields and made in fields:
                raise SolariError(f"{cls.__name__}: {name} makes {made}: give one of them")
        if "kelvin" in fields:
            fields["color"] = kelvin(fields.pop("kelvin"))
        if "lumens" in fields:
            try:
                flux = checks.number(0, 1e15, "lm")(fields.pop("lumens"))
            except (TypeError, ValueError) as error:
                raise SolariError(f"{cls.__name__}: lumens {error}") from None
            # Of the cone or profile that is set together with the lumens, else of the present one.
            fields["intensity"] = flux / cls._solid_angle_of(fields, current)
        return fields

    @classmethod
    def _solid_angle_of(cls, fields: dict[str, Any], current: Any) -> float:
        """`solid_angle` after fields are assigned."""
        raise NotImplementedError

    @property
    def lumens(self) -> float:
        """The luminous flux of a light whose color has a luminance of 1: intensity times `solid_angle`. May be
        assigned; the intensity then follows from the cone or the profile as it is."""
        return self.intensity * self.solid_angle

    @lumens.setter
    def lumens(self, lumens: float) -> None:
        self.update(lumens=lumens)

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        return self.intensity > 0 and bool((self.color > 0).any())

    @property
    def falloff(self) -> tuple[float, float]:
        """A scale and an offset. In a direction whose cosine to the axis is c, the share of the intensity is
        clamp(scale c + offset, 0, 1)^2."""
        return 0.0, 1.0

    @property
    def solid_angle(self) -> float:
        """The integral of the share of the intensity over all directions, in steradians."""
        return self._solid_angle_of({}, self)

    def _validate(self) -> None:
        if 0 < self.radius < MIN_RADIUS:
            raise SolariError(f"{self.describe()}: radius must be 0 or at least {MIN_RADIUS:g} m, not {self.radius:g}")
        if self.blocks_light and self.radius == 0:
            raise SolariError(
                f"{self.describe()}: blocks_light needs a radius above 0, since a point stops no light: "
                "set both by update(radius=..., blocks_light=...)"
            )


@checked
class PointLight(PunctualLight):
    """A lamp that sends the same light in all directions, or by a profile.

    position (3,): in meters. intensity: in cd; the illuminance of a surface that faces the light at distance d is
    intensity / d^2. lumens, in its place: intensity times `solid_angle`, 4 pi without a profile. color (3,): linear.
    kelvin, in its place: the temperature of a black body, see `kelvin`. radius: in meters; 0 is a point, which no ray
    meets. A larger radius makes a sphere of the same intensity, with soft shadows; cameras and mirrors see it, and pass
    through. blocks_light: the lamp's own sphere stops the light of other lamps and hides what is behind it, which needs
    a radius; objects that the lamp lights cast shadows either way.
    range: in meters; light is dimmed towards this distance and ends there, by the window that glTF recommends; None, or
    infinity: without end, as real light.

    profile: a LightProfile, which says how bright each direction is in proportion to `intensity`, that of the brightest
    one; None: all are alike. ies, in its place: a file after ANSI/IES LM-63, or a LightProfile; unless intensity or
    lumens is given too, the intensity is then the file's. direction (3,): of the profile's vertical angle 0, of any
    length. horizontal (3,): of its horizontal angle 0, at a right angle to `direction` or made so. Of a lamp with a
    radius, directions are those from its center.
    """

    _: KW_ONLY
    profile: LightProfile | None = None
    direction: FloatArray = field(default_factory=lambda: np.array((0, -1, 0), np.float32))
    horizontal: FloatArray = field(default_factory=lambda: np.array((1, 0, 0), np.float32))

    _converters = {
        **PunctualLight._converters,
        "profile": checks.instance_of(lambda: LightProfile, optional=True),
        "direction": checks.direction,
        "horizontal": checks.direction,
    }

    _derived = (*PunctualLight._derived, "ies")

    @classmethod
    def _resolve(cls, fields: dict[str, Any], current: Any) -> dict[str, Any]:
        if "ies" in fields:
            if "profile" in fields:
                raise SolariError(f"{cls.__name__}: ies makes profile: give one of them")
            file = fields.pop("ies")
            fields["profile"] = profile = file if isinstance(file, LightProfile) else _read(file)
            # A file says both the distribution and the brightness; the latter may be set apart.
            if not {"intensity", "lumens"} & fields.keys():
                fields["intensity"] = profile.peak
        if "lumens" in fields and cls._solid_angle_of(fields, current) == 0:
            name = (fields.get("profile") or current.profile).name
            raise SolariError(
                f"{cls.__name__}: lumens can't be given with the profile '{name}', which is wholly dark: "
                "give another profile"
            )
        return super()._resolve(fields, current)

    @classmethod
    def _solid_angle_of(cls, fields: dict[str, Any], current: Any) -> float:
        # Without a profile the same in all directions.
        profile = fields.get("profile", getattr(current, "profile", None))
        return profile.solid_angle if isinstance(profile, LightProfile) else 4 * math.pi

    @property
    def axes(self) -> tuple[str, ...]:
        """The fields that are directions, which turn with what carries the light."""
        return ("direction", "horizontal") if self.profile else ()

    def _validate(self) -> None:
        super()._validate()
        if self.profile and np.linalg.norm(np.cross(self.direction, self.horizontal)) < 1e-3:
            raise SolariError(
                f"{self.describe()}: horizontal must not have the direction of `direction`: set both by "
                "update(direction=..., horizontal=...)"
            )


@checked
class SpotLight(PunctualLight):
    """A lamp that sends light into a cone.

    direction (3,): of the cone's axis, away from the lamp, of any length. inner_cone_angle, outer_cone_angle: from the
    axis, in radians. Inside the inner cone the intensity is whole; from there it falls smoothly to 0 at the outer one,
    as glTF recommends: by the square of a share that is linear in the angle's cosine. The outer angle is at most pi / 2
    and larger than the inner one. Of a lamp with a radius, the angle is that from its center to what it lights. lumens:
    the flux in the cone, intensity times `solid_angle`; some programs divide by pi or 4 pi instead. All other fields
    are those of PointLight.
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
    def axes(self) -> tuple[str, ...]:
        """The fields that are directions, which turn with what carries the light."""
        return ("direction",)

    @property
    def _cosines(self) -> tuple[float, float]:
        return _cosines(self.inner_cone_angle, self.outer_cone_angle)

    @property
    def falloff(self) -> tuple[float, float]:
        """A scale and an offset. In a direction whose cosine to the axis is c, the share of the intensity is
        clamp(scale c + offset, 0, 1)^2."""
        inner, outer = self._cosines
        # KHR_lights_punctual, "Inner and Outer Cone Angles": the recommended code.
        return 1 / (inner - outer), -outer / (inner - outer)

    @classmethod
    def _solid_angle_of(cls, fields: dict[str, Any], current: Any) -> float:
        angles = []
        for name in ("inner_cone_angle", "outer_cone_angle"):
            value = fields.get(name, getattr(cls if current is None else current, name))
            try:
                angles.append(cls._converters[name](value))
            except (TypeError, ValueError) as error:
                raise SolariError(f"{cls.__name__}: {name} {error}") from None
        return _cone(*_cosines(*angles))

    def _validate(self) -> None:
        super()._validate()
        if not self.inner_cone_angle < self.outer_cone_angle:
            raise SolariError(
                f"{self.describe()}: inner_cone_angle must be smaller than outer_cone_angle, but is "
                f"{self.inner_cone_angle:g} where the other is {self.outer_cone_angle:g}"
            )


def _read(file: Any) -> LightProfile:
    if not isinstance(file, (str, os.PathLike)):
        raise SolariError(f"PointLight: ies must be a path or a LightProfile, not {type(file).__name__}")
    return LightProfile.read(file)


def _cosines(inner_angle: float, outer_angle: float) -> tuple[float, float]:
    outer = math.cos(outer_angle)
    return max(math.cos(inner_angle), outer + MIN_COSINE_STEP), outer


def _cone(inner: float, outer: float) -> float:
    """The integral of a spotlight's share of its intensity over all directions, by the cosines of its cones."""
    # The whole share within the inner cone. Between the cones the share is the square of a line from 1 to 0, whose mean
    # is a third.
    return 2 * math.pi * (max(1 - inner, 0.0) + (inner - outer) / 3)
