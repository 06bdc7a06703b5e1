"""Groups of a scene from the nodes of a glTF file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.nodes import PlacedNode
from solari_vk.scene.group import KINDS, Group

MOST_LEVELS = 64  # groups call the groups in them: chains of nodes may be longer than Python's limit of recursion


def groups_of(placed: Mapping[int, PlacedNode], objects: Mapping[int, list[Any]]) -> list[Group]:
    """A group for each node with several objects or groups at and below it, parents first.

    placed: the nodes by number, parents first. objects: what hangs on each. Nodes with a single one are left out, as
    exporters write chains of them; so are those above MOST_LEVELS of groups.
    """
    levels = dict.fromkeys(placed, 0)  # of groups below each
    members: dict[int, list[Any]] = {number: [] for number in placed}
    made = []
    for node in reversed(list(placed.values())):  # children come before their parents, the last one first
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


def _group(node: PlacedNode, members: list[Any]) -> Group:
    name = node.entry.name or f"node {node.number}"
    try:
        return Group(members, name=name, transform=node.world)
    except SolariError:  # its scale is 0, as until an animation gives it another
        return Group(members, name=name)
