"""Clusters of neighboring triangles of an emissive mesh: each is a leaf of the tree of lights.

They are runs of the triangles' spatial order, in which surfaces stay together. Where most clusters would hold triangles
far from each other, such as light panels of two triangles each, clusters are smaller: in the end each triangle is one.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.spatial_order import halved, runs
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Instance, Mesh

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
# Most triangles of a cluster. Larger clusters are chosen less well, smaller ones take more time and memory.
LARGEST = 128
# A mesh has at most as many clusters. They are halved as long as there are at most a quarter as many.
MAX_CLUSTERS = 1 << 16
# A cluster is sparse whose box has a surface of so many times the area of its triangles. Most boxes around pieces of
# spheres have less.
SPARSE = 8.0


class _JointBoxes(NamedTuple):
    """The boxes of what each joint moves of each cluster, one cluster's after the other's."""

    boxes: Floats  # (P, 2, 3)
    starts: Indices  # (C,): where each cluster's boxes begin
    joints: Indices  # (P,): the joint that moves each box; the number of joints for none
    clusters: Indices  # (P,): the cluster of each box


class Clusters:
    """The clusters of a mesh: where they start (C,), their sizes (C,), and how often the triangles are halved to make
    them, NO_INDEX where each triangle is a cluster.

    triangles (M, 3): the mesh's, in spatial order. areas, weights (M,): how large they are and how much light they send
    out, up to a factor.
    """

    def __init__(self, mesh: Mesh, triangles: NDArray[np.uint32], areas: Floats, weights: Floats) -> None:
        self.starts, self.sizes, self.halvings = _arrange(mesh.positions, triangles, areas)
        shares = np.add.reduceat(weights, self.starts)
        self.shares: Floats = shares / shares.sum() if shares.sum() > 0 else self.sizes / len(triangles)
        """How much of the light each cluster sends out (C,)."""
        self._mesh = mesh
        self._triangles = triangles
        low, high = _extremes(mesh.positions, triangles, self.starts)
        self._rest = np.stack([low, high], axis=1).astype(np.float64)

    def boxes(
        self, transform: NDArray[np.float64], joint_matrices: Floats | None, morph_weights: Floats | None
    ) -> Floats:
        """The boxes (C, 2, 3) around the clusters in the pose of an instance with a transform (4, 4), in the world."""
        boxes = self._rest
        if joint_matrices is not None or morph_weights is not None:
            boxes = self._posed(joint_matrices, morph_weights)
        centers = transform_points(transform, boxes.mean(axis=1))
        half_sizes = (boxes[:, 1] - boxes[:, 0]) / 2 @ np.abs(transform[:3, :3]).T
        return np.stack([centers - half_sizes, centers + half_sizes], axis=1)

    def _posed(self, joint_matrices: Floats | None, morph_weights: Floats | None) -> Floats:
        """As `Deformation.bounds`: a skinned vertex lies between where its joints alone would move it."""
        assert self._mesh.deformation is not None
        parts = self._joint_boxes
        boxes = parts.boxes
        # What a target adds lies between a min and a max, which a negative weight swaps.
        if morph_weights is not None:
            added = morph_weights[:, None, None, None] * self._deltas
            boxes = boxes + np.sort(added, axis=2).sum(axis=0)[parts.clusters]
        if joint_matrices is not None:
            of_joints = joint_matrices[: self._mesh.deformation.joint_count]
            matrices = np.concatenate([of_joints, np.eye(3, 4)[None]])[parts.joints]
            centers = np.einsum("nij,nj->ni", matrices[:, :, :3], boxes.mean(axis=1)) + matrices[:, :, 3]
            half_sizes = np.einsum("nij,nj->ni", np.abs(matrices[:, :, :3]), (boxes[:, 1] - boxes[:, 0]) / 2)
            boxes = np.stack([centers - half_sizes, centers + half_sizes], axis=1)
        low = np.minimum.reduceat(boxes[:, 0], parts.starts)
        high = np.maximum.reduceat(boxes[:, 1], parts.starts)
        return np.stack([low, high], axis=1)

    @cached_property
    def _joint_boxes(self) -> _JointBoxes:
        count = len(self.starts)
        deformation = self._mesh.deformation
        if deformation is None or deformation.joints is None or deformation.joint_weights is None:
            every = np.arange(count)
            return _JointBoxes(self._rest, every, np.zeros(count, np.int64), every)
        vertex_count = len(self._mesh.positions)
        joint_count = deformation.joint_count
        # The vertices of each cluster, each once.
        clusters = np.repeat(np.arange(count), 3 * self.sizes)
        clusters, vertices = np.divmod(np.unique(clusters * vertex_count + self._triangles.reshape(-1)), vertex_count)
        # A row for each joint that moves a vertex, and one for a vertex that none moves.
        weights = deformation.joint_weights[vertices]
        moves: NDArray[np.bool_] = weights > 0
        joints = np.where(moves, deformation.joints[vertices], joint_count).astype(np.int64)
        rows, columns = np.nonzero(moves | ~moves.any(axis=1, keepdims=True))
        # Sorted by cluster and joint, they become one box for each pair.
        keys = clusters[rows] * (joint_count + 1) + joints[rows, columns]
        order = np.argsort(keys, kind="stable")
        found, starts = np.unique(keys[order], return_index=True)
        points = self._mesh.positions[vertices[rows[order]]].astype(np.float64)
        low = np.minimum.reduceat(points, starts)
        high = np.maximum.reduceat(points, starts)
        clusters, moved_by = np.divmod(found, joint_count + 1)
        boxes = np.stack([low, high], axis=1)
        return _JointBoxes(boxes, np.searchsorted(clusters, np.arange(count)), moved_by, clusters)

    @cached_property
    def _deltas(self) -> Floats:
        """The boxes (T, C, 2, 3) of what the morph targets add to the positions of each cluster."""
        assert self._mesh.deformation is not None
        assert self._mesh.deformation.targets is not None
        found = [_extremes(target, self._triangles, self.starts) for target in self._mesh.deformation.targets]
        return np.stack(found).swapaxes(1, 2).astype(np.float64)


class ClusterBoxes:
    """The boxes around the clusters of a scene's instances."""

    def __init__(self) -> None:
        self.of: dict[Instance, Clusters] = {}
        self.moved: dict[Instance, None] = {}
        """Whose boxes `pop_moved` has not returned yet."""
        self._boxes: dict[Instance, Floats] = {}

    def set(self, instance: Instance, clusters: Clusters | None) -> tuple[bool, bool]:
        """Set the clusters of an instance as it is; returns whether they are new ones, and whether they have moved."""
        is_changed = self.of.get(instance) is not clusters
        if is_changed:
            for of_instances in (self.of, self._boxes, self.moved):
                of_instances.pop(instance, None)
        if clusters is None:
            return is_changed, False
        boxes = clusters.boxes(instance.transform, instance.joint_matrices, instance.morph_weights)
        have_moved = not np.array_equal(boxes, self._boxes.get(instance, ()))
        if have_moved:
            self.of[instance] = clusters
            self._boxes[instance] = boxes
            self.moved[instance] = None
        return is_changed, have_moved

    def pop_moved(self) -> list[tuple[Instance, Floats]]:
        """The instances whose boxes have changed since the latest call, and these (C, 2, 3)."""
        moved = self.moved
        self.moved = {}
        return [(instance, self._boxes[instance]) for instance in moved]


def _arrange(
    positions: NDArray[np.float32], triangles: NDArray[np.uint32], areas: Floats
) -> tuple[Indices, Indices, int]:
    """The starts, sizes and halvings of `Clusters`."""
    count = len(triangles)
    starts, sizes, halvings = runs(count, LARGEST)
    while count >= 4 and len(starts) <= MAX_CLUSTERS // 4 and _are_sparse(positions, triangles, areas, starts):
        if sizes.min() < 4:  # halves would have a single triangle
            return np.arange(count), np.ones(count, np.int64), NO_INDEX
        starts, sizes = halved(starts, sizes)
        halvings += 1
    return starts, sizes, halvings


def _are_sparse(positions: NDArray[np.float32], triangles: NDArray[np.uint32], areas: Floats, starts: Indices) -> bool:
    """Whether clusters of half of the area are."""
    low, high = _extremes(positions, triangles, starts)
    x, y, z = (high - low).T.astype(np.float64)
    of_clusters = np.add.reduceat(areas, starts)
    sparse = 2 * (x * y + y * z + z * x) > SPARSE * of_clusters
    return bool(2 * of_clusters[sparse].sum() > of_clusters.sum())


def _extremes(
    points: NDArray[np.float32], triangles: NDArray[np.uint32], starts: Indices
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The min and the max (R, 3) of the corners of each run of triangles; points (N, 3)."""
    a, b, c = (points[corner] for corner in triangles.T)
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
