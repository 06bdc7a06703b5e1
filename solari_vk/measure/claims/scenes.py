"""Scenes that claims need beside the built-in ones."""

from __future__ import annotations

import math

import numpy as np

from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb
from solari_vk.scene.matrices import rotation, turned_about
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

BEVY_EV100 = 9.7  # Bevy's default exposure, under which a sun's disk is far brighter than any packed number


def sunlit_yard() -> Scene:
    """A sun of 100,000 lux and a lamp over a floor with a block, exposed as Bevy does by default."""
    scene = Scene(name="sunlit_yard")
    scene.add(shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=matte(0.5, "floor"))
    scene.add(shapes.box((-0.5, 0, -0.5), (0.5, 1, 0.5)), material=matte(0.5, "block"))
    scene.add(shapes.quad((1.5, 2.5, 0), (0.4, 0, 0), (0, 0, 0.4)), material=lamp(20_000.0))
    scene.add(DirectionalLight(direction=rgb((0.5, -1.0, -0.3)), illuminance=100_000.0, name="sun"))
    scene.add(Camera.look_at((0, 4, 5), (0, 0.3, 0), vertical_fov=math.radians(50), ev100=BEVY_EV100))
    return scene


def two_rooms(distance: float) -> tuple[Scene, Camera, Camera]:
    """Two closed rooms with a lamp each, and a camera in either."""
    scene, cameras = Scene(name="two_rooms"), []
    for x in (0.0, distance):
        scene.add(shapes.box((x - 2, 0, -2), (x + 2, 3, 2), inward=True), material=matte(0.6, "plaster"))
        scene.add(shapes.quad((x, 2.98, 0), (0.5, 0, 0), (0, 0, 0.5)), material=lamp(8.0))
        cameras.append(Camera.look_at((x + 1.5, 1.5, 1.7), (x - 0.5, 1.2, -1), vertical_fov=math.radians(70)))
    scene.add(cameras[0])
    return scene, cameras[0], cameras[1]


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


def mirror_wall() -> Scene:
    """A mirror, slanted so that its normal is no axis, in a room whose walls and stripes glow and reflect nothing: what
    the mirror shows has no noise."""
    scene = Scene(name="mirror_wall")
    scene.add(shapes.box((-3, 0, -2), (3, 3, 4), inward=True), material=lamp((0.7, 0.6, 0.5), "wall"))
    for i, x in enumerate(np.arange(-2.5, 3.0, 1.0)):
        color = ((0.8, 0.2, 0.1), (0.1, 0.3, 0.8))[i % 2]
        scene.add(shapes.quad((x, 1.5, 3.98), (-0.25, 0, 0), (0, 1.5, 0)), material=lamp(color, "stripe"))
    mirror = Material(base_color=rgb(0.95), metallic=1.0, perceptual_roughness=0.0, name="mirror")
    turned = place(at=(0.1, 1.4, -1.2), turn=0.2) @ turned_about((0, 0, 0), rotation((1, 0, 0), 0.11), np.eye(4))
    scene.add(shapes.quad((0, 0, 0), (1.9, 0, 0), (0, 1.2, 0)), material=mirror, transform=turned)
    scene.add(Camera.look_at((0.4, 1.5, 2.6), (0.1, 1.4, -1.2), vertical_fov=math.radians(48), ev100=-1.0))
    return scene


def ball_in_white(perceptual_roughness: float, metallic: float = 0.0) -> Scene:
    """A white ball in a black sphere that glows with radiance 1: nothing of the picture may differ from 1."""
    sky = Instance(mesh=shapes.sphere(8.0, 24), material=lamp(1.0, double_sided=True), name="white")
    white = Material(base_color=rgb(1), perceptual_roughness=perceptual_roughness, metallic=metallic, name="ball")
    ball = Instance(mesh=shapes.sphere(1.0, 96), material=white, name="ball")
    return Scene(sky, ball, Camera.look_at((0, 0, 6), (0, 0, 0), vertical_fov=2 * math.asin(1.02 / 6)))


def white_room(perceptual_roughness: float = 0.5) -> Scene:
    """The inside of a box that glows everywhere and absorbs nothing: k bounces make it k + 1 times as bright."""
    walls = Material(base_color=rgb(1), emissive=rgb(1), perceptual_roughness=perceptual_roughness, name="wall")
    camera = Camera.look_at((0.2, 0.1, 0.4), (-0.8, -0.6, -1.0), vertical_fov=math.radians(80))
    return Scene(Instance(mesh=shapes.box((-1, -1, -1), (1, 1, 1), inward=True), material=walls), camera)
