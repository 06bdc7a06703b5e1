"""A lamp over a floor, whose light has closed forms."""

import math

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import rgb
from support.oracles import closed_forms

# Five standard errors more than the interval on lavapipe, because other devices give other noise.
BAR = 0.005
# A tilted lamp that faces the floor. Cameras don't see the back sides of surfaces, so it hides nothing of the floor.
LAMP_CORNERS = np.array([(-0.6, 1.2, -0.4), (0.7, 1.2, -0.4), (0.7, 1.5, 0.5), (-0.6, 1.5, 0.5)])
LAMP_RADIANCE = np.array((5.0, 3.0, 1.0))
PATCHES, BRIGHT = 8, (slice(1, 5), slice(3, 5))  # along the lamp's sides
ALBEDO = np.array((0.8, 0.5, 0.2))


def on_lamp(u, v):
    """Points (N, 3) of the lamp, a parallelogram, at coordinates (N,) from 0 to 1."""
    a, b, _, d = LAMP_CORNERS
    return a + u[:, None] * (b - a) + v[:, None] * (d - a)


def floor_scene(material, *extra):
    """A floor 8 m wide, seen at a slant from a height of 3 m; it fills the picture."""
    floor = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=material, name="floor")
    camera = sv.Camera.look_at((0.4, 3, 1.5), (0, 0, 0), vertical_fov=math.radians(50))
    return sv.Scene(floor, camera, *extra)


def patched_lamp():
    """The lamp in PATCHES x PATCHES patches; its texture is black but for those of BRIGHT, where it is white."""
    steps = np.linspace(0, 1, PATCHES + 1)
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    first = (np.arange(PATCHES)[:, None] * (PATCHES + 1) + np.arange(PATCHES)).ravel()
    quads = first[:, None] + np.array([0, 1, PATCHES + 2, PATCHES + 1])
    pixels = np.zeros((PATCHES, PATCHES, 3), np.uint8)
    pixels[BRIGHT[1], BRIGHT[0]] = 255
    lamp = lamp_above()
    lamp.mesh = sv.Mesh(on_lamp(u, v), quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), uvs=np.stack([u, v], axis=1))
    lamp.material.emissive_texture = sv.Texture(sv.TextureImage(pixels), magnification="nearest")
    return lamp


def lamp_above(corners=LAMP_CORNERS, brightness=1.0):
    """A lamp with these corners that emits LAMP_RADIANCE times `brightness`."""
    material = sv.Material(base_color=rgb(0), reflectance=rgb(0), emissive=rgb(LAMP_RADIANCE * brightness))
    return sv.Instance(mesh=shapes.polygons(corners), material=material, name="lamp")


def lamp_on_lambert(scene, size, corners=LAMP_CORNERS):
    """The picture (size, size, 3) of a Lambert floor under the lamp with these corners, by its closed form."""

    def irradiance(points):
        return closed_forms.polygon_irradiance(points, [(0.0, 1.0, 0.0)], corners, 1.0)

    return closed_forms.over_pixels(scene.camera, size, irradiance) * LAMP_RADIANCE * ALBEDO / math.pi
