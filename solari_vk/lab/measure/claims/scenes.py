"""Scenes that claims need beside the built-in ones."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene


def street() -> Scene:
    """A long street between two rows of houses, lit by the sun and by lamps; the camera looks along it."""
    random, scene, half = np.random.default_rng(3), Scene(name="street"), 120.0
    scene.add(shapes.quad((0, 0, 0), (0, 0, half + 20), (30, 0, 0)), material=matte(0.4, "ground"))
    cube, ball = shapes.box(), shapes.sphere(0.3, 8)
    paints = [matte(0.3 + 0.5 * random.random(3), f"paint {i}") for i in range(8)]
    for z in np.arange(-half, half, 6.0):
        for side in (-1.0, 1.0):
            height = random.uniform(6, 14)
            at = (side * (9 + random.uniform(0, 2)), height / 2, z)
            paint = paints[int(random.integers(len(paints)))]
            scene.add(cube, material=paint, transform=place((6, height, 5), at))
            at = (side * random.uniform(3, 5.5), 0.5, z + random.uniform(-2, 2))
            scene.add(cube, material=paint, transform=place((1, 1, 1.4), at, random.uniform(0, 3)))
        if int(z) % 4 == 0:
            scene.add(ball, material=lamp((60, 45, 25)), transform=place(at=(0, 4.5, z)))
    scene.add(DirectionalLight(direction=rgb((0.7, -1.0, 0.35)), illuminance=20.0, angular_diameter=0.05))
    scene.add(Camera.look_at((0, 2, half), (0, 2, -half), vertical_fov=math.radians(60), ev100=2.0))
    return scene


def ball_in_white(perceptual_roughness: float = 0.6, metallic: float = 0.0) -> Scene:
    """A white ball in a black sphere that glows with radiance 1: nothing of the picture may differ from 1."""
    sky = Instance(mesh=shapes.sphere(8.0, 24), material=lamp(1.0, double_sided=True), name="white")
    white = Material(base_color=rgb(1), perceptual_roughness=perceptual_roughness, metallic=metallic, name="ball")
    ball = Instance(mesh=shapes.sphere(1.0, 96), material=white, name="ball")
    return Scene(sky, ball, Camera.look_at((0, 0, 6), (0, 0, 0), vertical_fov=2 * math.asin(1.02 / 6)))
