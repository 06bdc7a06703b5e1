"""Where prims are, and the groups of a scene that they make."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from solari_vk.base.budget import charge
from solari_vk.scene.camera import Camera
from solari_vk.scene.files.hierarchy import Node, groups_of, tell_apart
from solari_vk.scene.files.usd.motion import Matrix
from solari_vk.scene.model import Instance, Light, Scene


@dataclass(frozen=True)
class Place:
    """Where a prim is: its matrix to the world, its row of the rig (None: nothing moves it), whether it is visible, its
    purpose, the label and the object that it is a part of, and its number in the hierarchy. blinks: the time codes and
    flags of what hides and shows it at and above it; steady: whether nothing else hides it."""

    prim: Any
    world: Matrix
    row: int | None = None
    visible: bool = True
    purpose: str = "default"
    label: str = ""
    part_of: str = ""
    number: int = -1
    blinks: tuple[tuple[list[float], list[bool]], ...] = ()
    steady: bool = True


class Hierarchy:
    """Which objects are at and below which prims, and their paths. Those of a prim with several are a group, as of
    glTF's nodes, and so is the part that a prim refers to."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._prims: list[Any] = []
        self._objects: dict[int, list[Any]] = {}
        self._paths: dict[Any, str] = {}

    def numbered(self, place: Place, parent: int) -> Place:
        """The place with a number, which is larger than its parent's."""
        number = len(self._nodes)
        prim = place.prim
        self._prims.append(prim)
        # What a file refers to often has one name for its only mesh, such as `geo`, wherever it is used.
        is_part = prim.IsInstance() or prim.HasAuthoredReferences() or prim.HasAuthoredPayloads()
        self._nodes.append(Node(number, parent, prim.GetName() or f"node {number}", place.world, is_part))
        return replace(place, number=number)

    def add(self, place: Place, item: Any, who: str) -> None:
        """Have an object be at a place. who: the file, for messages."""
        self._objects.setdefault(place.number, []).append(item)
        path = str(place.prim.GetPath())
        charge(2 * len(path), who, "the paths of its prims")
        self._paths[item] = path

    def finish(self, scene: Scene) -> None:
        """Give a scene its groups, and the paths of what it holds; and tell equal names apart."""
        groups = groups_of(self._nodes, self._objects)
        paths = {group: str(self._prims[number].GetPath()) for number, group in groups.items()}
        for kind in (Instance, Light, Camera):
            tell_apart({item: path for item, path in self._paths.items() if isinstance(item, kind)})
        tell_apart(paths)
        scene._groups.update(dict.fromkeys(groups.values()))
        scene._paths = _single(self._paths) | _single(paths)


def _single(paths: Mapping[Any, str]) -> dict[str, Any]:
    """What is alone at its path: the points of an instancer have one path."""
    counts = Counter(paths.values())
    return {path: item for item, path in paths.items() if counts[path] == 1}
