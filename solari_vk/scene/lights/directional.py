"""Lights at infinity that shine in one direction: suns."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, field
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.light import Light, kelvin
from solari_vk.scene.observable import checked

SUN_ANGULAR_DIAMETER = 0.00930842  # radians, mean over the year


@checked
class DirectionalLight(Light):
    """A sun.

    direction (3,): in which its light travels, of any length. illuminance: on a surface that faces the sun, in lux.
    color (3,): linear. In its place kelvin: the temperature of a black body, see `kelvin`. angular_diameter: of the
    sun's disk, in radians.
    """

    direction: FloatArray
    _: KW_ONLY
    illuminance: float = 10_000.0
    color: FloatArray = field(default_factory=lambda: np.ones(3, np.float32))
    angular_diameter: float = SUN_ANGULAR_DIAMETER
    name: str = ""

    _converters = {
        "name": checks.text,
        "direction": checks.direction,
        "illuminance": checks.number(0, 1e15),
        "color": checks.color(0, 1e6),
        "angular_diameter": checks.number(1e-5, math.pi, "radians"),
    }

    _derived = ("kelvin",)

    @classmethod
    def _resolve(cls, fields: dict[str, Any], current: Any) -> dict[str, Any]:
        if "color" in fields:
            raise SolariError(f"{cls.__name__}: kelvin makes color: give one of them")
        return {"color": kelvin(fields.pop("kelvin")), **fields}

    @property
    def axes(self) -> tuple[str, ...]:
        """The fields that are directions, which turn with what carries the light."""
        return ("direction",)

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        return self.illuminance > 0 and bool((self.color > 0).any())
