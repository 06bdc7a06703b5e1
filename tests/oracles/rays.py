"""References for ray tracing: Embree over a Scene, a ray-triangle test in float64, and the rays of cameras."""

import numpy as np

from solari_vk.lab.embree import embree_scene
from solari_vk.scene.matrices import transform_directions, transform_points


class World:
    """All triangles of a Scene's visible instances in world space, float64, in the instances' order.

    corners (T, 3, 3); instance (T,) numbers instances in the order in which they were added, hidden ones
    included; triangle (T,) numbers triangles within the mesh; front is the side of `normals` (T, 3),
    which is the object-space front even when the instance is mirrored.
    """

    def __init__(self, scene):
        parts = []
        for index, instance in enumerate(scene):
            if instance.visible:
                mesh = instance.ray_mesh or instance.mesh
                corners = transform_points(instance.transform, mesh.positions.astype(np.float64))[mesh.triangles]
                # A mirrored instance turns the order of its corners round, which the normals' sign undoes.
                count, side = len(corners), np.sign(np.linalg.det(instance.transform[:3, :3]))
                parts.append((corners, np.full(count, index), np.arange(count), np.full(count, side)))
        self.corners, self.instance, self.triangle, sides = map(np.concatenate, zip(*parts, strict=True))
        a, b, c = np.moveaxis(self.corners, 1, 0)
        normals = np.cross(b - a, c - a) * sides[:, None]
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self.normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
        self._embree = None

    def embree_hits(self, origins, directions):
        """The index into `corners` that Embree reports for each ray (N,), -1 for a miss."""
        if self._embree is None:
            self._embree = embree_scene(self.corners)
        return self._embree.run(origins.astype(np.float32), directions.astype(np.float32))


def intersect(corners, origins, directions):
    """(distance, u, v) of Moller and Trumbore in float64 for N triangles (N, 3, 3) and N rays; nan where it misses."""
    a, b, c = np.moveaxis(np.asarray(corners, np.float64), 1, 0)
    edge_1, edge_2 = b - a, c - a
    p = np.cross(directions, edge_2)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.einsum("ij,ij->i", edge_1, p)
        s = origins - a
        u = np.einsum("ij,ij->i", s, p) * inverse
        q = np.cross(s, edge_1)
        v = np.einsum("ij,ij->i", directions, q) * inverse
        t = np.einsum("ij,ij->i", edge_2, q) * inverse
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return tuple(np.where(inside, value, np.nan) for value in (t, u, v))


def closest_by_brute_force(corners, origins, directions):
    """The index of the closest triangle for each ray, -1 for none, from testing all pairs in float64."""
    best = np.full(len(origins), np.inf)
    index = np.full(len(origins), -1)
    for i, triangle in enumerate(corners):
        t, _, _ = intersect(np.broadcast_to(triangle, (len(origins), 3, 3)), origins, directions)
        closer = np.nan_to_num(t, nan=np.inf) < best
        best[closer], index[closer] = t[closer], i
    return index, best


# ---- rays of cameras, and where points lie in pictures ----


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
    # A product rule of Gauss and Legendre over the pixel. The weights of an axis have the sum 2, hence the 4 below.
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
