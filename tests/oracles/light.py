"""Closed forms of light transport, and sums over environment maps in double precision."""

import math

import numpy as np
from oracles.rays import over_pixels

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import rgb


def closed_box_radiance(emission, albedo, bounces):
    """The radiance everywhere in a closed Lambert box whose walls all emit, after `bounces` bounces."""
    return emission * sum(albedo**k for k in range(bounces + 1))


def polygon_irradiance(points, normals, corners, radiance):
    """Irradiance (N,) from a polygon (K, 3) of constant radiance, wholly above each point's horizon (Lambert 1760).

    E = L / 2 * sum over edges of the angle between corner directions times cos of the edge plane's normal.
    """
    points, normals = (np.atleast_2d(np.asarray(vectors, np.float64)) for vectors in (points, normals))
    rays = np.asarray(corners, np.float64)[None] - points[:, None]
    if (np.einsum("nki,ni->nk", rays, normals) < -1e-9).any():
        raise ValueError("the polygon dips below a point's horizon")
    # Only the directions to the corners matter: the edges become arcs on the unit sphere.
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    following = np.roll(rays, -1, axis=1)
    across = np.cross(rays, following)
    length = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(length, np.einsum("nki,nki->nk", rays, following))
    share = np.einsum("nki,ni->nk", across, normals) / np.maximum(length, 1e-300)
    return radiance * np.abs((angle * share).sum(axis=1)) / 2


def sun_radiance(illuminance, angular_diameter):
    """Radiance of a sun's disk that gives a surface facing it the illuminance: E = L pi sin^2(half angle)."""
    return illuminance / (math.pi * math.sin(angular_diameter / 2) ** 2)


def sun_irradiance(illuminance, angular_diameter, cos_incidence):
    """Irradiance of a surface that sees the whole disk; the mean cosine over the disk is the cosine at its center."""
    return sun_radiance(illuminance, angular_diameter) * math.pi * math.sin(angular_diameter / 2) ** 2 * cos_incidence


def environment_radiance(environment, directions):
    """The radiance (N, 3) from directions (N, 3), interpolated between the centers of the image's pixels."""
    image = environment.image.astype(np.float64) * environment.intensity
    height, width = image.shape[:2]
    x, y, z = (np.asarray(directions, np.float64) @ environment.rotation.astype(np.float64)).T
    column = width * (np.arctan2(z, x) / (2 * np.pi) + 0.5) - 0.5
    row = height * np.arctan2(np.hypot(x, z), y) / np.pi - 0.5
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, bottom_share = (column - left)[:, None], (row - top)[:, None]

    def at(rows, columns):
        return image[rows.clip(0, height - 1), columns % width]

    upper = at(top, left) * (1 - right_share) + at(top, left + 1) * right_share
    lower = at(top + 1, left) * (1 - right_share) + at(top + 1, left + 1) * right_share
    return upper * (1 - bottom_share) + lower * bottom_share


def environment_irradiance(environment, normal, rows=512):
    """The irradiance (3,) of a surface with this unit normal (3,): a sum over a grid of directions around it."""
    z = np.asarray(normal, np.float64)
    x = np.cross(z, (0.0, 0.0, 1.0) if abs(z[2]) < 0.9 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    # The square of the sine is even over cosine-weighted directions.
    share = np.repeat((np.arange(rows) + 0.5) / rows, 2 * rows)
    turn = np.tile(2 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows), rows)
    sine = np.sqrt(share)
    local = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.sqrt(1 - share)], axis=-1)
    return np.pi * environment_radiance(environment, local @ np.stack([x, np.cross(z, x), z])).mean(axis=0)


# ---- a lamp over a floor, whose light has a closed form ----


# A tilted lamp that faces the floor. Cameras don't see the back sides of surfaces, so it hides nothing of the floor.
LAMP_CORNERS = np.array([(-0.6, 1.2, -0.4), (0.7, 1.2, -0.4), (0.7, 1.5, 0.5), (-0.6, 1.5, 0.5)])
LAMP_RADIANCE = np.array((5.0, 3.0, 1.0))
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


def lamp_above(corners=LAMP_CORNERS, brightness=1.0):
    """A lamp with these corners that emits LAMP_RADIANCE times `brightness`."""
    material = sv.Material(base_color=rgb(0), reflectance=rgb(0), emissive=rgb(LAMP_RADIANCE * brightness))
    material.double_sided = False  # the camera looks past it from above
    return sv.Instance(mesh=shapes.polygons(corners), material=material, name="lamp")


def lamp_on_lambert(scene, size, corners=LAMP_CORNERS):
    """The picture (size, size, 3) of a Lambert floor under the lamp with these corners, by its closed form."""

    def irradiance(points):
        return polygon_irradiance(points, [(0.0, 1.0, 0.0)], corners, 1.0)

    return over_pixels(scene.camera, size, irradiance) * LAMP_RADIANCE * ALBEDO / math.pi
