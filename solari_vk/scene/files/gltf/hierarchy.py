"""Groups of a scene from the nodes of a glTF file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.nodes import PlacedNode
from solari_vk.scene.group import KINDS, Group


def groups_of(placed: Mapping[int, PlacedNode], objects: Mapping[int, list[Any]]) -> list[Group]:
    """A group for each node with several objects or groups at and below it, parents first.

    placed: the nodes by number, parents first. objects: what hangs on each. Nodes with a single one are left out, as
    exporters write chains of them.
    """
    members: dict[int, list[Any]] = {number: [] for number in placed}
    made = []
    for node in reversed(list(placed.values())):  # children come before their parents, the last one first
        own = [item for item in objects.get(node.number, ()) if isinstance(item, KINDS)]
        inside = own + members[node.number][::-1]
        if len(inside) > 1:
            inside = [_group(node, inside)]
            made += inside
        if node.parent in members:
            members[node.parent] += inside[::-1]
    return made[::-1]


def _group(node: PlacedNode, members: list[Any]) -> Group:
    name = node.entry.name or f"node {node.number}"
    try:
        return Group(members, name=name, transform=node.world)
    except SolariError:  # its scale is 0, as until an animation gives it another
        return Group(members, name=name)
