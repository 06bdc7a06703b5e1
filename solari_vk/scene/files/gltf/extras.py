"""What `Scene.save` writes into the `extras` of objects, since glTF has no word for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Iterable
from typing import Any

from solari_vk.scene import checks
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.saving.content import plain
from solari_vk.scene.files.gltf.values import Entry

KEY = "solari_vk"
PORTAL = "portal"  # of a node that is one
FRONT_EMITS = "front_emits"  # of a double-sided material whose back doesn't


def read_extras(entry: Entry, names: Iterable[str]) -> dict[str, Any]:
    """Those of our fields that the extras of an object have. The classes of the scene check their values."""
    extras = entry.data.get("extras")  # which may be anything in files of others
    found = extras.get(KEY) if isinstance(extras, dict) else None
    return {name: found[name] for name in names if name in found} if isinstance(found, dict) else {}


def read_label(entry: Entry, report: Report, name: str = "label") -> str:
    """The `label` or `part_of` of a node's meshes: ours, or else the text in the extras of files of others."""
    extras = entry.data.get("extras")
    # Blender writes custom properties of objects there, such as a label.
    found = {**(extras if isinstance(extras, dict) else {}), **read_extras(entry, (name,))}.get(name, "")
    with report.costs("wrong labels are left out"):
        try:
            return checks.line(found)
        except (TypeError, ValueError) as error:
            raise entry.error(f"has extras whose {name} {error}") from None
    return ""


def write_extras(item: Any, names: Container[str]) -> dict[str, Any]:
    """The `extras` with those fields of an object that glTF has no word for and that aren't as by default."""
    changed = {}
    for field in dataclasses.fields(item):
        if field.name in names:
            # A factory makes a default anew for each object, such as an array, so that it is compared by its values.
            factory = field.default_factory
            default = field.default if factory is dataclasses.MISSING else factory()
            value = plain(getattr(item, field.name))
            if value != plain(default):
                changed[field.name] = value
    return {KEY: changed} if changed else {}
