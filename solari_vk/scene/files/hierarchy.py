"""Groups of a scene from the hierarchy of nodes in a file, and names that tell its objects apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene.group import KINDS, Group

MOST_LEVELS = 64  # groups call the groups in them: chains of nodes may be longer than Python's limit of recursion


@dataclass(frozen=True)
class Node:
    """A node with its name and its matrix, world from node (4, 4). parent: its parent's number, -1 for a root. is_part:
    whether it is a part that the file refers to, which has the name of its use here."""

    number: int
    parent: int
    name: str
    world: NDArray[np.float64]
    is_part: bool = False


def groups_of(nodes: Sequence[Node], objects: Mapping[int, Sequence[Any]]) -> dict[int, Group]:
    """A group for each node with several objects or groups at and below it, by the node's number, parents first.

    nodes: parents first. objects: what hangs on each, by the node's number. Nodes with a single one are left out, as
    exporters write chains of them, but for parts with an object or a group below them; so are those above MOST_LEVELS
    of groups.
    """
    levels = {node.number: 0 for node in nodes}  # of groups below each
    members: dict[int, list[Any]] = {node.number: [] for node in nodes}
    made: dict[int, Group] = {}
    for node in reversed(nodes):  # children come before their parents, the last one first
        own = [item for item in objects.get(node.number, ()) if isinstance(item, KINDS)]
        inside = own + members[node.number][::-1]
        level = levels[node.number]
        is_named = node.is_part and members[node.number]
        if (len(inside) > 1 or is_named) and level < MOST_LEVELS:
            made[node.number] = _group(node, inside)
            inside = [made[node.number]]
            level += 1
        if node.parent in members:
            levels[node.parent] = max(levels[node.parent], level)
            if level < MOST_LEVELS:
                members[node.parent] += inside[::-1]
    return dict(reversed(made.items()))


def _group(node: Node, members: list[Any]) -> Group:
    try:
        return Group(members, name=node.name, transform=node.world)
    except SolariError:  # its scale is 0, as until an animation gives it another
        return Group(members, name=node.name)


def tell_apart(places: Mapping[Any, str]) -> None:
    """Give objects of equal names the names of what is above them too, as in `base/box`: as few as tell them apart.

    places: of each object its path in the file, such as "/world/base/box". Objects of one path keep one name.
    """
    by_name: dict[str, dict[str, list[Any]]] = {}
    for item, path in places.items():
        by_name.setdefault(item.name, {}).setdefault(path, []).append(item)
    for name, by_path in by_name.items():
        for path, above in _ends(list(by_path)).items():
            for item in by_path[path] if above else ():
                item.name = f"{above}/{name}"


def _ends(paths: Sequence[str]) -> dict[str, str]:
    """Of each path what stands before its last part, as little of it as no other path has."""
    found = dict.fromkeys(paths, "")
    equal = list(paths) if len(paths) > 1 else []
    levels = 0
    while equal and levels < MOST_LEVELS:
        levels += 1
        ends = {path: "/".join(path.rsplit("/", levels + 1)[1:-1]) for path in equal}
        counts = Counter(ends.values())
        found |= ends
        equal = [path for path in equal if counts[ends[path]] > 1]
    return found
