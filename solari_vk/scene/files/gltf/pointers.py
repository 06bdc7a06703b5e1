"""KHR_animation_pointer: the properties of materials, cameras and lights that animations change.

An animated object has a copy of its entry in the file. Keys change the copy, and the object takes what the reader of
such entries makes of it, so that whatever is read can be animated.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.files.gltf.extensions import LARGEST_DISTANCE
from solari_vk.scene.files.gltf.lights import MAX_RANGE, PROFILES
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.observable import Checked

Path = tuple[str, ...]
Readings = list[tuple[Sequence[Checked], dict[str, Any]]]
TRANSFORM = "KHR_texture_transform"
NODE = re.compile(r"/nodes/(\d{1,9})/(translation|rotation|scale|weights|extensions/KHR_node_visibility/visible)")
_OBJECT = re.compile(r"/(?:(materials|cameras|nodes)|extensions/KHR_lights_punctual/(lights))/(\d{1,9})/(.+)")
_UNIT = (1.0,)
_ZERO = (0.0,)
_WHITE = (1.0, 1.0, 1.0)
_BLACK = (0.0, 0.0, 0.0)
_TRANSFORM = re.compile(r"(?:.+/)?\w+Texture/extensions/KHR_texture_transform/(offset|rotation|scale)")
_OF_TRANSFORMS = {"offset": (0.0, 0.0), "rotation": _ZERO, "scale": (1.0, 1.0)}
_THICKNESS: dict[str, tuple[float, ...]] = {
    "iridescenceThicknessMinimum": (100.0,),
    "iridescenceThicknessMaximum": (400.0,),
}
_OF_EXTENSIONS: dict[str, dict[str, tuple[float, ...]]] = {
    "anisotropy": {"anisotropyStrength": _ZERO, "anisotropyRotation": _ZERO},
    "clearcoat": {"clearcoatFactor": _ZERO, "clearcoatRoughnessFactor": _ZERO, "clearcoatNormalTexture/scale": _UNIT},
    "diffuse_transmission": {"diffuseTransmissionFactor": _ZERO, "diffuseTransmissionColorFactor": _WHITE},
    "dispersion": {"dispersion": _ZERO},
    "emissive_strength": {"emissiveStrength": _UNIT},
    "ior": {"ior": (1.5,)},
    "iridescence": {"iridescenceFactor": _ZERO, "iridescenceIor": (1.3,)} | _THICKNESS,
    "sheen": {"sheenColorFactor": _BLACK, "sheenRoughnessFactor": _ZERO},
    "specular": {"specularFactor": _UNIT, "specularColorFactor": _WHITE},
    "transmission": {"transmissionFactor": _ZERO},
    "volume": {"thicknessFactor": _ZERO, "attenuationColor": _WHITE, "attenuationDistance": (LARGEST_DISTANCE,)},
}


def _with_paths(extensions: dict[str, dict[str, tuple[float, ...]]]) -> dict[str, tuple[float, ...]]:
    """The properties of extensions by their paths in a material."""
    found = {}
    for extension, keys in extensions.items():
        for key, values in keys.items():
            found[f"extensions/KHR_materials_{extension}/{key}"] = values
    return found


DEFAULTS: dict[str, dict[str, tuple[float, ...]]] = {
    "materials": {
        "pbrMetallicRoughness/baseColorFactor": (1.0, 1.0, 1.0, 1.0),
        "pbrMetallicRoughness/metallicFactor": _UNIT,
        "pbrMetallicRoughness/roughnessFactor": _UNIT,
        "emissiveFactor": _BLACK,
        "alphaCutoff": (0.5,),
        "normalTexture/scale": _UNIT,
    }
    | _with_paths(_OF_EXTENSIONS),
    "cameras": {
        "perspective/yfov": (math.pi / 4,),
        "perspective/znear": (0.01,),
        "orthographic/ymag": _UNIT,
        "orthographic/znear": _ZERO,
    },
    "lights": {
        "color": _WHITE,
        "intensity": _UNIT,
        "range": (MAX_RANGE,),
        "spot/innerConeAngle": _ZERO,
        "spot/outerConeAngle": (math.pi / 4,),
    },
    "nodes": {f"extensions/{PROFILES}/multiplier": _UNIT, f"extensions/{PROFILES}/color": _WHITE},
}
"""The properties that can be animated, with their values where a file has none."""
_SHARED: list[dict[Path, tuple[float, ...]]] = [
    {("emissiveFactor",): _BLACK, ("extensions", "KHR_materials_emissive_strength", "emissiveStrength"): _UNIT},
    {("extensions", "KHR_materials_iridescence", key): default for key, default in _THICKNESS.items()},
    {("color",): _WHITE, ("intensity",): _UNIT},
    {("extensions", PROFILES, "color"): _WHITE, ("extensions", PROFILES, "multiplier"): _UNIT},
    {("spot", "innerConeAngle"): _ZERO, ("spot", "outerConeAngle"): (math.pi / 4,)},
]
"""The properties that make one field together, or limit each other."""
_PROBES = (0.0, 0.5, 1.0, 2.0)  # of which any number that can be animated takes two


class Property:
    """A property of an object of the file: its kind, number and path. Raises ValueError for one that isn't played."""

    def __init__(self, pointer: str) -> None:
        match = _OBJECT.fullmatch(pointer)
        if match is None:
            raise ValueError
        self.kind = match[1] or match[2]
        self.number = int(match[3])
        path = match[4]
        # Any texture's transform can be animated, wherever it is.
        transform = _TRANSFORM.fullmatch(path) if self.kind == "materials" else None
        self.moves_uvs = transform is not None
        default = _OF_TRANSFORMS[transform[1]] if transform is not None else DEFAULTS[self.kind].get(path)
        if default is None:
            raise ValueError
        self.default: tuple[float, ...] = default
        self.path = tuple(path.split("/"))

    @property
    def owner(self) -> tuple[str, int]:
        """The kind and the number of the object."""
        return self.kind, self.number


class AnimatedEntry(Entry):
    """An entry whose numbers are clamped to their ranges, which curves between keys may leave."""

    __slots__ = ()

    def number(
        self, key: str, default: float | None = None, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """As `Entry.number`. An 'ior' is 0 or at least 1."""
        value = min(max(super().number(key, default), low), high)
        return max(value, 1.0) if key == "ior" and value > 0 else value

    def numbers(
        self, key: str, default: tuple[float, ...], *, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...]:
        """As `Entry.numbers`."""
        return tuple(min(max(value, low), high) for value in super().numbers(key, default))


class AnimatedObject:
    """What a rig animates by `put` and `apply`. items: the objects of the scene, which are of one kind. read: the
    objects that an entry changes, with the fields that it says."""

    def __init__(self, items: Sequence[Checked], entry: Entry, read: Callable[[Entry], Readings]) -> None:
        self.items = items
        # A copy, since other objects read the same entry.
        self._entry = AnimatedEntry(entry.file, entry.place, copy.deepcopy(entry.data))
        self._read = read
        self._before: Readings | None = None

    def put(self, path: Path, values: NDArray[np.float64]) -> None:
        """Change a property."""
        put(self._entry.data, path, values)

    def value(self, path: Path, default: tuple[float, ...]) -> NDArray[np.float64]:
        """The values of a property as it is. Raises SolariError for wrong ones."""
        holder: Entry | None = self._entry
        for key in path[:-1]:
            holder = None if holder is None else holder.entry(key)
        if holder is None or path[-1] not in holder:
            return np.array(default)
        return np.array(holder.numbers(path[-1], default) if len(default) > 1 else (holder.number(path[-1]),))

    def stated(self, resting: Mapping[Path, NDArray[np.float64]]) -> dict[Path, NDArray[np.float64]]:
        """The resting values of the properties that animations change, and the values of those that make one field
        together with them, such as the color and the strength of an emission."""
        groups = [group for group in _SHARED if group.keys() & resting.keys()]
        shared = {path: default for group in groups for path, default in group.items()}
        for path in resting:
            if TRANSFORM in path:
                shared |= {(*path[:-1], key): default for key, default in _OF_TRANSFORMS.items()}
        return {path: self.value(path, default) for path, default in shared.items()} | dict(resting)

    def is_at_rest(self, resting: Mapping[Path, NDArray[np.float64]]) -> bool:
        """Whether all fields that animations may change are as the resting values of their properties say."""
        stated = self.stated(resting)
        expected = self._with(stated)
        # What the fields are made of can't be asked of the reader. So the properties get several values, and the fields
        # that differ for one of them are those that an animation may change.
        probes = []
        for probe in _PROBES:
            probes.append(self._with({path: np.full(len(values), probe) for path, values in stated.items()}))
        for (items, fields), *others in zip(expected, *probes, strict=True):
            changed = {name for _, found in others for name in found if not _equal(found[name], fields[name])}
            if any(not _equal(getattr(item, name), fields[name]) for item in items for name in changed):
                return False
        return True

    def _with(self, values: Mapping[Path, NDArray[np.float64]]) -> Readings:
        entry = AnimatedEntry(self._entry.file, self._entry.place, copy.deepcopy(self._entry.data))
        for path, numbers in values.items():
            put(entry.data, path, numbers)
        return self._read(entry)

    def apply(self) -> None:
        """Have the objects take the fields that differ from those of the time before, since others may have been
        edited; the first time, all."""
        found = self._read(self._entry)
        earlier = self._before or [(items, {}) for items, _ in found]
        for (items, fields), (_, before) in zip(found, earlier, strict=True):
            # Compared with the last keys and not with the object: what a user assigned stays until the clip changes it.
            changed = {name for name, value in fields.items() if name not in before or not _equal(before[name], value)}
            _assign(items, {name: fields[name] for name in changed})
        self._before = found


def has_texture(data: dict[str, Any], path: tuple[str, ...]) -> bool:
    """Whether the texture that a path leads through, if any, is there."""
    for key in path:
        if key.endswith("Texture") and key not in data:
            return False
        data = data.get(key, {}) if isinstance(data, dict) else {}
    return True


def put(data: dict[str, Any], path: Path, values: NDArray[np.float64]) -> None:
    """Change a number or numbers in nested objects, but not of a texture that isn't there."""
    if not has_texture(data, path):
        return
    for key in path[:-1]:
        data = data.setdefault(key, {})
    data[path[-1]] = values.tolist() if len(values) > 1 else float(values[0])


def _assign(items: Iterable[Checked], fields: dict[str, Any]) -> None:
    """Assign those fields that differ, since others would cost work on the device."""
    for item in items:
        item.update(**{name: value for name, value in fields.items() if not _equal(getattr(item, name), value)})


def _equal(a: Any, b: Any) -> bool:
    if isinstance(b, str) or a is None or b is None:
        return bool(a == b)
    return np.array_equal(np.asarray(a, np.float32), np.asarray(b, np.float32))
