"""References for ray tracing: Embree over a Scene, and a ray-triangle test in float64."""

import numpy as np

from solari_vk.lab.embree import embree_scene
from solari_vk.scene.matrices import transform_points


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
