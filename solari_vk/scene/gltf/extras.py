"""What `Scene.save` writes into the `extras` of objects, since glTF has no word for it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from solari_vk.scene.gltf.values import Entry

KEY = "solari_vk"


def own_fields(entry: Entry, names: Iterable[str]) -> dict[str, Any]:
    """Those of our fields that the extras of an object have. The classes of the scene check their values."""
    extras = entry.data.get("extras")  # which may be anything in files of others
    found = extras.get(KEY) if isinstance(extras, dict) else None
    return {name: found[name] for name in names if name in found} if isinstance(found, dict) else {}
