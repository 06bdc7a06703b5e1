"""Lights of MuJoCo's models in physical units.

MuJoCo's own pictures add up colors: a light with a diffuse color of 1 shows a white surface that faces it as 1. Here it
gives the illuminance with which that surface has `surfaces.WHITE`, at the distance of the model's middle. Lights with
an intensity in candela are what they say.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from solari_vk.scene.files.mujoco.surfaces import WHITE, sky_image, texels, upward
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.environment import Environment
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.punctual import PointLight, SpotLight

FULL = math.pi * WHITE
"""Lux of a diffuse color of 1."""
AMBIENT = "ambient"
"""The name of the environment that ambient colors make."""
BRIGHTEST_SKY = 0.4
"""Of what a sky of `surfaces.WHITE` all around would give: brighter ones are dimmed to it."""
_HALF = math.sqrt(0.5)  # the share of a spotlight's ramp whose square is a half
_NARROWEST = 1e-3  # radians: a cutoff of 0 is as good as dark
_WIDEST = math.radians(89.9)


def light_fields(mujoco: Any, model: Any, light: Any) -> tuple[type[Light], dict[str, Any]] | None:
    """The class of an mjvLight and its fields; None for one that is dark or is a picture."""
    color = np.maximum(np.array(light.diffuse, np.float64), 0)
    kind = mujoco.mjtLightType(int(light.type)).name[8:]
    if not color.any() or kind == "IMAGE":
        return None
    direction = upward(light.dir)
    fields: dict[str, Any] = {"color": color}
    if kind == "DIRECTIONAL":
        # A headlight stands at the camera: its shadows are those of a light from the view direction.
        return DirectionalLight, fields | {"direction": direction, "illuminance": FULL}
    position = np.array(light.pos, np.float64)
    fields["position"] = upward(position)
    if light.intensity > 0:
        fields |= {"intensity": float(light.intensity), "radius": _radius(light), "range": float(light.range) or None}
    else:
        # At least a tenth of the model away, so that a light in its middle isn't dark.
        distance = max(float(np.linalg.norm(position - model.stat.center)), 0.1 * float(model.stat.extent))
        # MuJoCo's list of lights has the attenuation of spotlights only.
        constant, along, square = model.light_attenuation[int(light.id)].tolist()
        dimming = max(constant + along * distance + square * distance**2, 1e-6)
        fields["intensity"] = FULL * distance**2 / dimming
    if kind == "POINT":
        return PointLight, fields
    return SpotLight, fields | {"direction": direction} | _cone(float(light.cutoff), float(light.exponent))


def light_numbers(model: Any, light: Any) -> tuple[float, ...]:
    """What an mjvLight's fields depend on, but for where it is."""
    attenuation = [] if light.headlight else model.light_attenuation[int(light.id)].tolist()
    single = (light.type, light.intensity, light.bulbradius, light.range, light.cutoff, light.exponent)
    return (*np.array(light.diffuse).tolist(), *map(float, single), *attenuation)


def _radius(light: Any) -> float:
    return float(light.bulbradius) if light.bulbradius >= 1e-5 else 0.0


def _cone(cutoff: float, exponent: float) -> dict[str, float]:
    """The cones of a spotlight whose light is halved at the same angle as cosine ** exponent."""
    outer = min(max(math.radians(cutoff), _NARROWEST), _WIDEST)
    edge = math.cos(outer)
    half = max(0.5 ** (1 / max(exponent, 1e-3)), edge + 1e-3 * (1 - edge))
    inner = min(edge + (half - edge) / _HALF, 1.0)
    return {"outer_cone_angle": outer, "inner_cone_angle": min(math.acos(inner), 0.999 * outer)}


def environment_of(mujoco: Any, model: Any, lights: Any) -> Environment | None:
    """What shines from everywhere: the file's skybox or image light, else the ambient light of its lights, as one."""
    pictures = [int(light.texid) for light in lights if light.texid >= 0]
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).tolist()
    for number in (*pictures, *skies):
        pixels = texels(model, number)
        if len(pixels) % pixels.shape[1] == 0:  # faces, and no picture of another kind
            found = Environment(sky_image(pixels), name=model.texture(number).name)
            # MuJoCo's sky is a background that lights nothing; files have lights that are enough without it.
            found.intensity = min(1.0, BRIGHTEST_SKY * 4 * FULL / max(found.flux, 1e-9))
            return found
    ambient = sum((np.array(light.ambient, np.float64) for light in lights), np.zeros(3))
    return Environment(WHITE * ambient, name=AMBIENT) if ambient.any() else None
