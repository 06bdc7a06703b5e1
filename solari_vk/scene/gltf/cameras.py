"""Cameras of a glTF file."""

from __future__ import annotations

import math

from solari_vk.scene.gltf.document import Document
from solari_vk.scene.gltf.extras import own_fields
from solari_vk.scene.gltf.nodes import PlacedNode
from solari_vk.scene.gltf.report import Report
from solari_vk.scene.matrices import upright
from solari_vk.scene.model import Camera

OWN = ("aperture", "focus_distance", "ev100", "auto_exposure", "jitter")
"""The fields that glTF has no word for. `Scene.save` writes them as `extras`."""


def make_camera(document: Document, node: PlacedNode, report: Report) -> Camera | None:
    """The camera of a node, or None (reported) if it has no direction or no size."""
    entry = document.item("camera", node.entry.integer("camera"), node.entry)
    kind = entry.text("type", None, ("perspective", "orthographic"))
    lens = entry.entry(kind)
    transform = upright(node.world)
    if lens is None:
        raise entry.error(f"has no '{kind}'; export the file again")
    if transform is None:
        report.add("cameras whose node's transform is singular are left out", node.entry.place)
        return None
    near = max(lens.number("znear", low=0, high=1e15), 1e-9)
    own = own_fields(entry, OWN) | {"name": node.entry.name or entry.name}
    if kind == "perspective":
        fov = lens.number("yfov", low=1e-4, high=math.pi - 1e-4)
        return Camera(transform=transform, vertical_fov=fov, near=near, **own)
    height = 2 * abs(lens.number("ymag", low=-1e15, high=1e15))
    if height == 0:
        report.add("orthographic cameras without a height are left out", node.entry.place)
        return None
    # Depths are ratios to the near plane's, which may be at 0 in this projection.
    return Camera(transform=transform, orthographic_height=height, near=max(near, 1e-6 * height), **own)
