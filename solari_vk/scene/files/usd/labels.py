"""Classes and objects: what a stage says about the meaning of its prims."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from pxr import Kind, Usd, UsdSemantics

from solari_vk.scene.group import distinct

_FIRST = "class"  # the taxonomy whose labels are preferred


class Labels:
    """Reads the semantics of prims. Those of a prim hold for all below it that have none."""

    def __init__(self, time: Any) -> None:
        self._time = time

    def place(self, place: Any, objects: dict[str, int]) -> Any:
        """The place with the label of its prim and the object that begins there: at a label, or a component."""
        prim = place.prim
        label = self._label(prim)
        if label:
            return replace(place, label=label, part_of=self._object(prim, objects))
        if not place.part_of and Kind.Registry.IsA(Usd.ModelAPI(prim).GetKind(), Kind.Tokens.component):
            return replace(place, part_of=self._object(prim, objects))
        return place

    def _object(self, prim: Any, objects: dict[str, int]) -> str:
        return distinct("".join(filter(str.isprintable, prim.GetName())), objects)

    def _label(self, prim: Any) -> str:
        found: dict[str, str] = {}
        for taxonomy in UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
            labels = UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get(self._time)
            if labels:
                found[str(taxonomy)] = str(labels[0])
        # Of Isaac Sim, before USD had labels. USD itself doesn't know this schema.
        for attribute in prim.GetAuthoredPropertiesInNamespace("semantic"):
            place, _, last = attribute.GetName().rpartition(":")
            value = prim.GetAttribute(f"{place}:semanticData").Get() if last == "semanticType" else None
            if value:
                found.setdefault(str(attribute.Get()), str(value))
        label = found.get(_FIRST) or next(iter(found.values()), "")
        return "".join(filter(str.isprintable, label))
