"""Opening a stage: which layers it may read, what composing it may take, and the choice of variants."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.base.files import read_regular
from solari_vk.scene.files.gltf.values import clean

_BYTES_PER_PRIM = 1024  # of a composed stage
_BYTES_PER_BYTE_OF_TEXT, _BYTES_PER_BYTE = 8, 2  # of a layer; arrays of binary layers are read when they are used
_CRATE, _ZIP = b"PXR-USDC", b"PK\x03\x04"
_MOST_CHANGES = 64  # of selected variants, which may bring sets of variants of their own
_UNOPENED = re.compile(
    r"Could not \w+ (?:asset|sublayer) @(.*?)@.*?(?:introduced by|of layer) @(.*?)@(?:<(.*?)>)?", re.DOTALL
)
_CYCLE = re.compile(r"@<(.*?)>")


class Folder:
    """The folder of a file, outside of which nothing is read."""

    def __init__(self, path: Path) -> None:
        self.file = str(path)
        self._folder = Path(os.path.realpath(path)).parent

    def has(self, place: str) -> bool:
        """Whether a resolved path, which may lead into a package, is inside. Links are followed first."""
        outer = Ar.SplitPackageRelativePathOuter(place)[0]
        try:
            return Path(os.path.realpath(outer)).is_relative_to(self._folder)
        except (OSError, ValueError):
            return False

    def who(self, place: str) -> str:
        """The words for a layer in errors."""
        inside = os.path.relpath(place, self._folder)
        return self.file if inside == os.path.basename(self.file) else f"{self.file}: the layer {quoted(clean(inside))}"

    def error(self, text: str) -> SolariError:
        """The exception for a fault of the file."""
        return SolariError(f"{self.file}: {text}")

    def outside(self, what: str, name: str) -> SolariError:
        """The exception for something outside."""
        return self.error(
            f"{what} {quoted(clean(name))}, which is outside the file's own folder, where nothing is read: "
            "copy it into the folder"
        )


class Layers:
    """The layers that a file may compose, looked at one by one before USD does."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self._opened: dict[str, Any] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._counted: set[tuple[str, str]] = set()  # of what instances share
        self._active: set[tuple[str, str]] = set()

    def check(self, path: Path) -> Any:
        """Check all layers and charge what they compose to. Returns the root layer."""
        root = self._open(os.path.realpath(path))
        if root is None:
            raise self._folder.error("can't be opened as USD: export it again")
        # A layer's own folder, not the working directory, is where its relative names lead.
        waiting = [root]
        seen = {root.identifier}
        while waiting:
            layer = waiting.pop()
            for name in self._names(layer):
                other = self._reached(layer, name)
                if other is not None and other.identifier not in seen:
                    seen.add(other.identifier)
                    waiting.append(other)
        try:
            count = sum(self._count(layer, "/") for layer in {root, *self._sublayers(root, set())})
        except RecursionError:
            raise self._folder.error("has references that lead too deep: flatten it by `usdcat --flatten`") from None
        charge(_BYTES_PER_PRIM * count, self._folder.file, f"the {count:,} prims that its references make")
        return root

    def _prims(self, layer: Any, spec: Any) -> Iterator[Any]:
        """The prims at and below one of a layer, with all variants."""
        waiting = [spec]
        while waiting:
            spec = waiting.pop()
            if spec is None or spec.expired:  # USD ends the process where such a prim is asked for anything
                raise self._folder.error(f"the layer {layer.identifier} is damaged: export it again")
            yield spec
            waiting += spec.nameChildren
            for variants in spec.variantSets if spec.path != Sdf.Path.absoluteRootPath else ():
                waiting += [variant.primSpec for variant in variants.variants.values()]

    def _names(self, layer: Any) -> Iterator[str]:
        """The names of other layers that a layer has."""
        yield from layer.subLayerPaths
        for spec in self._prims(layer, layer.pseudoRoot):
            if spec.path == Sdf.Path.absoluteRootPath:
                continue
            for item in (*spec.referenceList.GetAppliedItems(), *spec.payloadList.GetAppliedItems()):
                yield item.assetPath
            # Clips of values, which are opened as late as their values are asked for.
            for clips in dict(spec.GetInfo("clips") or {}).values() if spec.HasInfo("clips") else ():
                yield from (asset.path for asset in clips.get("assetPaths", ()))
                yield from (asset.path for asset in (clips.get("manifestAssetPath"),) if asset is not None)
                yield str(clips.get("templateAssetPath", "")).replace("#", "0")

    def _reached(self, layer: Any, name: str) -> Any:
        """The layer that another one names; None for one that is missing, which composition will say."""
        if name.startswith("`"):
            found = Sdf.VariableExpression(name).Evaluate(dict(layer.expressionVariables))
            name = found.value if isinstance(found.value, str) else ""
        if not name:
            return None
        plain, _ = Sdf.Layer.SplitIdentifier(name)
        place = str(Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(layer, plain)) or "")
        if not place:
            # What isn't there is told apart from what would be outside.
            joined = os.path.join(os.path.dirname(layer.realPath), plain)
            if os.path.isabs(plain) or (plain.startswith(".") and not self._folder.has(joined)):
                raise self._folder.outside("refers to the layer", name)
            return None
        if not self._folder.has(place):
            raise self._folder.outside("refers to the layer", name)
        return self._open(place)

    def _open(self, place: str) -> Any:
        if place not in self._opened:
            outer = Ar.SplitPackageRelativePathOuter(place)[0]
            who = self._folder.who(place)
            if outer == place:
                head = read_regular(Path(outer), who, 8)
                factor = _BYTES_PER_BYTE if head[:8] == _CRATE or head[:4] == _ZIP else _BYTES_PER_BYTE_OF_TEXT
                charge(factor * os.path.getsize(outer), who, "the layer")
            try:
                self._opened[place] = Sdf.Layer.FindOrOpen(place)
            except Tf.ErrorException as error:
                raise SolariError(f"{who}: can't be read as USD ({reason(error)}): export it again") from None
            if self._opened[place] is None:
                raise SolariError(f"{who}: can't be read as USD: export it again")
        return self._opened[place]

    def _sublayers(self, layer: Any, seen: set[str]) -> Iterator[Any]:
        for name in layer.subLayerPaths:
            other = self._reached(layer, name)
            if other is not None and other.identifier not in seen:
                seen.add(other.identifier)
                yield other
                yield from self._sublayers(other, seen)

    # References can repeat others: thirty layers of two each would be a billion prims.

    def _count(self, layer: Any, path: str) -> int:
        """How many prims a prim of a layer composes to, at most: all variants count."""
        key = layer.identifier, path
        if key in self._active:
            return 0  # a circle, which composition will say
        if key not in self._counts:
            charge(0, self._folder.file, "its references")  # looks at the time
            self._active.add(key)
            total = 0
            spec = layer.pseudoRoot if path == "/" else layer.GetPrimAtPath(path)
            for prim in self._prims(layer, spec) if spec is not None else ():
                total += 1 + sum(self._weight(prim, *target) for target in self._targets(layer, prim))
            self._active.discard(key)
            self._counts[key] = total
        return self._counts[key]

    def _weight(self, spec: Any, layer: Any, path: str) -> int:
        """What an arc to another prim adds: nothing for another instance of what instances share."""
        target = layer.GetPrimAtPath(path)
        key = layer.identifier, path
        if spec.instanceable or (target is not None and target.instanceable):
            if key in self._counted:
                return 0
            self._counted.add(key)
        return self._count(layer, path)

    def _targets(self, layer: Any, spec: Any) -> Iterator[tuple[Any, str]]:
        """The layers and paths that a prim's arcs lead to."""
        if spec.path == Sdf.Path.absoluteRootPath:
            return
        for item in (*spec.referenceList.GetAppliedItems(), *spec.payloadList.GetAppliedItems()):
            other = self._reached(layer, item.assetPath) if item.assetPath else layer
            if other is not None:
                for one in (other, *self._sublayers(other, set())):
                    yield one, str(item.primPath) or f"/{other.defaultPrim}"
        for arcs in (spec.inheritPathList, spec.specializesList):
            for path in arcs.GetAppliedItems():
                yield layer, str(path)


def reason(error: Exception) -> str:
    """What USD says, on one line."""
    try:
        said = str(error)
    except UnicodeError:  # it quotes the file
        return "it isn't text in UTF-8"
    found = re.findall(r" : '(.*?)'?\s*(?:\n|$)", said)
    # What names the file names its line, too.
    text = re.sub(r"^/\S*?:(\d+):\d+: ", r"line \1: ", found[0]) if found else said.strip()
    return " ".join(clean(text).split())[:160]


def open_stage(path: Path, variants: Mapping[str, Any]) -> tuple[Any, Folder]:
    """A stage with all its payloads and the chosen variants. Raises SolariError as `load_usd` does."""
    folder = Folder(path)
    layers = Layers(folder)  # keeps them open until the stage does
    root = layers.check(path)
    try:
        stage = Usd.Stage.Open(root, Sdf.Layer.CreateAnonymous("variants.usda"), load=Usd.Stage.LoadAll)
        select(stage, variants, folder)
    except Tf.ErrorException as error:
        raise folder.error(f"can't be composed ({reason(error)}): export it again") from None
    # By names that only composition knows, such as of clips of values.
    for layer in stage.GetUsedLayers():
        if layer.realPath and not folder.has(layer.realPath):
            raise folder.outside("refers to the layer", layer.identifier)
    return stage, folder


def composition_faults(stage: Any, folder: Folder) -> Iterator[tuple[str, bool]]:
    """What composition had to leave out, and whether it costs whole layers."""
    for error in stage.GetCompositionErrors():
        text = str(error)
        kind = type(error).__name__
        if "Cycle" in kind:
            places = " and ".join(dict.fromkeys(f"<{place}>" for place in _CYCLE.findall(text)))
            yield f"{places or 'its layers'} refer to each other in a circle: remove one of these references", True
            continue
        found = _UNOPENED.search(text)
        if found is not None or kind in ("ErrorInvalidAssetPath", "ErrorInvalidSublayerPath"):
            name, user = (found[1], found[3] or found[2]) if found else (" ".join(text.split())[:160], "")
            where = f" of <{user}>" if user else ""
            text = f"the layer {quoted(clean(os.path.relpath(name, os.path.dirname(os.path.realpath(folder.file)))))}"
            yield f"{text}{where} is missing or can't be read: copy it into the file's folder", True
        else:
            yield " ".join(clean(text).split())[:200], False


def select(stage: Any, variants: Mapping[str, Any], folder: Folder) -> None:
    """Choose variants, in the session of the stage alone. Raises SolariError for those that the file hasn't."""
    if not isinstance(variants, Mapping):
        raise folder.error(f'variants: give what to choose, such as {{"color": "red"}}, not {quoted(variants)}')
    wanted: dict[tuple[str, str], Any] = {}  # by prim, "" for all, and set
    for key, value in variants.items():
        if isinstance(value, Mapping):
            if not stage.GetPrimAtPath(str(key) if str(key).startswith("/") else f"/{key}"):
                raise folder.error(f"variants: there is no prim {quoted(key)}: give its path, such as '/World/Car'")
            wanted |= {(str(key), str(name)): choice for name, choice in value.items()}
        else:
            wanted["", str(key)] = value
    found: dict[tuple[str, str], set[str]] = {key: set() for key in wanted}
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        # A variant may bring prims with sets of their own.
        for _ in range(_MOST_CHANGES):
            changes = list(_changes(stage, wanted, found))
            for group, choice in changes:
                group.SetVariantSelection(choice)
            if not changes:
                break
    for (prim, name), choices in found.items():
        where = f" of {prim}" if prim else ""
        if not choices:
            raise unknown_name(f"{folder.file}: variants: there is no set{where}", name, variant_sets(stage))
        if wanted[prim, name] not in choices:
            raise unknown_name(
                f"{folder.file}: variants: the set '{name}'{where} has no", wanted[prim, name], sorted(choices)
            )


def variant_sets(stage: Any) -> dict[str, list[str]]:
    """The names of the sets of variants, and of the variants of each."""
    found: dict[str, set[str]] = {}
    for prim in stage.TraverseAll():
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            found.setdefault(name, set()).update(sets.GetVariantSet(name).GetVariantNames())
    return {name: sorted(found[name]) for name in sorted(found)}


def _changes(stage: Any, wanted: Mapping[Any, Any], found: Mapping[Any, set[str]]) -> Iterator[tuple[Any, str]]:
    """The sets that have another selection than is wanted. found: gets the names of their variants."""
    # Also below `over` and `class`, where prototypes stand.
    for prim in stage.TraverseAll() if wanted else ():
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            for key in ((str(prim.GetPath()), name), (str(prim.GetPath())[1:], name), ("", name)):
                if key not in wanted:
                    continue
                group = sets.GetVariantSet(name)
                found[key].update(group.GetVariantNames())
                if wanted[key] in group.GetVariantNames() and group.GetVariantSelection() != wanted[key]:
                    yield group, wanted[key]
                break
