"""KHR_animation_pointer: the properties of materials, cameras and lights that animations change.

An animated object has a copy of its entry in the file. Keys change the copy, and the object takes what the reader of
such entries makes of it, so that whatever is read can be animated.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.gltf.extensions import LARGEST_DISTANCE
from solari_vk.scene.gltf.values import Entry
from solari_vk.scene.observed import Checked

NODE = re.compile(r"/nodes/(\d{1,9})/(translation|rotation|scale|weights|extensions/KHR_node_visibility/visible)")
_OBJECT = re.compile(r"/(?:extensions/KHR_lights_punctual/)?(materials|cameras|lights)/(\d{1,9})/(.+)")
_UNIT, _ZERO, _WHITE, _BLACK = (1.0,), (0.0,), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_TRANSFORM = re.compile(r"(?:.+/)?\w+Texture/extensions/KHR_texture_transform/(offset|rotation|scale)")
_OF_TRANSFORMS = {"offset": (0.0, 0.0), "rotation": _ZERO, "scale": (1.0, 1.0)}
_OF_EXTENSIONS: dict[str, dict[str, tuple[float, ...]]] = {
    "anisotropy": {"anisotropyStrength": _ZERO, "anisotropyRotation": _ZERO},
    "clearcoat": {"clearcoatFactor": _ZERO, "clearcoatRoughnessFactor": _ZERO, "clearcoatNormalTexture/scale": _UNIT},
    "diffuse_transmission": {"diffuseTransmissionFactor": _ZERO, "diffuseTransmissionColorFactor": _WHITE},
    "emissive_strength": {"emissiveStrength": _UNIT},
    "ior": {"ior": (1.5,)},
    "sheen": {"sheenColorFactor": _BLACK, "sheenRoughnessFactor": _ZERO},
    "specular": {"specularFactor": _UNIT, "specularColorFactor": _WHITE},
    "transmission": {"transmissionFactor": _ZERO},
    "volume": {"thicknessFactor": _ZERO, "attenuationColor": _WHITE, "attenuationDistance": (LARGEST_DISTANCE,)},
}
DEFAULTS: dict[str, dict[str, tuple[float, ...]]] = {
    "materials": {
        "pbrMetallicRoughness/baseColorFactor": (1.0, 1.0, 1.0, 1.0), "pbrMetallicRoughness/metallicFactor": _UNIT,
        "pbrMetallicRoughness/roughnessFactor": _UNIT, "emissiveFactor": _BLACK, "alphaCutoff": (0.5,),
        "normalTexture/scale": _UNIT,
    } | {f"extensions/KHR_materials_{extension}/{key}": values
         for extension, keys in _OF_EXTENSIONS.items() for key, values in keys.items()},
    "cameras": {
        "perspective/yfov": (math.pi / 4,), "perspective/znear": (0.01,),
        "orthographic/ymag": _UNIT, "orthographic/znear": _ZERO,
    },
    "lights": {
        "color": _WHITE, "intensity": _UNIT, "range": (1e18,), "spot/innerConeAngle": _ZERO,
        "spot/outerConeAngle": (math.pi / 4,),
    },
}  # fmt: skip
"""The properties that can be animated, with their values where a file has none."""


class Property:
    """A property of an object of the file: its kind, number and path. Raises ValueError for one that isn't played."""

    def __init__(self, pointer: str) -> None:
        match = _OBJECT.fullmatch(pointer)
        if match is None:
            raise ValueError
        self.kind, self.number, path = match[1], int(match[2]), match[3]
        transform = _TRANSFORM.fullmatch(path) if self.kind == "materials" else None
        self.moves_uvs = transform is not None
        default = _OF_TRANSFORMS[transform[1]] if transform is not None else DEFAULTS[self.kind].get(path)
        if default is None:
            raise ValueError
        self.default: tuple[float, ...] = default
        self.path = tuple(path.split("/"))


class AnimatedEntry(Entry):
    """An entry whose numbers are clamped to their ranges, which curves between keys may leave."""

    __slots__ = ()

    def number(
        self, key: str, default: float | None = None, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """As `Entry.number`."""
        return min(max(super().number(key, default), low), high)

    def numbers(
        self, key: str, default: tuple[float, ...], *, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...]:
        """As `Entry.numbers`."""
        return tuple(min(max(value, low), high) for value in super().numbers(key, default))


class AnimatedObject:
    """What a rig animates by `put` and `apply`. read: has the objects of the scene take what an entry says."""

    def __init__(self, entry: Entry, read: Callable[[Entry], None]) -> None:
        self.entry = AnimatedEntry(entry.file, entry.place, copy.deepcopy(entry.data))
        self._read = read

    def put(self, path: tuple[str, ...], values: NDArray[np.float64]) -> None:
        """Change a property."""
        holder = self.entry.data
        for key in path[:-1]:
            holder = holder.setdefault(key, {})
        holder[path[-1]] = values.tolist() if len(values) > 1 else float(values[0])

    def resting(self, wanted: Property) -> NDArray[np.float64]:
        """The values of a property in the file. Raises SolariError for wrong ones."""
        holder: Entry | None = self.entry
        for key in wanted.path[:-1]:
            holder = None if holder is None else holder.entry(key)
        key = wanted.path[-1]
        if holder is None or key not in holder:
            return np.array(wanted.default)
        found = holder.numbers(key, wanted.default) if len(wanted.default) > 1 else (holder.number(key),)
        return np.array(found)

    def apply(self) -> None:
        """Have the objects take the properties."""
        self._read(self.entry)


def assign(items: Iterable[Checked], fields: dict[str, Any]) -> None:
    """Assign those fields that differ, since others would cost work on the device."""
    for item in items:
        item.update(**{name: value for name, value in fields.items() if not _equal(getattr(item, name), value)})


def _equal(a: Any, b: Any) -> bool:
    if isinstance(b, str) or a is None or b is None:
        return bool(a == b)
    return np.array_equal(np.asarray(a, np.float32), np.asarray(b, np.float32))
