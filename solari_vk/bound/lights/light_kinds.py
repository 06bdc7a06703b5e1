"""The kinds of lights: what the renderer has to know of each, as rows of one table.

To add a kind, write its class of scene objects (derived from `Light`) and its row, and put its shader code into
glsl/scene/lights/NAME.glsl, where NAME is the row's name. `glsl_header` makes the constants and the functions that
choose between the kinds. Each NAME.glsl defines:

    ResolvedLightSample resolve_NAME(uint index, uint part, vec2 u, float inverse_probability)
        The point of a part of the light, or the direction, for random numbers u in [0, 1), with its radiance. The part
        is a triangle of an emissive mesh or a texel of an environment, 0 for all other kinds. Its inverse_area_pdf is
        inverse_probability times the inverse density of the point in area, or of the direction in solid angle.
    float emission_cosine_NAME(uint data, float cosine)
        The factor of a sample's radiance times projected area towards a receiver: `data` is the sample's, `cosine` the
        cosine between its normal and the direction to the receiver.
    uint debug_color_id_NAME(uint index)
        A number that stays the same while other lights are added and removed; debug views give each number a color.
    LightHit evaluate_NAME(uint index, vec3 direction)
        Kinds at infinity only: what a ray in this direction finds of the light if it hits no surface.
    LightHit intersect_NAME(uint index, vec3 origin, vec3 direction, float t_max)
        Kinds that rays pass only: what a ray of this length finds of the light.
    ResolvedLightSample sample_for_receiver_NAME(ResolvedLightSample light_sample, vec3 receiver)
        Kinds that depend on the receiver only: the resolved sample as one receiver sees it. Samples of kinds that rays
        meet BEYOND them are then directions with pdfs in solid angle, as those of kinds at infinity.

`index` is the light's record in the kind's own buffer, or for emissive meshes the instance. NAME.glsl declares the
buffer, in set 0. tests/proofs/lights/test_light_kinds.py adds two kinds in this way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.bound.features import FEATURES
from solari_vk.gpu.shaders import headers
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.punctual import PointLight, PunctualLight, SpotLight
from solari_vk.scene.matrices import unit
from solari_vk.scene.model import DirectionalLight, Instance

# Where rays meet lights.
AT_SURFACES = "at surfaces"
NEVER = "never"
BEYOND = "beyond"
PASSED = "passed"
AT_INFINITY = "at infinity"
# In the order of the list of lights, so that those of a place lie side by side.
PLACES = (AT_SURFACES, NEVER, BEYOND, PASSED, AT_INFINITY)
# Meters from a light's shadows to what casts them, roughly: how far shadows move when the light turns.
SHADOW_DISTANCE = 10.0


@dataclass(frozen=True)
class LightKind:
    """A row of `LIGHT_KINDS`.

    name: part of the names of files, functions and constants in GLSL. source: the class of the scene's objects, of
    which the kind is those that `holds` takes. met_by_rays: where rays meet such a light without having chosen it:
    AT_SURFACES, AT_INFINITY, NEVER, PASSED: on their way, which goes on, or BEYOND: at infinity, on a way through the
    light. depends_on_receiver: whether there is a sample_for_receiver_NAME. buffer: the buffer of its records, whose
    fields `record` gives; None: the light's index is its instance's row. places: the fields that are points in the
    scene. power: luminous flux in lumens, roughly, of a light and a number: of an emissive surface its area in square
    meters, of a portal the flux of environments in lux, for all other kinds the scene's cross-section in square meters.
    position: a point (3,) in meters that moves when the light does, None for instances, whose geometry says it. bounds:
    the box around the light, min and max (2, 3) in meters; None for instances and lights at infinity.
    """

    name: str
    source: type[Any]
    met_by_rays: str
    power: Callable[[Any, float], float]
    buffer: str | None = None
    record: Callable[[Any], dict[str, Any]] = lambda light: {}
    places: tuple[str, ...] = ()
    position: Callable[[Any], NDArray[np.float64]] | None = None
    bounds: Callable[[Any], NDArray[np.float64]] | None = None
    depends_on_receiver: bool = False
    holds: Callable[[Any], bool] = lambda light: True


def luminance(color: NDArray[np.float32]) -> float:
    """The luminance of a linear Rec. 709 color (3,)."""
    return float(sum(weight * channel for weight, channel in zip(LUMINANCE_WEIGHTS, color.tolist(), strict=True)))


def _directional_record(light: DirectionalLight) -> dict[str, Any]:
    half_angle = light.angular_diameter / 2
    one_minus_cos = 2 * math.sin(half_angle / 2) ** 2
    return {
        "direction_to_light": -light.direction,
        "one_minus_cos_half_angle": one_minus_cos,
        # The illuminance is divided by the disk's cosine-weighted integral, pi sin^2, not by its solid angle: a surface
        # that faces the light's center then receives the stated illuminance however wide the disk is.
        "radiance": light.color * (light.illuminance / (math.pi * math.sin(half_angle) ** 2)),
        "solid_angle": 2 * math.pi * one_minus_cos,
    }


def _portal_record(light: Portal) -> dict[str, Any]:
    u = 2 * light.half_u.astype(np.float64)
    v = 2 * light.half_v.astype(np.float64)
    normal = light.transform[:3, 2]
    return {
        "corner": light.center - light.half_u - light.half_v,
        "side_u": u,
        "side_v": v,
        "normal": normal,
        "dual_u": np.cross(v, normal) / light.area,
        "dual_v": np.cross(normal, u) / light.area,
        "area": light.area,
    }


def _corners(light: Portal) -> NDArray[np.float64]:
    signs = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    corners: NDArray[np.float64] = light.center + signs @ np.stack([light.half_u, light.half_v]).astype(np.float64)
    return corners


def _punctual_record(light: PointLight | SpotLight) -> dict[str, Any]:
    scale, offset = light.falloff
    area = math.pi * light.radius**2  # of the disk that the sphere's outline is: radiance times it is intensity
    return {
        "position": light.position,
        "radius": light.radius,
        "strength": light.color * (light.intensity / (area or 1.0)),
        "axis": light.direction,
        "cone_scale": scale,
        "cone_offset": offset,
        "inverse_range": 1 / light.range if light.range else 0.0,
    } | (_profile_record(light) if isinstance(light, PointLight) and light.profile else {"profile": 0})


def _profile_record(light: PointLight) -> dict[str, Any]:
    """The axes of the profile; its buffer is the light list's."""
    axis = light.direction.astype(np.float64)
    horizontal = unit(light.horizontal - axis * (axis @ light.horizontal))
    return {"profile_axes": np.stack([horizontal, np.cross(horizontal, axis), axis])}  # GLSL holds columns


def _punctual_kind(name: str, met_by_rays: str, holds: Callable[[PunctualLight], bool]) -> LightKind:
    return LightKind(
        name,
        PunctualLight,
        met_by_rays,
        power=lambda light, area: light.solid_angle * light.intensity * luminance(light.color),
        buffer=f"{name}_lights",
        record=_punctual_record,
        places=("position",),
        position=lambda light: light.position + (SHADOW_DISTANCE * light.direction if light.axes else 0.0),
        bounds=lambda light: light.position + light.radius * np.array([[-1.0], [1.0]]),
        depends_on_receiver=True,
        holds=holds,
    )


LIGHT_KINDS = (
    LightKind(
        "emissive_mesh",
        Instance,
        AT_SURFACES,
        power=lambda instance, area: (
            math.pi * area * luminance(instance.material.emissive) * (2 if instance.material.double_sided else 1)
        ),
    ),
    LightKind(
        "directional",
        DirectionalLight,
        AT_INFINITY,
        power=lambda light, area: area * light.illuminance * luminance(light.color),
        buffer="directional_lights",
        record=_directional_record,
        position=lambda light: -SHADOW_DISTANCE * light.direction,
    ),
    LightKind(
        "environment",
        EnvironmentLight,
        AT_INFINITY,
        power=lambda light, area: area * light.flux,
        buffer="environments",
        record=lambda light: {"intensity": light.intensity, "world_from_map": light.rotation.T},  # GLSL holds columns
        position=lambda light: SHADOW_DISTANCE * light.brightest,
        depends_on_receiver=True,
    ),
    LightKind(
        "portal",
        Portal,
        BEYOND,
        power=lambda light, flux: light.cross_section * flux,
        buffer="portals",
        record=_portal_record,
        places=("corner",),
        position=lambda light: light.center - light.half_u - light.half_v,
        bounds=lambda light: np.stack([_corners(light).min(axis=0), _corners(light).max(axis=0)]),
        depends_on_receiver=True,
    ),
    _punctual_kind("point", NEVER, lambda light: light.radius == 0),
    _punctual_kind("sphere", PASSED, lambda light: light.radius > 0),
)
KIND_INDEX = {kind.name: index for index, kind in enumerate(LIGHT_KINDS)}
"""Each kind's number in the shaders: LIGHT_NAME, and the field `kind` of light sources and of light samples."""


def kind_of(light: Any) -> LightKind:
    """The row of a light that is no instance."""
    return next(kind for kind in LIGHT_KINDS if isinstance(light, kind.source) and kind.holds(light))


def glsl_header() -> str:
    """The generated header: LIGHT_*, the kinds' files, and functions that call those of a given kind."""
    every = list(LIGHT_KINDS)
    dependent = [kind for kind in LIGHT_KINDS if kind.depends_on_receiver]
    # for_shadow_ray makes directions of samples at infinity before the function for shadow samples is called.
    near = [kind for kind in dependent if kind.met_by_rays not in (BEYOND, AT_INFINITY)]
    passed = " || ".join(_feature(kind) or "true" for kind in _met(PASSED))
    return "\n".join(
        [
            '#include "generated/bound/features.glsl"',
            headers.enumeration("LIGHT", [kind.name for kind in every]),
            headers.constants(KINDS_AT_INFINITY=_mask(BEYOND, AT_INFINITY)),
            headers.constants(KINDS_HIT_BY_RAYS=_mask(AT_SURFACES, BEYOND, PASSED, AT_INFINITY)),
            # A macro, because a constant with the value of a specialization constant would keep its default.
            f"#define HAS_PASS_THROUGH_LIGHTS ({passed})",
            *(f'#include "scene/lights/{kind.name}.glsl"' for kind in every),
            _choose("ResolvedLightSample resolve_light", "uint part, vec2 u, float inverse_probability", every),
            _choose("float emission_cosine", "float cosine", every, argument="data"),
            _choose("uint debug_color_id", "", every),
            _choose("LightHit evaluate_light", "vec3 direction", _met(AT_INFINITY)),
            _choose("LightHit intersect_light", "vec3 origin, vec3 direction, float t_max", _met(PASSED)),
            _for_receiver("light_sample", dependent),
            _for_receiver("shadow_sample", near),
        ]
    )


def _met(place: str) -> list[LightKind]:
    """The kinds that rays meet there."""
    return [kind for kind in LIGHT_KINDS if kind.met_by_rays == place]


def _mask(*places: str) -> int:
    """A number whose bit i says whether rays meet the kind i at one of these places."""
    return sum(1 << index for index, kind in enumerate(LIGHT_KINDS) if kind.met_by_rays in places)


def _is(kind: LightKind, value: str) -> str:
    """A condition that holds if a value is the number of the kind, which costs nothing in scenes without such a light
    if the kind is a scene feature too."""
    feature = _feature(kind)
    return (f"{feature} && " if feature else "") + f"{value} == LIGHT_{kind.name.upper()}"


def _feature(kind: LightKind) -> str:
    """The constant of the scene feature of the kind's name, "" if there is none."""
    return next((feature.constant for feature in FEATURES if feature.name.lower() == kind.name), "")


def _choose(function: str, parameters: str, kinds: list[LightKind], argument: str = "index") -> str:
    """A function `TYPE NAME(kind, argument, parameters)` that calls the kind's own."""
    own = function.split()[-1].removesuffix("_light")
    names = [argument, *(parameter.split()[-1] for parameter in parameters.split(", ") if parameter)]
    # The last kind needs no condition. Kinds that are scene features come first, whose conditions say more.
    in_order = sorted(kinds, key=lambda kind: "&&" not in _is(kind, "kind"))
    *lines, last = [
        f"if ({_is(kind, 'kind')}) {{ return {own}_{kind.name}({', '.join(names)}); }}" for kind in in_order
    ]
    unconditional = last[last.index("return") : -2]
    declared = ", ".join(["uint kind", f"uint {argument}", *([parameters] if parameters else [])])
    return "\n".join([f"{function}({declared}) {{", *lines, unconditional, "}"])


def _for_receiver(name: str, kinds: list[LightKind]) -> str:
    """A function that calls the own ones of some kinds, and returns samples of all others as they are."""
    lines = [
        f"if ({_is(kind, 'light_sample.kind')}) {{ return sample_for_receiver_{kind.name}(light_sample, receiver); }}"
        for kind in kinds
    ]
    head = f"ResolvedLightSample {name}_for_receiver(ResolvedLightSample light_sample, vec3 receiver) {{"
    return "\n".join([head, *lines, "return light_sample;", "}"])
