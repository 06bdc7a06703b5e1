"""The kinds of lights: what the renderer has to know of each, as rows of one table.

To add a kind, write its class of scene objects (derived from `objects.Light`) and its row, and put its shader code into
glsl/scene/lights/NAME.glsl, where NAME is the row's name. `glsl_header` makes the constants and the functions that
choose between the kinds. Each NAME.glsl defines:

    ResolvedLightSample resolve_NAME(uint index, uint part, vec2 u, float inverse_probability)
        The point of a part of the light, or the direction, for random numbers u in [0, 1), with its radiance. The part
        is a triangle of an emissive mesh or a texel of an environment, 0 for all other kinds. Its inverse_pdf is
        inverse_probability times the inverse density of the point in area, or of the direction in solid angle.
    float emission_cosine_NAME(uint data, float cosine)
        The factor of a sample's radiance times projected area towards a receiver: `data` is the sample's, `cosine` the
        cosine between its normal and the direction to the receiver.
    uint shown_id_NAME(uint index)
        A number that stays the same while other lights are added and removed; debug views give each number a color.
    MetLight meet_NAME(uint index, vec3 direction)
        Kinds at infinity only: what a ray in this direction meets if it meets no surface.

`index` is the light's record in the kind's own buffer, or for emissive meshes the instance. NAME.glsl declares the
buffer, as binding LIGHT_RECORDS + LIGHT_NAME of set 0. tests/images/test_light_kinds.py adds two kinds in this way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.color import LUMINANCE_WEIGHTS
from solari_vk.gpu.shaders import headers
from solari_vk.scene.environment import EnvironmentLight
from solari_vk.scene.features import FEATURES
from solari_vk.scene.model import DirectionalLight, Instance

AT_SURFACES, AT_INFINITY, NEVER = "at surfaces", "at infinity", "never"
SHADOW_DISTANCE = 10.0  # meters from a sun's shadows to what casts them, roughly: how far they move when the sun turns


@dataclass(frozen=True)
class LightKind:
    """A row of `LIGHT_KINDS`.

    name: part of the names of files, functions and constants in GLSL. source: the class of the scene's objects.
    met_by_rays: where rays meet such a light without having chosen it: AT_SURFACES, AT_INFINITY or NEVER.
    buffer: the buffer of its records, whose fields `record` gives; None: the light's index is its instance's row.
    power: luminous flux in lumens, roughly, of a light and an area in square meters: that of an emissive surface, for
    all other kinds that of the scene's cross-section. position: a point (3,) in meters that moves when the light does,
    None for instances, whose geometry says it.
    """

    name: str
    source: type[Any]
    met_by_rays: str
    power: Callable[[Any, float], float]
    buffer: str | None = None
    record: Callable[[Any], dict[str, Any]] = lambda light: {}
    position: Callable[[Any], NDArray[np.float64]] | None = None


def luminance(color: NDArray[np.float32]) -> float:
    """The luminance of a linear Rec. 709 color (3,)."""
    return float(sum(weight * channel for weight, channel in zip(LUMINANCE_WEIGHTS, color.tolist(), strict=True)))


def _directional_record(light: DirectionalLight) -> dict[str, Any]:
    half_angle = light.angular_diameter / 2
    one_minus_cos = 2 * math.sin(half_angle / 2) ** 2
    return {
        "direction_to_light": -light.direction,
        "one_minus_cos_half_angle": one_minus_cos,
        # Divided by the disk's cosine-weighted integral, pi sin^2, not by its solid angle: a surface that faces the
        # light's center then receives the stated illuminance however wide the disk is.
        "radiance": light.color * (light.illuminance / (math.pi * math.sin(half_angle) ** 2)),
        "solid_angle": 2 * math.pi * one_minus_cos,
    }


def _environment_record(light: EnvironmentLight) -> dict[str, Any]:
    return {"intensity": light.intensity, "world_from_map": light.rotation.T}  # GLSL holds columns


LIGHT_KINDS = (
    LightKind(
        "emissive_mesh", Instance, AT_SURFACES,
        power=lambda instance, area: (
            math.pi * area * luminance(instance.material.emissive) * (2 if instance.material.double_sided else 1)
        ),
    ),
    LightKind(
        "directional", DirectionalLight, AT_INFINITY,
        power=lambda light, area: area * light.illuminance * luminance(light.color),
        buffer="directional_lights",
        record=_directional_record,
        position=lambda light: -SHADOW_DISTANCE * light.direction,
    ),
    LightKind(
        "environment", EnvironmentLight, AT_INFINITY,
        power=lambda light, area: area * light.flux,
        buffer="environments",
        record=_environment_record,
        position=lambda light: SHADOW_DISTANCE * light.brightest,
    ),
)  # fmt: skip
KIND_INDEX = {kind.name: index for index, kind in enumerate(LIGHT_KINDS)}
"""Each kind's number in the shaders: LIGHT_NAME, and the field `kind` of light sources and of light samples."""


def glsl_header() -> str:
    """`generated/scene/light_kinds.glsl`: LIGHT_*, the kinds' files, and functions that call those of a given kind."""
    every = [kind.name for kind in LIGHT_KINDS]
    at_infinity = [kind.name for kind in LIGHT_KINDS if kind.met_by_rays == AT_INFINITY]
    masks = {
        "KINDS_AT_INFINITY": sum(1 << i for i, kind in enumerate(LIGHT_KINDS) if kind.met_by_rays == AT_INFINITY),
        "KINDS_MET_BY_RAYS": sum(1 << i for i, kind in enumerate(LIGHT_KINDS) if kind.met_by_rays != NEVER),
    }
    return "\n".join([
        headers.enumeration("LIGHT", every),
        headers.constants(**masks),  # bit i says whether the kind i is one of them
        *(f'#include "scene/lights/{name}.glsl"' for name in every),
        _choose("ResolvedLightSample resolve_light", "uint part, vec2 u, float inverse_probability", every),
        _choose("float emission_cosine", "float cosine", every, argument="data"),
        _choose("uint shown_id", "", every),
        _choose("MetLight meet_light", "vec3 direction", at_infinity),
    ])


def _choose(function: str, parameters: str, kinds: list[str], argument: str = "index") -> str:
    """A function `TYPE NAME(kind, argument, parameters)` that calls the kind's own.

    A kind that is a scene feature too costs nothing in the shaders of scenes without such a light.
    """
    own = function.split()[-1].removesuffix("_light")
    names = [argument, *(parameter.split()[-1] for parameter in parameters.split(", ") if parameter)]
    features = {feature.name.lower(): f"{feature.constant} && " for feature in FEATURES}
    *lines, last = [
        f"if ({features.get(kind, '')}kind == LIGHT_{kind.upper()}) {{ return {own}_{kind}({', '.join(names)}); }}"
        for kind in sorted(kinds, key=lambda kind: kind not in features)
    ]
    unconditional = last[last.index("return") : -2]
    declared = ", ".join(["uint kind", f"uint {argument}", *([parameters] if parameters else [])])
    return "\n".join([f"{function}({declared}) {{", *lines, unconditional, "}"])
