"""Cameras of a glTF file."""

from __future__ import annotations

import math
from typing import Any

from solari_vk.scene.calibrated import LENS_FIELDS
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.extras import read_extras
from solari_vk.scene.files.gltf.nodes import PlacedNode
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.matrices import upright
from solari_vk.scene.model import Camera

ANGLE = "vertical_fov"  # is a word of glTF's, but for cameras that see more, and orthographic ones
CAMERA_EXTRAS = (
    "aperture",
    "aperture_blades",
    "aperture_rotation",
    "focus_distance",
    "ev100",
    "auto_exposure",
    "jitter",
    *LENS_FIELDS,
    ANGLE,
)
"""The fields that glTF has no word for. `Scene.save` writes them as `extras`."""
DEFAULT = "default_camera"  # in the extras of a node
LARGEST_YFOV = math.pi - 1e-4


def make_camera(document: Document, node: PlacedNode, report: Report) -> Camera | None:
    """The camera of a node, or None (reported) if it has no direction or no size."""
    entry = document.item("camera", node.entry.integer("camera"), node.entry)
    transform = upright(node.world)
    if transform is None:
        report.add("cameras whose node's transform is singular are left out", node.entry.place)
        return None
    lens = read_lens(entry)
    if lens is None:
        report.add("orthographic cameras without a height are left out", node.entry.place)
        return None
    # Extras come last: they have the field of view that glTF couldn't say.
    fields = lens | read_extras(entry, CAMERA_EXTRAS)
    return Camera(transform=transform, **fields, name=node.entry.name or entry.name)


def read_lens(entry: Entry) -> dict[str, Any] | None:
    """The fields of Camera that a camera of the file sets; None for an orthographic one without a height."""
    kind = entry.text("type", None, ("perspective", "orthographic"))
    lens = entry.entry(kind)
    if lens is None:
        raise entry.error(f"has no '{kind}'; export the file again")
    # znear of 0 is allowed in orthographic cameras (glTF 2.0, 5.13.4).
    near = max(lens.limited("znear", low=0, limit=1e15), 1e-9)
    if kind == "perspective":
        return {"vertical_fov": lens.number("yfov", low=1e-4, high=LARGEST_YFOV), "near": near}
    height = 2 * abs(lens.limited("ymag", limit=1e15))
    # Depths are ratios to the near plane's, which may be at 0 in this projection.
    return {"orthographic_height": height, "near": max(near, 1e-6 * height)} if height else None
