"""Closed forms of light transport: polygons over a floor, the sun's disk, a closed box."""

import math

import numpy as np

from solari_vk.scene.matrices import transform_directions


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


def camera_rays(camera, width, height, offset=(0.5, 0.5)):
    """Origins and unit directions (h, w, 3), row 0 at the top, through `offset` within each pixel (x right, y down)."""
    x = (np.arange(width) + offset[0]) / width * 2 - 1
    y = 1 - (np.arange(height) + offset[1]) / height * 2
    parallel = camera.orthographic_height
    half_height = parallel / 2 if parallel else np.tan(camera.vertical_fov / 2)
    x, y = np.meshgrid(x * half_height * width / height, y * half_height)
    across, along = np.stack([x, y, 0 * x], axis=-1), np.broadcast_to((0.0, 0.0, -1.0), (height, width, 3))
    directions = transform_directions(camera.transform, along if parallel else along + across)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    start = transform_directions(camera.transform, across) if parallel else np.zeros(directions.shape)
    return camera.transform[:3, 3] + start, directions


def over_pixels(camera, size, value, nodes=3):
    """Pixel means (size, size, C) of value(points (N, 3)) on the floor y = 0, by Gauss-Legendre within each pixel."""
    at, weights = np.polynomial.legendre.leggauss(nodes)
    total = np.zeros((size, size, 1))
    for i, j in np.ndindex(nodes, nodes):
        origins, directions = camera_rays(camera, size, size, (float(at[i] + 1) / 2, float(at[j] + 1) / 2))
        points = origins - (origins[..., 1] / directions[..., 1])[..., None] * directions
        found = value(points.reshape(-1, 3)).reshape(size, size, -1)
        total = total + found * weights[i] * weights[j] / 4
    return total
