"""Lights: closed forms for a lamp and a sun over a floor, and changes that must not change the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import solari_vk as sv
from solari_vk.conformance.oracles import closed_forms
from solari_vk.conformance.pictures import Picture, compare_picture, take_picture
from solari_vk.conformance.rules import Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene import shapes
from solari_vk.scene.builtin import rgb

# Five standard errors more than the interval on lavapipe, because other devices give other noise.
BAR = 0.005
# A tilted lamp that faces the floor. Cameras don't see the back sides of surfaces, so it hides nothing of the floor.
LAMP_CORNERS = np.array([(-0.6, 1.2, -0.4), (0.7, 1.2, -0.4), (0.7, 1.5, 0.5), (-0.6, 1.5, 0.5)])
LAMP_RADIANCE = np.array((5.0, 3.0, 1.0))
_PATCHES, _BRIGHT = 8, (slice(1, 5), slice(3, 5))  # along the lamp's sides
_ALBEDO = np.array((0.8, 0.5, 0.2))
_CLOSED, _INVARIANT = "closed form", ("invariance", "the same light, described differently")


def _on_lamp(u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
    """Points (N, 3) of the lamp, a parallelogram, at coordinates (N,) from 0 to 1."""
    a, b, _, d = LAMP_CORNERS
    points: NDArray[Any] = a + u[:, None] * (b - a) + v[:, None] * (d - a)
    return points


def floor_scene(material: sv.Material, *extra: Any) -> sv.Scene:
    """A floor 8 m wide, seen at a slant from a height of 3 m; it fills the picture."""
    floor = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=material, name="floor")
    camera = sv.Camera.look_at((0.4, 3, 1.5), (0, 0, 0), vertical_fov=math.radians(50))
    return sv.Scene(floor, camera, *extra)


def patched_lamp() -> sv.Instance:
    """The lamp in _PATCHES x _PATCHES patches; its texture is black but for those of _BRIGHT, where it is white."""
    steps = np.linspace(0, 1, _PATCHES + 1)
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    first = (np.arange(_PATCHES)[:, None] * (_PATCHES + 1) + np.arange(_PATCHES)).ravel()
    quads = first[:, None] + np.array([0, 1, _PATCHES + 2, _PATCHES + 1])
    pixels = np.zeros((_PATCHES, _PATCHES, 3), np.uint8)
    pixels[_BRIGHT[1], _BRIGHT[0]] = 255
    mesh = sv.Mesh(_on_lamp(u, v), quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), uvs=np.stack([u, v], axis=1))
    lamp = lamp_above()
    lamp.mesh, lamp.material.emissive_texture = mesh, sv.Texture(sv.TextureImage(pixels), magnification="nearest")
    return lamp


def lamp_above(corners: ArrayLike = LAMP_CORNERS, brightness: float = 1.0) -> sv.Instance:
    """A lamp with these corners that emits LAMP_RADIANCE times `brightness`."""
    material = sv.Material(base_color=rgb(0), reflectance=rgb(0), emissive=rgb(LAMP_RADIANCE * brightness))
    return sv.Instance(mesh=shapes.polygons(corners), material=material, name="lamp")


def lamp_on_lambert(scene: sv.Scene, size: int, corners: NDArray[Any] = LAMP_CORNERS) -> NDArray[Any]:
    """The picture (size, size, 3) of a Lambert floor under the lamp with these corners, by its closed form."""
    up = np.array([(0.0, 1.0, 0.0)])
    irradiance = closed_forms.over_pixels(
        scene.camera, size, lambda points: closed_forms.polygon_irradiance(points, up, corners, 1.0)
    )
    radiance: NDArray[Any] = irradiance * LAMP_RADIANCE * _ALBEDO / math.pi
    return radiance


def measure_lamp(device: Device, strategy: str) -> Iterator[Measurement]:
    """An emissive polygon over a Lambert floor."""
    scene = floor_scene(sv.Material(base_color=rgb(_ALBEDO)), lamp_above())
    samples, bar = (8192, 2 * BAR) if strategy == "brdf" else (1024, BAR)
    made = take_picture(device, scene, (32, 32), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    source = (_CLOSED, "irradiance of a polygon (Lambert 1760)")
    yield from compare_picture(f"a lamp over a floor, {strategy}", source, made, lamp_on_lambert(scene, 32), bar)


def measure_textured_lamp(device: Device, strategy: str) -> Iterator[Measurement]:
    """A lamp of many triangles of which few are bright."""
    scene = floor_scene(sv.Material(base_color=rgb(_ALBEDO)), patched_lamp())
    samples, bar = (16384, 4 * BAR) if strategy == "brdf" else (1024, BAR)
    made = take_picture(device, scene, (32, 32), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    (left, right), (near, far) = ((part.start / _PATCHES, part.stop / _PATCHES) for part in _BRIGHT)
    corners = _on_lamp(np.array([left, right, right, left]), np.array([near, near, far, far]))
    source = (_CLOSED, "irradiance of a polygon (Lambert 1760)")
    expected = lamp_on_lambert(scene, 32, corners)
    yield from compare_picture(f"a lamp with a bright spot over a floor, {strategy}", source, made, expected, bar)


def measure_sun(device: Device, diameter: float, strategy: str) -> Iterator[Measurement]:
    """A sun's disk over a Lambert floor."""
    sun = sv.DirectionalLight(
        direction=rgb((1, -1.5, 0.3)), illuminance=1000, color=rgb((1, 0.8, 0.6)), angular_diameter=diameter
    )
    scene = floor_scene(sv.Material(base_color=rgb(0.6)), sun)
    samples, bar = (16384, 2 * BAR) if strategy == "brdf" else (512, BAR)
    made = take_picture(device, scene, (16, 16), samples, max_bounces=1, lambert=True, light_strategy=strategy)
    irradiance = closed_forms.sun_irradiance(1000, diameter, 1.5 / math.sqrt(1 + 1.5**2 + 0.3**2))
    expected = irradiance * 0.6 / math.pi * np.array((1, 0.8, 0.6))
    source = (_CLOSED, "irradiance of a disk of constant radiance")
    yield from compare_picture(f"a sun {diameter:g} rad wide, {strategy}", source, made, expected, bar)


def measure_invariance(device: Device) -> Iterator[Measurement]:
    """Split and reordered lamps give the same picture; a brighter lamp gives a picture brighter by its factor."""
    floor = sv.Material(base_color=rgb(_ALBEDO))

    def picture(*lamps: sv.Instance, seed: int = 0) -> Picture:
        scene = floor_scene(floor, *lamps)
        return take_picture(device, scene, (32, 32), 512, max_bounces=1, lambert=True, seed=seed)

    a, b, c, d = LAMP_CORNERS
    near, far = (a + b) / 2, (c + d) / 2
    parts = [lamp_above(np.array(corners)) for corners in ([a, near, far, d], [near, b, c, far])]
    whole = picture(lamp_above())
    for name, other in (
        ("a lamp in two parts", picture(*parts, seed=1)),
        ("the same parts in another order", picture(*parts[::-1], seed=2)),
    ):
        yield from compare_picture(name, _INVARIANT, other, whole.mean, 3 * BAR, whole.variance)
    bright = picture(lamp_above(brightness=1024.0))
    error = np.abs(bright.mean / (1024 * whole.mean) - 1).max()
    rule = Rule("a lamp 1024 times as bright gives 1024 times the radiance", *_INVARIANT)
    yield Measurement(rule, float(error), 1e-5, "relative error")
