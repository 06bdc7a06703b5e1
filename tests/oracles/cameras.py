"""Rays of cameras, what lies along them, and where points lie in pictures, in double precision."""

import numpy as np

from solari_vk.scene.matrices import transform_directions


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


def world_positions(camera, depth, jitter):
    """World positions of pixels' surfaces (h, w, 3), very far away without a surface. jitter: (x, y), in pixels."""
    height, width = depth.shape
    origin, directions = camera_rays(camera, width, height, (0.5 + jitter[0], 0.5 + jitter[1]))
    distance = np.where(depth > 0, camera.near / np.where(depth > 0, depth, 1.0), 1e9)
    along_axis = directions @ -camera.transform[:3, 2]
    return origin + directions * (distance / along_axis)[..., None]


def project(camera, positions):
    """Positions (h, w, 2) in the picture, in pixels from the top left, of world positions (h, w, 3)."""
    size = np.array(positions.shape[1::-1])
    view = (positions - camera.transform[:3, 3]) @ np.linalg.inv(camera.transform[:3, :3]).T
    parallel = camera.orthographic_height
    half_height = parallel / 2 if parallel else -view[..., 2:] * np.tan(camera.vertical_fov / 2)
    return (view[..., :2] / (half_height * np.array((size[0] / size[1], -1.0))) + 1) / 2 * size
