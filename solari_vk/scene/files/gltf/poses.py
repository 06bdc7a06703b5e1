"""The pose of a node's mesh: its joints and the weights of its morph targets, and what animates them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.animations import Animations
from solari_vk.scene.files.gltf.nodes import PlacedNode
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.model import Instance


class Pose:
    """The pose of the instances of a node's mesh. skin: the joints, and the matrices from the mesh to them."""

    def __init__(
        self,
        animations: Animations,
        node: PlacedNode,
        mesh: Entry,
        skin: tuple[list[int], NDArray[np.float64]] | None,
        placed: dict[int, PlacedNode],
    ) -> None:
        self._animations = animations
        self._node = node
        self._mesh = mesh
        # glTF 2.0, 3.7.2.2: the weights of a node replace those of its mesh.
        owner = node.entry if "weights" in node.entry else mesh
        count = len(owner.values("weights", "numbers"))
        self._weights = owner.numbers("weights", (0.0,) * count, low=-1e6, high=1e6)
        self._skin: tuple[list[int], NDArray[np.float64], NDArray[np.float64]] | None = None
        if skin is not None:
            joints, joints_from_mesh = skin
            # Where joints are now. The rig replaces those that it moves.
            rest = np.array([placed[joint].world for joint in joints])
            rows = [animations.row(joint) for joint in joints]
            self._skin = [-1 if row is None else row for row in rows], rest, joints_from_mesh

    def give(self, instance: Instance) -> None:
        """Put an instance in the pose, and have it follow the animations."""
        deformation = instance.mesh.deformation
        if deformation is None:
            return
        fields = {}
        if self._skin is not None and deformation.joints is not None:
            fields["joint_matrices"] = self._joint_matrices(deformation.joint_count)
        animated = self._animations.weights_of(self._node, deformation.target_count)
        if deformation.targets is not None and (any(self._weights) or animated):
            fields["morph_weights"] = self._morph_weights(deformation.target_count)
        try:
            instance.update(**fields)
        except SolariError as error:
            raise self._node.entry.error(f"has a pose that can't be shown: {error}") from None
        self._follow(instance, fields, animated)

    def _follow(self, instance: Instance, fields: dict[str, Any], animated: bool) -> None:
        """Have an instance follow the rig's nodes that move. fields: of its pose. animated: whether weights are."""
        rig = self._animations.rig
        row = self._animations.row(self._node.number)
        # Row -1 stands for joints that never move. With these alone there is nothing to follow.
        if self._skin is not None and "joint_matrices" in fields and max(self._skin[0]) >= 0:
            rig.attach_skin(instance, *self._skin)
        if animated and "morph_weights" in fields and row is not None:
            rig.attach_weights(instance, row)

    def _joint_matrices(self, count: int) -> NDArray[np.float64]:
        """The matrices (J, 3, 4) of all joints; `count` of them are needed."""
        assert self._skin is not None
        rows, rest, joints_from_mesh = self._skin
        if count > len(rows):
            raise self._mesh.error(f"refers to joint {count - 1}, but the skin has {len(rows)} joints")
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray((rest @ joints_from_mesh)[:, :3])

    def _morph_weights(self, count: int) -> NDArray[np.float64]:
        """The weights of `count` morph targets, 0 for those that the file says nothing of."""
        self._node.entry.charge(64 * count, "its weights")
        weights = np.zeros(count)
        weights_of_file = self._weights[:count]
        weights[: len(weights_of_file)] = weights_of_file
        return weights
