"""KHR_materials_variants: the materials that primitives have in each variant of a file."""

from __future__ import annotations

from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.values import Entry, shown

EXTENSION = "KHR_materials_variants"


class Variants:
    """The names of a file's variants, and what they change."""

    def __init__(self, document: Document, report: Report) -> None:
        self._report = report
        self.names: list[str] = []
        extension = document.root.extension(EXTENSION)
        for number, variant in enumerate(extension.entries("variants", "variant") if extension else []):
            name = variant.name or f"variant {number}"
            self.names.append(name if name not in self.names else f"{name} ({number})")

    def materials(self, primitive: Entry) -> dict[str, int]:
        """The numbers of a primitive's materials by variant. Variants that don't change the primitive are left out."""
        extension = primitive.extension(EXTENSION)
        found = {}
        for mapping in extension.entries("mappings", "mapping") if extension else []:
            with self._report.costs("wrong mappings of variants are left out"):
                material = mapping.integer("material")
                for number in mapping.integers("variants"):
                    if number >= len(self.names):
                        count = len(self.names)
                        raise mapping.error(f"refers to variant {shown(number)}, but the file has only {count}")
                    found[self.names[number]] = material
        return found
