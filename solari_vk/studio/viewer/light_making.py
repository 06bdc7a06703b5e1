"""New lights, placed where the camera looks and as bright as its exposure needs."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.studio.viewer.camera_control import CameraControl

LIGHTS = {
    "point": ("lamp", "a lamp that shines in all directions"),
    "spot": ("spotlight", "a lamp that shines into a cone"),
    "sun": ("sun", "light from one direction, as from far away"),
}
"""The kinds of new lights: the name of the first one, and what it is."""
SUN = (-0.5, -1.0, -0.6)  # in the camera's view: from above the left shoulder


def new_light(kind: str, control: CameraControl) -> Light:
    """A light of one of LIGHTS, over the point that the camera sees in the middle, with which white is about white."""
    camera = control.camera
    illuminance = math.pi * 1.2 * 2.0**camera.ev100  # of a white Lambert surface that is shown as white
    if kind == "sun":
        x, back = camera.transform[:3, 0], camera.transform[:3, 2] * (1, 0, 1)
        direction = -SUN[0] * x + SUN[1] * np.array((0, 1, 0)) + SUN[2] * back
        return DirectionalLight(direction.astype(np.float32), illuminance=illuminance)
    height = 0.2 * control.seen_height
    position = control.center + np.array((0, height, 0)) + 0.3 * height * camera.transform[:3, 2]
    intensity = illuminance * float(np.sum((position - control.center) ** 2))
    size = 0.05 * height
    if kind == "point":
        return PointLight(position, intensity=intensity, radius=size if size > 1e-4 else 0.0)
    return SpotLight(
        position,
        control.center - position,
        intensity=intensity,
        radius=size if size > 1e-4 else 0.0,
        inner_cone_angle=0.3,
        outer_cone_angle=0.6,
    )
