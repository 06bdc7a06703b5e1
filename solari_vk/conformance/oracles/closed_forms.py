"""Light transport that can be written down: polygons over a floor, the sun's disk, a closed box."""

from __future__ import annotations

import numpy as np


def closed_box_radiance(emission, albedo, bounces):
    """Radiance everywhere in a closed Lambert box whose walls all emit, after so many bounces."""
    return emission * sum(albedo**k for k in range(bounces + 1))


def polygon_irradiance(points, normals, corners, radiance):
    """Irradiance (N,) from a polygon (K, 3) of constant radiance, wholly above each point's horizon (Lambert 1760).

    E = L / 2 * sum over edges of the angle between corner directions times cos of the edge plane's normal.
    """
    points, normals = np.atleast_2d(points).astype(np.float64), np.atleast_2d(normals).astype(np.float64)
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
    return illuminance / (np.pi * np.sin(angular_diameter / 2) ** 2)


def sun_irradiance(illuminance, angular_diameter, cos_incidence):
    """Irradiance of a surface that sees the whole disk: the cosine's mean over the disk is that of its middle."""
    return sun_radiance(illuminance, angular_diameter) * np.pi * np.sin(angular_diameter / 2) ** 2 * cos_incidence
