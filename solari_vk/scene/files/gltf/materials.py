"""Materials of a glTF file, with their extensions for emission and reflection.

Occlusion textures are ignored without a warning, because a ray tracer computes the light that they approximate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from solari_vk.scene import checks
from solari_vk.scene.files.gltf import specular_glossiness
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.extensions import OF_MATERIALS, Extension
from solari_vk.scene.files.gltf.extras import FRONT_EMITS, read_extras
from solari_vk.scene.files.gltf.nodes import LEVELS
from solari_vk.scene.files.gltf.pointers import AnimatedObject, Readings
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.textures import Slot, Textures
from solari_vk.scene.files.gltf.values import Entry, shown
from solari_vk.scene.material import TEXTURES
from solari_vk.scene.model import Material

VARIANTS = "KHR_materials_variants"
_UNLIT = "KHR_materials_unlit"
_WRONG = "wrong materials are replaced by the default one"


class Materials:
    """Creates the materials of the scene, and keeps them."""

    def __init__(self, document: Document, report: Report, strict: bool) -> None:
        self._document = document
        self._report = report
        self._textures = Textures(document, report, strict)
        self._baker = specular_glossiness.Baker(report)
        self._loaded: dict[int | None, Material] = {}

    def load(self, users: dict[int, Entry]) -> None:
        """Load these materials (index: the object that refers to it) and all their images."""
        parsed = {}
        for index, user in users.items():
            with self._report.costs(_WRONG):
                parsed[index] = self._parse(self._document.item("material", index, user))
        # All images are known before the first is decoded, so that they are decoded together.
        every = [item for _, slots in parsed.values() for item in slots.items()]
        self._textures.decode([(slot, TEXTURES[name]) for name, slot in every])
        for index, (entry, slots) in parsed.items():
            readable = {name: slot for name, slot in slots.items() if slot in self._textures}
            with self._report.costs(_WRONG):
                self._loaded[index] = self._make(entry, readable)

    @property
    def uv_sets(self) -> tuple[int, ...]:
        """`Textures.uv_sets`, after `load`."""
        return self._textures.uv_sets

    def __getitem__(self, index: int | None) -> Material:
        if index not in self._loaded:
            if index is not None:
                return self[None]
            # The default material of glTF is metallic and rough.
            self._loaded[None] = Material(
                base_color=np.ones(3, np.float32),
                metallic=1.0,
                perceptual_roughness=1.0,
                double_sided=False,
                name="default",
            )
        return self._loaded[index]

    def _parse(self, entry: Entry) -> tuple[Entry, dict[str, Slot]]:
        """The entry, and its slots by the fields of Material."""
        pbr = _pbr(entry)
        found = {"base_color_texture": self._textures.slot(pbr, "baseColorTexture")}
        # KHR_materials_unlit: all but the base color and alpha is ignored.
        if not _is_unlit(entry):
            found |= {
                "metallic_roughness_texture": self._textures.slot(pbr, "metallicRoughnessTexture"),
                "normal_texture": self._textures.slot(entry, "normalTexture"),
                "emissive_texture": self._textures.slot(entry, "emissiveTexture"),
            }
            for extension, said in _read_extensions(entry):
                found |= {field: self._textures.slot(said, key) for field, key in extension.textures.items()}
        return entry, {name: slot for name, slot in found.items() if slot is not None}

    def _make(self, entry: Entry, slots: dict[str, Slot]) -> Material:
        self._remark_extensions(entry)
        textures = {name: self._textures.texture(slot) for name, slot in slots.items()}
        return Material(name=entry.name, **self._fields(entry, slots, textures))

    def _fields(self, entry: Entry, slots: dict[str, Slot], textures: dict[str, Any]) -> dict[str, Any]:
        """The fields of a material but its name."""
        pbr = _pbr(entry)
        base_color = pbr.numbers("baseColorFactor", (1.0, 1.0, 1.0, 1.0), low=0, high=1)
        strength = entry.extension("KHR_materials_emissive_strength")
        emissive = np.array(entry.numbers("emissiveFactor", (0.0, 0.0, 0.0), low=0))
        if strength is not None:
            # KHR_materials_emissive_strength; glTF's own factor is at most 1, which counts as 1 cd/m^2.
            emissive = emissive * strength.number("emissiveStrength", 1.0, low=0)
        if emissive.max() > checks.LARGEST_RADIANCE:
            self._report.add(
                f"materials brighter than {checks.LARGEST_RADIANCE:g} cd/m^2 are dimmed to that", entry.place
            )
            emissive *= checks.LARGEST_RADIANCE / emissive.max()
        normal = slots.get("normal_texture")
        fields: dict[str, Any] = {
            "base_color": np.array(base_color[:3], np.float32),
            "metallic": pbr.number("metallicFactor", 1.0, low=0, high=1),
            "perceptual_roughness": pbr.number("roughnessFactor", 1.0, low=0, high=1),
            "alpha": base_color[3],
            "unlit": _is_unlit(entry),
        } | textures
        extensions = _read_extensions(entry)
        for extension, said in extensions:
            fields |= extension.read(said, entry, self._report)
        # It replaces factors and textures of the metallic-roughness part that every material has.
        if any(extension.name == specular_glossiness.EXTENSION for extension, _ in extensions):
            fields |= self._baker.bake(fields, entry)
        return fields | {
            "emissive": emissive.astype(np.float32),
            "normal_scale": normal.entry.limited("scale", 1.0, limit=1e6) if normal else 1.0,
            "alpha_mode": entry.text("alphaMode", "OPAQUE", ("OPAQUE", "MASK", "BLEND")).lower(),
            # A cutoff above 1 is allowed, and leaves nothing of a masked surface.
            "alpha_cutoff": min(entry.number("alphaCutoff", 0.5, low=0), checks.LARGEST_CUTOFF),
            "double_sided": _double_sided(entry),
        }

    def animated(self, number: int, *, moves_uvs: bool) -> AnimatedObject | None:
        """A material for animations; None for one that isn't in the scene, and (reported) one whose textures are baked.

        moves_uvs: its textures are its own then.
        """
        material = self._loaded.get(number)
        entry = self._document.item("material", number, self._document.root)
        if entry.extension(specular_glossiness.EXTENSION) is not None:
            remark = f"animations of materials of {specular_glossiness.EXTENSION} are not played"
            self._report.add(remark, entry.place)
            return None
        if material is None:
            return None
        if moves_uvs:
            textures = {name: getattr(material, name) for name in TEXTURES}
            material.update(**{name: replace(texture) for name, texture in textures.items() if texture is not None})
        moving = {name: getattr(material, name) for name in TEXTURES if moves_uvs}

        def read(said: Entry) -> Readings:
            _, slots = self._parse(said)
            found: Readings = [
                ([moving[name]], {"uv_transform": np.reshape(slot.uv_transform, (2, 3))})
                for name, slot in slots.items()
                if moving.get(name) is not None
            ]
            return [*found, ([material], self._fields(said, slots, {}))]

        return AnimatedObject([material], entry, read)

    def _remark_extensions(self, entry: Entry) -> None:
        for name in entry.extensions():
            if name not in OF_MATERIALS and name != LEVELS and entry.extension(name) is not None:
                self._report.add(f"the extension {name} is not supported and was ignored", entry.place)


def _read_extensions(entry: Entry) -> list[tuple[Extension, Entry]]:
    """The extensions of a material that are read, each with what it says."""
    found = [(extension, entry.extension(name)) for name, extension in OF_MATERIALS.items()]
    return [] if _is_unlit(entry) else [(extension, said) for extension, said in found if said is not None]


def _double_sided(entry: Entry) -> bool | None:
    """Both sides are visible where the file says so; the back emits too unless the file is ours and its front does."""
    visible = entry.flag("doubleSided", False)
    return None if visible and read_extras(entry, (FRONT_EMITS,)) else visible


def _is_unlit(entry: Entry) -> bool:
    """Whether a material shows its base color alone."""
    return entry.extension(_UNLIT) is not None


def _pbr(entry: Entry) -> Entry:
    """The metallic-roughness part of a material, empty when it has none."""
    return entry.entry("pbrMetallicRoughness") or Entry(entry.file, entry.place, {})


class Variants:
    """The names of a file's variants, and what they change."""

    def __init__(self, document: Document, report: Report) -> None:
        self._report = report
        self.names: list[str] = []
        extension = document.root.extension(VARIANTS)
        for number, variant in enumerate(extension.entries("variants", "variant") if extension else []):
            name = variant.name or f"variant {number}"
            self.names.append(name if name not in self.names else f"{name} ({number})")

    def materials(self, primitive: Entry) -> dict[str, int]:
        """The numbers of a primitive's materials by variant. Variants that don't change the primitive are left out."""
        extension = primitive.extension(VARIANTS)
        found = {}
        for mapping in extension.entries("mappings", "mapping") if extension else []:
            with self._report.costs("wrong mappings of variants are left out"):
                material = mapping.integer("material")
                for number in mapping.integers("variants"):
                    found[self._name(number, mapping)] = material
        return found

    def _name(self, number: int, user: Entry) -> str:
        if number >= len(self.names):
            raise user.error(f"refers to variant {shown(number)}, but the file has only {len(self.names)}")
        return self.names[number]
