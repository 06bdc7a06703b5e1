"""How joints and morph targets move the vertices of a mesh; poses on the host, exact, and bounds of poses, fast."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray

Floats = NDArray[np.float64]
Boxes = tuple[Floats, Floats, NDArray[np.int64], Floats | None]
MAX_JOINTS = 1 << 16


@checked_constructor
@dataclass(frozen=True, eq=False)
class Deformation:
    """What moves the vertices of a mesh: joints, morph targets or both.

    joints (N, K): for each vertex the rows of `Instance.joint_matrices` that move it. joint_weights (N, K): how much
    each of them does, from 0 on; only their ratios count, and a vertex whose weights are all 0 stays. targets
    (T, N, 3): what a weight of 1 adds to the positions; target_normals and target_tangents (T, N, 3): to normals and
    tangents. Raises SolariError for arrays that don't fit each other, and negative weights.
    """

    _: KW_ONLY
    joints: NDArray[np.uint32] | None = None
    joint_weights: FloatArray | None = None
    targets: FloatArray | None = None
    target_normals: FloatArray | None = None
    target_tangents: FloatArray | None = None

    def __post_init__(self) -> None:
        self._check_arrays()
        if (self.joints is None) != (self.joint_weights is None):
            raise SolariError("Deformation: give joints and joint_weights together")
        if self.joints is not None and self.joint_weights is not None:
            if self.joints.shape != self.joint_weights.shape or 0 in self.joints.shape:
                shapes = f"{self.joints.shape} and {self.joint_weights.shape}"
                raise SolariError(f"Deformation: joints and joint_weights must have one shape (N, K), not {shapes}")
            self._normalize_weights(self.joints, self.joint_weights)
        if self.joints is None and self.targets is None:
            raise SolariError("Deformation: give joints and joint_weights, targets or both")
        object.__setattr__(self, "_boxes", (None, None))

    def _check_arrays(self) -> None:
        floats = checks.array(None, None, 3, optional=True, max_abs=checks.LARGEST_COORDINATE)
        for name, convert in (
            ("joints", checks.array(None, None, dtype=np.uint32, optional=True)),
            ("joint_weights", checks.array(None, None, optional=True)),
            ("targets", floats),
            ("target_normals", floats),
            ("target_tangents", floats),
        ):
            try:
                object.__setattr__(self, name, convert(getattr(self, name)))
            except (TypeError, ValueError, OverflowError) as error:
                raise SolariError(f"Deformation: {name} {error}") from None
        for name in ("target_normals", "target_tangents"):
            values = getattr(self, name)
            if values is not None and (self.targets is None or values.shape != self.targets.shape):
                raise SolariError(f"Deformation: {name} must have the shape of targets")

    def _normalize_weights(self, joints: NDArray[np.uint32], weights: FloatArray) -> None:
        if (weights < 0).any():
            vertex = int(np.argmax((weights < 0).any(axis=1)))
            raise SolariError(f"Deformation: joint_weights must not be negative, but those of vertex {vertex} are")
        # A joint without a weight may be any number, also one that the pose doesn't have.
        used = joints[weights > 0]
        if len(used) and int(used.max()) >= MAX_JOINTS:
            raise SolariError(f"Deformation: joints must be less than {MAX_JOINTS}, not {used.max()}")
        sums = weights.sum(axis=1, keepdims=True, dtype=np.float64)
        normalized = (weights / np.where(sums > 0, sums, 1)).astype(np.float32)
        normalized.setflags(write=False)
        object.__setattr__(self, "joint_weights", normalized)
        object.__setattr__(self, "_joint_count", int(used.max()) + 1 if len(used) else 0)

    @property
    def joint_count(self) -> int:
        """How many joint matrices a pose needs at least."""
        return getattr(self, "_joint_count", 0)

    @property
    def target_count(self) -> int:
        """The number of morph targets."""
        return 0 if self.targets is None else len(self.targets)

    def check(self, vertex_count: int, joint_matrices: Any, morph_weights: Any, where: str) -> None:
        """Raise SolariError unless it fits a mesh of so many vertices, and this pose fits it. where: the object."""
        for name in ("joints", "targets"):
            values = getattr(self, name)
            if values is not None and values.shape[-2] != vertex_count:
                counts = f"{values.shape[-2]} vertices, but the mesh has {vertex_count}"
                raise SolariError(f"{where}: deformation.{name} is for {counts}")
        if joint_matrices is not None and (self.joints is None or len(joint_matrices) < self.joint_count):
            wanted = "no joints" if self.joints is None else f"{self.joint_count} joints"
            raise SolariError(f"{where}: joint_matrices has {len(joint_matrices)} matrices, but the mesh has {wanted}")
        if morph_weights is not None and len(morph_weights) != self.target_count:
            counts = f"{len(morph_weights)} weights, but the mesh has {self.target_count} morph targets"
            raise SolariError(f"{where}: morph_weights has {counts}")

    # ---- poses --------------------------------------------------------------------------------------

    def pose(
        self,
        positions: FloatArray,
        normals: FloatArray | None,
        tangents: FloatArray | None,
        joint_matrices: Floats | None,
        morph_weights: Floats | None,
    ) -> tuple[Floats, Floats | None, Floats | None]:
        """Positions, unit normals and tangents (N, 3 or 4) in a pose, computed in 64 bits."""
        rest = (positions, normals, tangents)
        moved: list[Any] = [None if part is None else part.astype(np.float64) for part in rest]
        if morph_weights is not None:
            self._morph(moved, morph_weights)
        if joint_matrices is not None:
            self._skin(moved, joint_matrices)
        for part in moved[1:]:
            if part is not None:
                lengths = np.linalg.norm(part[:, :3], axis=1, keepdims=True)
                part[:, :3] /= np.where(lengths > 0, lengths, 1)
        return moved[0], moved[1], moved[2]

    def _morph(self, moved: list[Any], morph_weights: Floats) -> None:
        """Add what the morph targets do to positions, normals and tangents; a tangent's w, its sign, stays."""
        for part, deltas in zip(moved, (self.targets, self.target_normals, self.target_tangents), strict=True):
            if part is not None and deltas is not None:
                part[:, :3] += np.tensordot(morph_weights, deltas.astype(np.float64), 1)

    def _skin(self, moved: list[Any], joint_matrices: Floats) -> None:
        """Move positions, normals and tangents by the joints: linear blend skinning."""
        blended = self._blend(joint_matrices)
        linear = blended[:, :, :3]
        # Normals turn by the matrix of cofactors, the inverse transpose times the determinant, which singular matrices
        # have too. Its rows are the cross products of the other two rows.
        cofactors = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
        moved[0] = np.einsum("nij,nj->ni", linear, moved[0]) + blended[:, :, 3]
        for part, matrices in zip(moved[1:], (cofactors, linear), strict=True):
            if part is not None:
                part[:, :3] = np.einsum("nij,nj->ni", matrices, part[:, :3])

    def _blend(self, joint_matrices: Floats) -> Floats:
        assert self.joints is not None
        assert self.joint_weights is not None
        blended = np.zeros((len(self.joints), 3, 4))
        for joints, weights in zip(self.joints.T, self.joint_weights.T, strict=True):
            used = weights > 0
            blended[used] += weights[used, None, None] * joint_matrices[joints[used]]
        # Vertices without a joint stay where they are.
        blended[~(self.joint_weights > 0).any(axis=1)] = np.eye(3, 4)
        return blended

    # ---- bounds -------------------------------------------------------------------------------------

    def bounds(
        self, positions: FloatArray, joint_matrices: Floats | None, morph_weights: Floats | None
    ) -> tuple[Floats, Floats]:
        """The corners (3,) of a box around a pose, without visiting its vertices: the boxes of what each joint moves.

        A skinned vertex lies between where its joints alone would move it, because the weights add up to 1.
        """
        centers, half_sizes, joints, deltas = self._rest_boxes(positions)
        if morph_weights is not None and deltas is not None:
            # A target moves each vertex within the box of its own displacements.
            centers = centers + morph_weights @ deltas.mean(axis=1)
            half_sizes = half_sizes + np.abs(morph_weights) @ (deltas[:, 1] - deltas[:, 0]) / 2
        if joint_matrices is not None:
            matrices = joint_matrices[joints[:-1]]
            if joints[-1] < 0:  # no vertex is without a joint
                centers, half_sizes = centers[:-1], half_sizes[:-1]
            else:
                matrices = np.concatenate([matrices, np.eye(3, 4)[None]])
            centers = np.einsum("nij,nj->ni", matrices[:, :, :3], centers) + matrices[:, :, 3]
            # A box turned by a matrix fits into one with the sums of its sides' absolute parts: Arvo, "Transforming
            # Axis-Aligned Bounding Boxes" (Graphics Gems, 1990).
            half_sizes = np.einsum("nij,nj->ni", np.abs(matrices[:, :, :3]), half_sizes)
        low, high = (centers - half_sizes).min(axis=0), (centers + half_sizes).max(axis=0)
        # Devices pose in 32 bits: their positions may lie outside by the rounding.
        rounding = 1e-6 * max(float(np.abs(low).max()), float(np.abs(high).max()))
        return low - rounding, high + rounding

    def is_within(
        self, limit: float, positions: FloatArray, joint_matrices: Floats | None, morph_weights: Floats | None
    ) -> bool:
        """Whether no coordinate of `bounds` is above a limit. One box around all vertices answers for most joints."""
        if morph_weights is None and joint_matrices is not None:
            centers, half_sizes, _, _ = self._rest_boxes(positions)
            reach = np.append((np.abs(centers) + half_sizes).max(axis=0), 1.0)
            if (np.abs(joint_matrices) @ reach).max() <= limit:
                return True
        return bool(np.abs(self.bounds(positions, joint_matrices, morph_weights)).max() <= limit)

    def _rest_boxes(self, positions: FloatArray) -> Boxes:
        """As `_make_boxes`, from the second call on for the same positions at once."""
        known, boxes = self._boxes  # type: ignore[attr-defined]
        if known is not positions:
            boxes = self._make_boxes(positions)
            object.__setattr__(self, "_boxes", (positions, boxes))
        found: Boxes = boxes
        return found

    def _make_boxes(self, positions: FloatArray) -> Boxes:
        """Centers and half sizes (B, 3) of the boxes of the vertices that each joint moves; the joints (B,); and the
        corners (T, 2, 3) of what the targets add. The last box is of the vertices without a joint; its joint is -1
        if there are none."""
        points = positions.astype(np.float64)
        if self.joints is None or self.joint_weights is None:
            groups = [points]
            joints = np.zeros(1, np.int64)
        else:
            vertices, columns = np.nonzero(self.joint_weights > 0)
            used = self.joints[vertices, columns]
            # The vertices of each joint next to each other, to take minimum and maximum of each group.
            order = np.argsort(used, kind="stable")
            moved, starts = np.unique(used[order], return_index=True)
            groups = np.split(points[vertices[order]], starts[1:]) if len(moved) else []
            free = points[~(self.joint_weights > 0).any(axis=1)]
            joints = np.append(moved.astype(np.int64), 0 if len(free) else -1)
            groups.append(free if len(free) else points[:1])
        low, high = np.array([g.min(axis=0) for g in groups]), np.array([g.max(axis=0) for g in groups])
        deltas = None
        if self.targets is not None:
            deltas = np.stack([self.targets.min(axis=1), self.targets.max(axis=1)], axis=1).astype(np.float64)
        return (low + high) / 2, (high - low) / 2, joints, deltas


def check_pose(instance: Any) -> None:
    """Raise SolariError unless an Instance's pose fits its meshes, and leaves them within LARGEST_COORDINATE."""
    if instance.mesh.deformation is None:
        mesh = instance.mesh.describe()
        raise SolariError(f"{instance.describe()}: a pose needs a mesh with a deformation, but {mesh} has none")
    pose = instance.joint_matrices, instance.morph_weights
    for mesh in (instance.mesh, instance.ray_mesh):
        if mesh is not None and mesh.deformation is not None:
            mesh.deformation.check(len(mesh.positions), *pose, instance.describe())
            limit = checks.LARGEST_COORDINATE
            if not mesh.deformation.is_within(limit, mesh.positions, *pose):
                raise SolariError(f"{instance.describe()}: its pose has coordinates above {limit:g} meters")
