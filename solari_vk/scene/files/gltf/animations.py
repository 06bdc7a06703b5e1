"""The animations of a glTF file: its channels, and the rig of all nodes that one of them moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import INTERPOLATIONS, WIDTHS, Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.nodes import NO_QUATERNION, PlacedNode, local_matrix, node_visibility
from solari_vk.scene.files.gltf.pointers import NODE, AnimatedObject, Property
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, shown

_OF_PROPERTIES = ("SCALAR", "VEC2", "VEC3", "VEC4")
_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
_BYTES_PER_CHANNEL = 4096
_WRONG = "wrong channels of animations are left out"
_NOT_PLAYED = "animations of some properties are not played"
_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


class Animations:
    """Reads the channels of nodes that are in the scene, `placed`. `rig` has them and all nodes below them."""

    def __init__(self, document: Document, accessors: Accessors, placed: dict[int, PlacedNode], report: Report) -> None:
        self._document = document
        self._accessors = accessors
        self._placed = placed
        self._report = report
        self._clips: list[tuple[Entry, list[tuple[Any, ...]]]] = []
        for number in range(len(document.array("animation"))):
            with report.costs(_WRONG):
                self._clips.append(self._channels(number))
        targets = {node for _, channels in self._clips for node, *_ in channels}
        self._row: dict[int, int] = {}  # of the rig's nodes
        for number, node in placed.items():  # parents come first
            # What is below a moved node moves with it.
            if number in targets or node.parent in self._row:
                self._row[number] = len(self._row)
        self.rig = self._make_rig()

    def row(self, node: int) -> int | None:
        """The rig's node for a node of the file, None for one that nothing moves."""
        return self._row.get(node)

    def weights_of(self, node: PlacedNode, count: int) -> bool:
        """Whether the weights of a node's morph targets are animated. Channels of another number are left out."""
        found = False
        for entry, channels in self._clips:
            for channel in list(channels):
                target, path, _, values, _ = channel
                if target != node.number or path != "weights":
                    continue
                if values.shape[-1] == count:
                    found = True
                    continue
                channels[:] = [one for one in channels if one is not channel]
                error = entry.error(
                    f"has {values.shape[-1]} weights for {node.entry.place}, whose mesh has {count} morph targets; "
                    "export the file again"
                )
                self._report.lost(_WRONG, error)
        return found

    def _make_rig(self) -> Rig:
        nodes = [self._placed[number] for number in self._row]
        entries = [node.entry for node in nodes]
        bases = []
        for node in nodes:
            parent = self._placed.get(node.parent)
            bases.append((np.eye(4), True) if parent is None else (parent.world, parent.visible))
        return Rig(
            [self._row.get(node.parent, -1) for node in nodes],
            [local_matrix(entry) for entry in entries],
            [entry.numbers("translation", (0.0, 0.0, 0.0)) for entry in entries],
            [entry.numbers("rotation", _NO_ROTATION) for entry in entries],
            [entry.numbers("scale", (1.0, 1.0, 1.0)) for entry in entries],
            bases,
            [node_visibility(entry) for entry in entries],
        )

    def finish(self, find: Callable[[str, int, bool], AnimatedObject | None]) -> list[Animation]:
        """All animations that move or change something in the scene.

        find: an object of the scene by the kind and number of a property, and whether one of them moves uvs.
        """
        properties = [key for _, channels in self._clips for key, *_ in channels if isinstance(key, Property)]
        moving = {key.owner for key in properties if key.moves_uvs}
        objects: dict[tuple[str, int], AnimatedObject | None] = {}
        for owner in dict.fromkeys(key.owner for key in properties):
            with self._report.costs(_WRONG):
                objects[owner] = find(*owner, owner in moving)
        numbers: dict[Any, int] = {}
        animations = []
        for entry, channels in self._clips:
            rows = self._playable(entry, channels, objects, numbers)
            if rows:
                animations.append(Animation(self.rig, rows, name=entry.name))
        for found in objects.values():
            if found is not None:
                found.apply()
        return animations

    def _playable(
        self,
        entry: Entry,
        channels: list[tuple[Any, ...]],
        objects: dict[tuple[str, int], AnimatedObject | None],
        numbers: dict[Any, int],
    ) -> list[Channel]:
        """The channels of an animation that move or change something. numbers: of the rig's properties so far."""
        found = []
        for key, path, times, values, interpolation in channels:
            with self._report.costs(_WRONG):
                if isinstance(key, Property):
                    row = self._property(objects.get(key.owner), key, values.shape[-1], entry, numbers)
                else:
                    row = self._row[key]
                if row is not None:
                    found.append(Channel(row, path, times, values, interpolation))
        return found

    def _property(
        self, found: AnimatedObject | None, wanted: Property, width: int, entry: Entry, numbers: dict[Any, int]
    ) -> int | None:
        """The number of a property in the rig, None for one of an object that isn't in the scene."""
        if found is None:
            return None
        if width != len(wanted.default):
            count = len(wanted.default)
            raise entry.error(f"has {width} numbers a key for '{wanted.path[-1]}', which has {count}; export it again")
        key = found, wanted.path
        if key not in numbers:
            # The value of the file, or the format's default, which the file's entry then states.
            resting = found.value(wanted.path, wanted.default)
            found.put(wanted.path, resting)
            numbers[key] = self.rig.attach_property(found, wanted.path, resting)
        return numbers[key]

    # ---- channels -----------------------------------------------------------------------------------

    def _channels(self, number: int) -> tuple[Entry, list[tuple[Any, ...]]]:
        """An animation, and the node, path, times, values and interpolation of its channels."""
        entry = self._document.item("animation", number, self._document.root)
        samplers = entry.entries("samplers", "sampler")
        found = []
        for channel in entry.entries("channels", "channel"):
            with self._report.costs(_WRONG):
                target = self._target(channel)
                if target is None:
                    continue
                which = channel.integer("sampler")
                if which >= len(samplers):
                    raise channel.error(f"refers to sampler {shown(which)}, but there are only {len(samplers)} of them")
                node, path = target
                channel.charge(_BYTES_PER_CHANNEL, "its channels")
                found.append((node, path, *self._keys(samplers[which], path)))
        return entry, found

    def _target(self, channel: Entry) -> tuple[int | Property, str] | None:
        """The node or property, and the path of a channel; None (reported) for one that isn't supported, or is of no
        node of the scene."""
        target = channel.entry("target")
        if target is None:
            raise channel.error("has no 'target'; export the file again")
        path = target.text("path")
        pointer = target.extension("KHR_animation_pointer")
        node = target.index("node")
        if pointer is not None:
            text = pointer.text("pointer")
            match = NODE.fullmatch(text)
            if match is None:
                try:
                    return Property(text), "property"
                except ValueError:
                    self._report.add(_NOT_PLAYED, f"{channel.place} ({shown(text)[1:-1]})")
                    return None
            node = int(match[1])
            path = "visible" if match[2].endswith("visible") else match[2]
        elif path not in ("translation", "rotation", "scale", "weights"):
            raise target.wrong("path", "translation, rotation, scale or weights")
        if node is None:
            return None
        entry = self._document.item("node", node, target)
        # glTF 2.0, 3.5.3: a node that is animated has no matrix.
        if path in _KINDS and "matrix" in entry:
            raise entry.error("is animated, so it can't have a 'matrix'; export the file again")
        return (node, path) if node in self._placed else None

    def _keys(self, sampler: Entry, path: str) -> tuple[NDArray[Any], NDArray[Any], str]:
        times = self._accessors.floats(sampler.integer("input"), sampler, ("SCALAR",))[:, 0]
        interpolation = sampler.text("interpolation", "LINEAR", INTERPOLATIONS)
        output = sampler.integer("output")
        if path == "visible":
            values = self._accessors.integers(output, sampler, ("SCALAR",))
            interpolation = "STEP"
        else:
            kinds = _OF_PROPERTIES if path == "property" else (_KINDS.get(path, "SCALAR"),)
            values = self._accessors.floats(output, sampler, kinds)
        if not len(times) or times[0] < 0 or (np.diff(times) < 0).any():
            raise sampler.error("needs times from 0 on that ascend; export the file again")
        # A cubic spline has an incoming tangent, a value and an outgoing tangent for each key.
        parts = (len(times), 3) if interpolation == "CUBICSPLINE" else (len(times),)
        width = WIDTHS[path] or max(values.size // int(np.prod(parts)), 1)
        if values.size != width * int(np.prod(parts)):
            per_key = "three values" if len(parts) > 1 else "one value"
            raise sampler.error(
                f"has {len(values)} values for {len(times)} keys of {path}, but {per_key} of {width} numbers a key are "
                "needed; export the file again"
            )
        values = values.reshape(*parts, width)
        # Tangents of splines have any length.
        if path == "rotation" and not (values if values.ndim == 2 else values[:, 1]).any(axis=1).all():
            self._report.add(NO_QUATERNION, sampler.place)
        # Times become floats of Python, values 64 bits.
        sampler.charge(40 * len(times) + 24 * values.size, "its keys")  # of each channel that uses them
        return times, values, interpolation
