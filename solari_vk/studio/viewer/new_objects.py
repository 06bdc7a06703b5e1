"""New objects and lights, placed where the camera looks; lights are as bright as its exposure needs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.material import Material
from solari_vk.scene.objects import Instance, Mesh
from solari_vk.scene.placement import placed
from solari_vk.scene.shapes import box, capsule, cone, cylinder, plane, sphere, torus
from solari_vk.studio.viewer.camera_control import CameraControl

SHAPES: dict[str, Callable[[], Mesh]] = {
    "box": lambda: box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)),
    "sphere": lambda: sphere(0.5),
    "plane": plane,
    "cylinder": cylinder,
    "cone": cone,
    "capsule": capsule,
    "torus": lambda: torus(0.375, 0.125),
}
"""Meshes about 1 m wide around the origin, by the names of the objects that they become."""
SIZE = 0.2  # of a new object, as a share of the height of what is seen

LIGHTS = {
    "point": ("lamp", "a lamp that shines in all directions"),
    "spot": ("spotlight", "a lamp that shines into a cone"),
    "sun": ("sun", "light from one direction, as from far away"),
}
"""The kinds of new lights: the name of the first one, and what it is."""
SMALLEST_RADIUS = 1e-4  # meters: lights that would be smaller are points, far above the smallest sphere there may be
SUN = (-0.5, -1.0, -0.6)  # in the camera's view: from above the left shoulder


def new_shape(kind: str, control: CameraControl) -> Instance:
    """An object of one of SHAPES, which stands on the point that the camera sees in the middle."""
    mesh = SHAPES[kind]()
    size = SIZE * control.seen_height
    lowest = float(mesh.positions[:, 1].min())
    position = control.center - (0, size * lowest, 0)
    return Instance(mesh, Material(name=kind), placed(None, kind, position=position, scale=size))


def new_light(kind: str, control: CameraControl) -> Light:
    """A light of one of LIGHTS, over the point that the camera sees in the middle, with which white is about white."""
    camera = control.camera
    # A picture is white at 1.2 * 2^EV100 cd/m^2 (Lagarde and de Rousiers, "Moving Frostbite to PBR", 2014, section
    # 5.1). A white Lambertian surface has that radiance at pi times as many lux.
    illuminance = math.pi * 1.2 * 2.0**camera.ev100
    if kind == "sun":
        x = camera.transform[:3, 0]
        back = camera.transform[:3, 2] * (1, 0, 1)
        direction = -SUN[0] * x + SUN[1] * np.array((0, 1, 0)) + SUN[2] * back
        return DirectionalLight(direction.astype(np.float32), illuminance=illuminance)
    # Sizes follow from what the picture shows, so that a lamp suits a ring as well as a town.
    height = 0.2 * control.seen_height
    position = control.center + np.array((0, height, 0)) + 0.3 * height * camera.transform[:3, 2]
    # The illuminance of a point light falls with the squared distance: I = E d^2.
    intensity = illuminance * float(np.sum((position - control.center) ** 2))
    size = 0.05 * height
    radius = size if size > SMALLEST_RADIUS else 0.0
    if kind == "point":
        return PointLight(position, intensity=intensity, radius=radius)
    return SpotLight(
        position,
        control.center - position,
        intensity=intensity,
        radius=radius,
        inner_cone_angle=0.3,
        outer_cone_angle=0.6,
    )
