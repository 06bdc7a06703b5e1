"""Where prims are, and the groups of a scene that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from solari_vk.scene.files.hierarchy import Node, groups_of
from solari_vk.scene.files.usd.motion import Matrix
from solari_vk.scene.group import Group


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
    """Which objects are at and below which prims: those of a prim with several are a group, as glTF's nodes are."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._objects: dict[int, list[Any]] = {}

    def numbered(self, place: Place, parent: int) -> Place:
        """The place with a number, which is larger than its parent's."""
        number = len(self._nodes)
        self._nodes.append(Node(number, parent, place.prim.GetName() or f"node {number}", place.world))
        return replace(place, number=number)

    def add(self, place: Place, item: Any) -> None:
        """Have an object be at a place."""
        self._objects.setdefault(place.number, []).append(item)

    def groups(self) -> list[Group]:
        """All groups, parents first."""
        return groups_of(self._nodes, self._objects)
