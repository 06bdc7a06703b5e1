"""A rig: a hierarchy of nodes that animations move, and the objects of the scene that hang on the nodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_constructor
from solari_vk.scene import checks
from solari_vk.scene.animation.keyframes import Sample, unit_quaternions
from solari_vk.scene.camera import Camera
from solari_vk.scene.collection import Items
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.matrices import compose, upright
from solari_vk.scene.objects import Instance, Mesh

Matrix = NDArray[np.float64]
NOT_MOVED = np.eye(4)  # stands for the transform of what only becomes visible or hidden with its node


class Pose(NamedTuple):
    """The translations, rotations and scales of all nodes, which of them these move, which are visible, the weights of
    morph targets by node, and the values of properties by number."""

    parts: dict[str, Matrix]
    moved: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    weights: dict[int, Matrix]
    properties: dict[int, Matrix]


class Animated(Protocol):
    """An object whose properties are animated: `put` each, then `apply` all."""

    def put(self, path: tuple[str, ...], values: Matrix) -> None: ...
    def apply(self) -> None: ...


@checked_constructor
class Rig:
    """Nodes in their rest pose, parents before children.

    parents (N,): each node's parent, -1 for none. transforms (N, 4, 4): from each node's space to its parent's, or for
    nodes without a parent to the world. translations (N, 3), rotations (N, 4: x, y, z, w) and scales (N, 3): what the
    transforms of nodes that animations move are made of. bases: for nodes without a parent the matrix (4, 4) between
    their transform and the world, and whether what hangs there is visible. visible (N,): whether each node is.
    """

    def __init__(
        self,
        parents: Sequence[int],
        transforms: ArrayLike,
        translations: ArrayLike,
        rotations: ArrayLike,
        scales: ArrayLike,
        bases: Sequence[tuple[Matrix, bool]] | None = None,
        visible: Sequence[bool] | None = None,
    ) -> None:
        self.count = count = len(parents)
        self.parents = list(parents)
        self.transforms = np.reshape(np.asarray(transforms, np.float64), (count, 4, 4))
        self.rest = {
            "translation": np.reshape(np.asarray(translations, np.float64), (count, 3)),
            "rotation": np.reshape(np.asarray(rotations, np.float64), (count, 4)),
            "scale": np.reshape(np.asarray(scales, np.float64), (count, 3)),
        }
        self.visible = np.ones(count, bool) if visible is None else np.array(visible, bool)
        if bases is None:
            bases = [(np.eye(4), True)] * count
        self.bases = np.array([matrix for matrix, _ in bases]).reshape(count, 4, 4)
        self.bases_visible = np.array([shown for _, shown in bases], bool)
        self._jumps = _jumps(parents)
        self._roots = np.flatnonzero(np.asarray(parents, np.int64).reshape(-1) < 0)
        self.placed: list[tuple[Any, int, Matrix | None]] = []
        self.skins: list[tuple[Instance, NDArray[np.int64], Matrix, Matrix]] = []
        self.sides: dict[Instance, tuple[int, int]] = {}  # nodes, and the signs of their determinants
        self._inside_out: dict[Mesh, Mesh] = {}
        self.weighted: list[tuple[Instance, int, Matrix]] = []
        self.shown: dict[Any, bool] = {}
        self.properties: list[tuple[Animated, tuple[str, ...], Matrix]] = []

    # ---- what hangs on the nodes --------------------------------------------------------------------

    def attach(
        self,
        item: Instance | Camera | Light,
        node: int,
        transform: Matrix | None = None,
        *,
        moves: bool = True,
        shown: bool = True,
    ) -> None:
        """Have an object follow a node.

        transform: from the object's space to the node's, by default the identity. moves: not only the visibility
        follows. shown: whether it is visible now or, for a light, in the scene.
        """
        self.placed.append((item, node, transform if moves else NOT_MOVED))
        self.shown[item] = item.visible if isinstance(item, Instance) else shown

    def attach_skin(
        self, instance: Instance, joints: Sequence[int], rest: ArrayLike, joints_from_mesh: ArrayLike
    ) -> None:
        """Have nodes be the joints of an instance.

        joints (J,): the nodes, -1 for joints that never move. rest (J, 4, 4): world from joint; only those of joints
        that never move count. joints_from_mesh (J, 4, 4): the inverse bind matrices.
        """
        places, bind = (np.reshape(np.asarray(part, np.float64), (-1, 4, 4)) for part in (rest, joints_from_mesh))
        self.skins.append((instance, np.asarray(joints, np.int64), places, bind))

    def attach_side(self, instance: Instance, node: int, mirrored: bool) -> None:
        """Have a skin's triangles be turned around whenever a node begins or ceases to mirror what is below it, as it
        does now or doesn't."""
        self.sides[instance] = node, -1 if mirrored else 1

    def inside_out(self, mesh: Mesh) -> Mesh:
        """The mesh whose front is where the other one's back is; always the same one, and back again."""
        if mesh not in self._inside_out:
            turned = turned_inside_out(mesh)
            self._inside_out |= {mesh: turned, turned: mesh}
        return self._inside_out[mesh]

    def attach_weights(self, instance: Instance, node: int) -> None:
        """Have a node's weights be those of the instance's morph targets; at rest they are what they are now."""
        assert instance.morph_weights is not None
        self.weighted.append((instance, node, instance.morph_weights))

    def attach_property(self, item: Animated, path: tuple[str, ...], resting: Matrix) -> int:
        """Have channels of the path "property" change an object, and return the number that they name as their node.
        resting (C,): the values where no channel does."""
        self.properties.append((item, path, resting))
        return len(self.properties) - 1

    # ---- poses --------------------------------------------------------------------------------------

    @np.errstate(over="ignore", invalid="ignore")
    def pose(self, lights: Items[Light], poses: Sequence[tuple[float, Sequence[Sample]]]) -> None:
        """Move the nodes to the mean of sampled poses, whose weights add up to 1, and all objects with them.

        Nodes without a sample are in their rest pose. lights: the scene's, which hidden lights leave.
        """
        found = [self._pose_of(samples) for _, samples in poses]
        pose = found[0] if len(found) == 1 else self._mean(np.array([share for share, _ in poses]), found)
        worlds, shown = self._place_nodes(pose)
        for item, node, transform in self.placed:
            world = worlds[node] if transform is None else worlds[node] @ transform
            self._place(lights, item, None if transform is NOT_MOVED else world, bool(shown[node]))
        # glTF 2.0, 3.7.3: a joint's matrix is its place in the world times its inverse bind matrix. The transform of
        # the skinned mesh's own node doesn't count.
        for instance, joints, rest, joints_from_mesh in self.skins:
            places = np.where((joints >= 0)[:, None, None], worlds[joints], rest)
            _assign(instance, "joint_matrices", (places @ joints_from_mesh)[:, :3])
        self._turn_mirrored_skins(worlds)
        for instance, node, resting in self.weighted:
            _assign(instance, "morph_weights", pose.weights.get(node, resting))
        self._apply_properties(pose)

    def _apply_properties(self, pose: Pose) -> None:
        for number, (item, path, resting) in enumerate(self.properties):
            item.put(path, pose.properties.get(number, resting))
        # Only when an object has all values, such as an emission's color and strength, can it make fields of them.
        for item in dict.fromkeys(item for item, *_ in self.properties):
            item.apply()

    def at_rest(self) -> tuple[Matrix, NDArray[np.bool_]]:
        """Matrices (N, 4, 4) from the nodes to the world, and whether they are visible (N,), while none of them is
        animated."""
        return self._place_nodes(self._pose_of(()))

    def _pose_of(self, samples: Iterable[Sample]) -> Pose:
        parts = {name: values.copy() for name, values in self.rest.items()}
        moved = np.zeros(self.count, bool)
        visible = self.visible.copy()
        weights: dict[int, Matrix] = {}
        properties: dict[int, Matrix] = {}
        for nodes, path, values in samples:
            if path in parts:
                parts[path][nodes] = values
                moved[nodes] = True
            elif path == "visible":
                visible[nodes] = values[:, 0] > 0
            else:
                found = weights if path == "weights" else properties
                found.update(zip(nodes.tolist(), values, strict=True))
        return Pose(parts, moved, visible, weights, properties)

    def _mean(self, shares: NDArray[np.float64], poses: Sequence[Pose]) -> Pose:
        """The mean of poses. Quaternions are negated where this brings them closer to those of the first pose."""
        parts = {name: np.stack([pose.parts[name] for pose in poses]) for name in self.rest}
        turns = np.stack([unit_quaternions(values) for values in parts["rotation"]])
        # A quaternion and its negative are the same rotation, but their mean is none.
        turns *= np.where((turns * turns[0]).sum(axis=2, keepdims=True) < 0, -1, 1)
        mean = {name: np.tensordot(shares, values, 1) for name, values in (parts | {"rotation": turns}).items()}
        mean["rotation"] = unit_quaternions(mean["rotation"])
        weights = {}
        for _, node, resting in self.weighted:
            weights[node] = np.asarray(shares @ np.stack([pose.weights.get(node, resting) for pose in poses]))
        properties = {}
        for number, (_, _, resting) in enumerate(self.properties):
            values = [pose.properties.get(number, resting) for pose in poses]
            properties[number] = np.asarray(shares @ np.stack(values))
        moved: NDArray[np.bool_] = np.logical_or.reduce([pose.moved for pose in poses])
        shown = shares @ np.stack([pose.visible for pose in poses])
        return Pose(mean, moved, np.asarray(shown >= 0.5), weights, properties)

    def _place_nodes(self, pose: Pose) -> tuple[Matrix, NDArray[np.bool_]]:
        """Matrices (N, 4, 4) from the nodes to the world, and whether they and all above them are visible (N,)."""
        worlds = self.transforms.copy()
        shown = pose.visible.copy()
        moved = np.flatnonzero(pose.moved)
        worlds[moved] = compose(*(pose.parts[name][moved] for name in ("translation", "rotation", "scale")))
        # What is above the rig never moves.
        worlds[self._roots] = self.bases[self._roots] @ worlds[self._roots]
        shown[self._roots] &= self.bases_visible[self._roots]
        # All nodes of a step at once: their ancestors reach twice as far up after each step.
        for nodes, above in self._jumps:
            worlds[nodes] = worlds[above] @ worlds[nodes]
            shown[nodes] &= shown[above]
        return worlds, shown

    def _turn_mirrored_skins(self, worlds: Matrix) -> None:
        """Turn skins inside out whose nodes mirror them now and didn't before, or the other way around."""
        if not self.sides:
            return
        nodes, before = np.array(list(self.sides.values())).T
        # Only skins need this: others have the mirroring in their own transform.
        now = np.sign(np.linalg.det(worlds[nodes, :3, :3]))
        for instance, changed in zip(list(self.sides), now == -before, strict=True):
            if changed:
                node, side = self.sides[instance]
                instance.mesh = self.inside_out(instance.mesh)
                self.sides[instance] = node, -side

    def _place(self, lights: Items[Light], item: Any, world: Matrix | None, shown: bool) -> None:
        """Move an object. An instance whose transform leaves no area, as a scale of 0, is hidden."""
        if isinstance(item, Instance):
            shown = _move_instance(item, world) and shown
            # An assignment that changes nothing would undo what the user has hidden since.
            if shown != self.shown[item]:
                item.visible = shown
        elif world is None:
            return
        elif isinstance(item, Camera):
            transform = upright(world)
            _assign(item, "transform", item.transform if transform is None else transform)
        else:
            self._place_light(lights, item, world, shown)
        self.shown[item] = shown

    def _place_light(self, lights: Items[Light], light: Light, world: Matrix, shown: bool) -> None:
        """Move a light, which shines along its node's -z, or as before where a scale of 0 leaves no direction. A hidden
        light isn't in the scene."""
        if not np.isfinite(world).all():
            shown = False
        else:
            placed = placed_light(light, world)
            values = {name: value.astype(getattr(light, name).dtype) for name, value in placed.items()}
            # Rounding alone is no change: a moved light would be built anew on the device.
            if any(not np.allclose(getattr(light, name), values[name], rtol=0, atol=1e-7) for name in values):
                light.update(**values)
        has_changed = shown != self.shown[light]
        is_in_scene = light in lights  # the user may have added or removed it
        if has_changed and shown and not is_in_scene:
            lights.add(light)
        elif has_changed and not shown and is_in_scene:
            lights.remove(light)


def turned_inside_out(mesh: Mesh) -> Mesh:
    """A copy whose front is where the mesh's back is."""
    tangents = None if mesh.tangents is None else mesh.tangents * np.array((1, 1, 1, -1), np.float32)
    return dataclasses.replace(mesh, triangles=mesh.triangles[:, ::-1], tangents=tangents)


def placed_light(light: Light, world: Matrix) -> dict[str, Matrix]:
    """The fields of a light that the transform of its node says: it shines along the node's -z. A portal is the square
    from (-1, -1, 0) to (1, 1, 0) of its node, and stays as it was where a scale of 0 leaves no area."""
    if isinstance(light, Portal):
        return {} if Portal.fault(world[:3, 0], world[:3, 1]) else Portal.placed(world)
    fields = {"position": world[:3, 3]} if hasattr(light, "position") else {}
    transform = upright(world)
    if transform is not None:
        axes = {"direction": -transform[:3, 2], "horizontal": transform[:3, 0]}
        fields |= {name: axes[name] for name in light.axes}
    return fields


def _move_instance(instance: Instance, world: Matrix | None) -> bool:
    """Move an instance, unless it isn't moved, and say whether it has a place: a scale of 0 along two axes leaves it
    none."""
    if world is not None:
        try:
            transform = checks.placing_transform(world)
        except ValueError:
            return False
        _assign(instance, "transform", transform)
    return True


def _assign(item: Instance | Camera, field: str, value: Matrix) -> None:
    """Assign to a field whose value differs; others would cost work on the device."""
    if not np.array_equal(getattr(item, field), value):
        setattr(item, field, value)


def _jumps(parents: Sequence[int]) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Nodes and ancestors whose matrices give the nodes' matrices over twice as many levels, until all reach a root:
    a chain of N nodes takes log2(N) steps. Hillis and Steele, "Data Parallel Algorithms" (1986)."""
    above = np.asarray(parents, np.int64).reshape(-1)
    if ((above < -1) | (above >= np.arange(len(above)))).any():
        raise SolariError("a rig lists parents before their children")
    jumps = []
    while (above >= 0).any():
        nodes = np.flatnonzero(above >= 0)
        jumps.append((nodes, above[nodes]))
        above = np.where(above >= 0, above[above], -1)
    return jumps
