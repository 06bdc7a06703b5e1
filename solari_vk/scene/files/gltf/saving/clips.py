"""Rigs and clips of a scene as nodes and animations."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene import checks
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel, unit_quaternions
from solari_vk.scene.animation.rig import NOT_MOVED, Rig, placed_light
from solari_vk.scene.camera import Camera
from solari_vk.scene.files.gltf.cameras import DEFAULT
from solari_vk.scene.files.gltf.extras import KEY as EXTRAS
from solari_vk.scene.files.gltf.pointers import AnimatedObject, has_texture, put
from solari_vk.scene.files.gltf.saving.content import Content
from solari_vk.scene.files.gltf.saving.nodes import VISIBILITY, Matrix, Nodes, node_extras
from solari_vk.scene.files.gltf.saving.shapes import Variants
from solari_vk.scene.matrices import upright
from solari_vk.scene.objects import Instance

POINTER = "KHR_animation_pointer"
_PARTS = ("translation", "rotation", "scale")
_ROUNDING = 1e-5  # of coordinates, relative to the largest
_AT_REST = "clips play from the pose in which the file was loaded, in which these are written"


class _Attachment(NamedTuple):
    """How an object follows a rig."""

    node: int | None
    """The rig's node, None for what only has joints or weights."""
    local: Any
    """The matrix from the object to the node; None is the identity, NOT_MOVED what only becomes visible with it."""
    skin: Any
    """The joints, world from joint of those that never move, and the inverse bind matrices."""
    weights: Any
    """The node whose weights its morph targets have, and these at rest."""


class RigNodes:
    """Writes the nodes of a rig, and the objects of a scene that hang on them."""

    def __init__(
        self,
        content: Content,
        nodes: Nodes,
        rig: Rig,
        clips: list[Animation],
        scene: Any,
        variants: dict[Instance, Variants],
        done: set[Any],
    ) -> None:
        """done: the objects that are written, to which it adds its own."""
        self._content = content
        self._nodes = nodes
        self._rig = rig
        self._scene = scene
        self._variants = variants
        self._done = done
        self._meshes_of: dict[int, list[int]] = {}  # by the rig's node: the nodes whose morph targets it weighs
        moved = {channel.node for clip in clips for channel in clip.channels if channel.path in _PARTS}
        self._bases: dict[Any, int] = {}
        self._rows: list[int] = []
        for row in range(rig.count):
            # Parents come first, so that each has its node.
            self._rows.append(self._add(row, row in moved))
        self._worlds, self._shown = rig.at_rest()
        skins = {instance: skin for instance, *skin in rig.skins}
        weights = {instance: (node, resting) for instance, node, resting in rig.weighted}
        placed = {item: (node, local) for item, node, local in rig.placed}
        for item in dict.fromkeys((*placed, *skins, *weights)):
            node, local = placed.get(item, (None, None))
            self._write(item, _Attachment(node, local, skins.get(item), weights.get(item)))

    def _add(self, row: int, moved: bool) -> int:
        rig = self._rig
        above = rig.parents[row]
        parent = self._rows[above] if above >= 0 else self._base(row)
        visible = bool(rig.visible[row])
        if not moved:
            return self._nodes.place(parent, rig.transforms[row], visible=visible)
        parts = {name: rig.rest[name][row].tolist() for name in _PARTS}
        # glTF demands unit quaternions.
        parts["rotation"] = unit_quaternions(rig.rest["rotation"][row : row + 1])[0].tolist()
        return self._nodes.add(parent, visible=visible, **parts)

    def _base(self, row: int) -> int | None:
        """The node for what is above the rig and isn't moved."""
        matrix = self._rig.bases[row]
        visible = bool(self._rig.bases_visible[row])
        if visible and np.array_equal(matrix, np.eye(4)):
            return None
        key = matrix.tobytes(), visible
        if key not in self._bases:
            self._bases[key] = self._nodes.place(None, matrix, visible=visible)
        return self._bases[key]

    def _write(self, item: Any, attachment: _Attachment) -> None:
        """Write an object below the node that it follows, unless it isn't in the scene or is written already."""
        if not self._is_in_scene(item):
            return
        if item in self._done:
            self._content.lose("what follows the clips of two rigs follows the first alone", item.describe())
            return
        self._done.add(item)
        self._check_rest(item, attachment)
        parent = None if attachment.node is None else self._rows[attachment.node]
        local = attachment.local
        matrix = np.eye(4) if local is None or local is NOT_MOVED else local
        if isinstance(item, Instance):
            self._write_instance(item, attachment, parent, matrix)
        elif isinstance(item, Camera):
            cameras = self._scene.cameras
            is_default = len(cameras) > 1 and item is (self._scene._camera or cameras[0])
            self._nodes.camera(parent, item, matrix, extras={EXTRAS: {DEFAULT: True}} if is_default else None)
        else:
            self._nodes.light(parent, item, matrix)

    def _is_in_scene(self, item: Any) -> bool:
        """Whether an object is in the scene; a light isn't while its node is hidden, but belongs to it."""
        if isinstance(item, Instance):
            return item in self._scene.instances
        if isinstance(item, Camera):
            return item in self._scene.cameras
        return item in self._scene.lights or not self._rig.shown[item]

    def _is_visible(self, instance: Instance, attachment: _Attachment) -> bool:
        """Whether an instance's own node is visible: not if the user has hidden what the rig shows."""
        return instance.visible or (attachment.node is not None and not self._rig.shown[instance])

    def _check_rest(self, item: Any, attachment: _Attachment) -> None:
        """Warn of an object that isn't where its node rests, where a reader will find it."""
        node = attachment.node
        if node is None:
            return
        local = np.eye(4) if attachment.local is None else attachment.local
        world = None if attachment.local is NOT_MOVED else self._worlds[node] @ local
        visible = not isinstance(item, Instance) or self._is_visible(item, attachment)
        if not self._is_at_rest(item, world, bool(self._shown[node]), visible):
            self._content.lose(_AT_REST, item.describe())

    def _write_instance(self, instance: Instance, attachment: _Attachment, parent: int | None, matrix: Matrix) -> None:
        if attachment.node is None or attachment.local is NOT_MOVED:
            matrix = instance.transform
        # The mesh of a mirrored skin is inside out, as `Rig.inside_out` says; the file has the original.
        is_turned = self._rig.sides.get(instance, (0, 1))[1] < 0
        weights = attachment.weights
        written = self._nodes.instance(
            parent,
            instance,
            matrix,
            variants=self._variants.get(instance, ()),
            skin=None if attachment.skin is None else self._skin(instance, attachment.skin),
            mesh=self._rig.inside_out(instance.mesh) if is_turned else None,
            weights=None if weights is None else weights[1],
            visible=self._is_visible(instance, attachment),
            extras=node_extras(self._scene, instance),
        )
        if weights is not None:
            self._meshes_of.setdefault(weights[0], []).append(written)

    def _is_at_rest(self, item: Any, world: Matrix | None, shown: bool, visible: bool) -> bool:
        """Whether an object is where its node rests and, unless the user has hidden it, visible as there.

        world: from the object at rest to the world, None for what isn't moved."""
        if isinstance(item, Instance):
            return _is_instance_at_rest(item, world, shown, visible)
        upright_world = None if world is None else upright(world)
        if isinstance(item, Camera):
            return upright_world is None or _are_near(item.transform, upright_world)
        expected = {} if world is None else placed_light(item, world)
        near = (_are_near(getattr(item, name), value) for name, value in expected.items())
        return all(near) and (item in self._scene.lights) == shown

    def _skin(self, item: Instance, skin: Any) -> int:
        joints, rest, joints_from_mesh = skin
        # The rig places skinned meshes by their joints alone; a transform that the user assigned has no node.
        if not np.array_equal(item.transform, np.eye(4)):
            self._content.lose("skins that follow clips lose the transform of their own", item.describe())
        resting = np.where((joints >= 0)[:, None, None], self._worlds[joints], rest) @ joints_from_mesh
        if item.joint_matrices is not None and not _are_near(item.joint_matrices[:, :3], resting[:, :3]):
            self._content.lose(_AT_REST, item.describe())
        nodes = [
            self._rows[joint] if joint >= 0 else self._base_of(matrix)
            for joint, matrix in zip(joints, rest, strict=True)
        ]
        return self._nodes.skin(item, nodes, joints_from_mesh)

    def _base_of(self, matrix: NDArray[Any]) -> int:
        key = matrix.tobytes(), None
        if key not in self._bases:
            self._bases[key] = self._nodes.place(None, matrix)
        return self._bases[key]

    # ---- clips --------------------------------------------------------------------------------------

    def animation(self, clip: Animation) -> None:
        """Write a clip. Of channels for the same property the last counts."""
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        # glTF 2.0, 3.11: no two channels of an animation have one target.
        for channel in {(channel.node, channel.path): channel for channel in clip.channels}.values():
            targets = self._targets(channel)
            if targets:
                channels += [{"sampler": len(samplers), "target": target} for target in targets]
                samplers.append(self._sampler(channel))
        if channels:
            self._content.add("animations", name=clip.name, channels=channels, samplers=samplers)
        else:
            self._content.lose("clips that move nothing of the scene aren't written", clip.describe())

    def state_properties(self) -> None:
        """Have materials, cameras and lights state what clips change, such as an emission's color and strength, as
        their file did; the rest of them stays as it is now. All are written before."""
        changed: dict[AnimatedObject, dict[Any, Any]] = {}
        for item, path, resting in self._rig.properties:
            if not isinstance(item, AnimatedObject):
                self._content.lose("animations of other properties than those of files aren't written", path[-1])
                continue
            changed.setdefault(item, {})[path] = resting
        for item, values in changed.items():
            if not item.is_at_rest(values):
                self._content.lose(_AT_REST, item.items[0].describe())
            for _, data in self._written(item.items):
                for path, value in item.stated(values).items():
                    self._put(data, path, value)

    def _written(self, items: Iterable[Any]) -> list[tuple[str, dict[str, Any]]]:
        """The pointers to objects, and what is written of them; without those that aren't written."""
        written = self._content.written
        return [written[item] for item in items if item in written]

    def _put(self, data: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
        if not has_texture(data, path):
            return
        # Each extension that the path leads through is named among those that the file uses.
        for place in [place for place, key in enumerate(path) if key == "extensions"]:
            owner = data
            for key in path[:place]:
                owner = owner[key]
            self._content.use(path[place + 1], owner=owner)
        put(data, path, value)

    def _properties(self, channel: Channel) -> list[dict[str, Any]]:
        item, path, _ = self._rig.properties[channel.node]
        found = []
        items = item.items if isinstance(item, AnimatedObject) else ()
        for pointer, data in self._written(items):
            if has_texture(data, path):
                found.append({"path": "pointer"})
                self._content.use(POINTER, {"pointer": "/".join((pointer, *path))}, found[-1])
        return found

    def _targets(self, channel: Channel) -> list[dict[str, Any]]:
        if channel.path == "property":
            return self._properties(channel)
        if channel.path == "weights":
            return [{"node": node, "path": "weights"} for node in self._meshes_of.get(channel.node, ())]
        node = self._rows[channel.node]
        if channel.path != "visible":
            return [{"node": node, "path": channel.path}]
        self._content.use(VISIBILITY, {"visible": True}, self._content.json["nodes"][node])
        target: dict[str, Any] = {"path": "pointer"}
        self._content.use(POINTER, {"pointer": f"/nodes/{node}/extensions/{VISIBILITY}/visible"}, target)
        return [target]

    def _sampler(self, channel: Channel) -> dict[str, Any]:
        times = np.array(channel.times, np.float32)
        # glTF 2.0, 3.11: times ascend strictly. Equal ones, such as of a jump, become the next number of 32 bits.
        for key in range(1, len(times)):
            times[key] = max(times[key], np.nextafter(times[key - 1], np.float32(np.inf)))
        values: Any = channel.values
        interpolation = channel.interpolation
        dtype = "f4"
        if channel.path == "visible":
            states = values[:, 1] if interpolation == "CUBICSPLINE" else values
            values = (states > 0).reshape(-1)
            interpolation = "STEP"
            dtype = "u1"
        elif channel.path == "weights":
            values = values.reshape(-1)
        else:
            values = values.reshape(-1, values.shape[-1])
        # Tangents of a spline have any length, keys alone have length 1.
        if channel.path == "rotation" and interpolation != "CUBICSPLINE":
            values = unit_quaternions(values)
        output = self._content.accessor(values, dtype)
        sampler = {"input": self._content.accessor(times, use="times"), "output": output}
        return sampler | ({} if interpolation == "LINEAR" else {"interpolation": interpolation})


def _is_instance_at_rest(instance: Instance, world: Matrix | None, shown: bool, visible: bool) -> bool:
    try:
        is_placed = world is None or _are_near(instance.transform, checks.placing_transform(world))
    except ValueError:  # hidden until a clip gives it a size
        return not instance.visible
    return is_placed and (instance.visible == shown or not visible)


def _are_near(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return bool(np.allclose(a, b, rtol=0, atol=_ROUNDING * max(1.0, float(np.abs(b).max()))))
