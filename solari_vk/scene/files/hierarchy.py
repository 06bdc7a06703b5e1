"""Groups of a scene from the hierarchy of nodes in a file."""

from __future__ import annotations

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
    """A node with its name and its matrix, world from node (4, 4). parent: its parent's number, -1 for a root."""

    number: int
    parent: int
    name: str
    world: NDArray[np.float64]


def groups_of(nodes: Sequence[Node], objects: Mapping[int, Sequence[Any]]) -> list[Group]:
    """A group for each node with several objects or groups at and below it, parents first.

    nodes: parents first. objects: what hangs on each, by the node's number. Nodes with a single one are left out, as
    exporters write chains of them; so are those above MOST_LEVELS of groups.
    """
    levels = {node.number: 0 for node in nodes}  # of groups below each
    members: dict[int, list[Any]] = {node.number: [] for node in nodes}
    made = []
    for node in reversed(nodes):  # children come before their parents, the last one first
        own = [item for item in objects.get(node.number, ()) if isinstance(item, KINDS)]
        inside = own + members[node.number][::-1]
        level = levels[node.number]
        if len(inside) > 1 and level < MOST_LEVELS:
            inside = [_group(node, inside)]
            made += inside
            level += 1
        if node.parent in members:
            levels[node.parent] = max(levels[node.parent], level)
            if level < MOST_LEVELS:
                members[node.parent] += inside[::-1]
    return made[::-1]


def _group(node: Node, members: list[Any]) -> Group:
    try:
        return Group(members, name=node.name, transform=node.world)
    except SolariError:  # its scale is 0, as until an animation gives it another
        return Group(members, name=node.name)
