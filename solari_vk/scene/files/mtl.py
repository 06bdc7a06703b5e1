"""Materials of Wavefront .mtl files, with the physically based fields that newer programs write.

Bourke, "MTL material format" (1995); Pr, Pm, Ke and norm are those of "Extending the MTL format for physically based
rendering". Colors are taken as linear, and those of textures as sRGB.
"""

from __future__ import annotations

import math
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.budget import BudgetError, charge
from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.files import read_regular, text_lines
from solari_vk.scene.images import image_files
from solari_vk.scene.model import Material, TextureImage

LARGEST_FILE = 2**26
_BYTES_PER_FIELD = 150
_BYTES_PER_MATERIAL = 2**14
_KNOWN = {"kd", "ke", "ns", "pr", "pm", "ni", "d", "tr"}
_HARMLESS = {"ka", "illum", "sharpness"}  # for rasterizers without shadows
_OPTION = re.compile(r"-([a-z]+)((?:\s+(?:on|off|[-+.\d][-+.\de]*|[rgbmlz]))*)\s+", re.IGNORECASE)  # and its values
_HARMLESS_OPTIONS = {"blendu", "blendv", "texres"}
_MASK = "map_d"
_MOST_BETWEEN = 0.1  # of a mask's texels, on the edges of what it cuts out
_TEXTURES = {"map_kd": "base_color_texture", "map_ke": "emissive_texture", "norm": "normal_texture"}


class MtlFiles:
    """Reads the .mtl files of an .obj file, and the images that they name. Nothing outside its folder is read."""

    def __init__(self, folder: Path) -> None:
        self.failures: list[str] = []
        """What could not be read, a line each."""
        self.ignored: dict[str, None] = {}
        """The fields and options of used materials that have no effect."""
        self.fields: dict[str, dict[str, str]] = {}
        """The fields of each material by its name, as they stand in the files."""
        self._materials: dict[str, Material] = {}
        self._folder = folder
        self._images: dict[str, TextureImage | None] = {}

    def get(self, name: str) -> bytes:
        """Read a file's materials. The result is the file without all but their names, for the reader of the .obj."""
        try:
            data = self._read(name)
        except BudgetError:
            raise
        except SolariError as error:
            self.failures.append(f"materials are replaced by a gray one: {error}")
            return b""
        fields: dict[str, dict[str, str]] = {}
        for _, line in text_lines(data, name):
            key, value = (*line.split(None, 1), "", "")[:2]
            charge(_BYTES_PER_FIELD + 2 * sys.getsizeof(line), name, "its materials")
            if key == "newmtl":
                current = fields.setdefault(" ".join(value.split()), {})
            elif fields:
                current[key] = value.strip()
        self.fields |= fields
        # The reader of .obj files needs the names, to tell materials apart; images it would read without our limits.
        return "".join(f"newmtl {name}\n" for name in fields).encode()

    __getitem__ = get

    def material(self, name: str) -> Material | None:
        """The material of a name, whose images are read now; None for an unknown one."""
        if name not in self._materials and name in self.fields:
            charge(_BYTES_PER_MATERIAL, str(self._folder), "the materials")
            self._materials[name] = self._make(name, self.fields[name])
        return self._materials.get(name)

    def _make(self, name: str, fields: dict[str, str]) -> Material:
        properties = {key.lower(): value for key, value in fields.items()}
        known = {*_KNOWN, *_HARMLESS, *_TEXTURES, _MASK}
        self.ignored |= dict.fromkeys(key for key in fields if key and key[0] != "#" and key.lower() not in known)
        textures = self._read_textures(properties)
        color = _numbers(properties.get("kd"), 0.8, 1.0)
        emissive = _numbers(properties.get("ke"), 0.0, 1e9)
        # Some programs write black beside a texture, which is meant to be seen.
        if "base_color_texture" in textures and not color.any():
            color = np.ones(3)
        if "emissive_texture" in textures and not emissive.any():
            emissive = np.ones(3)
        # The width of Blinn's highlight with the exponent Ns: Walter et al., "Microfacet models for refraction" (2007).
        alpha = math.sqrt(2 / (_number(properties.get("ns"), 30.0, 1e9) + 2))
        # F0 = ((n - 1) / (n + 1))^2 = 0.16 reflectance^2. A file without Ni means the usual 1.5, and so does Ni 1.
        index = max(_number(properties.get("ni"), 1.5, 10.0), 1.0)
        reflectance: Any = (index - 1) / (index + 1) / 0.4 if index > 1 else 0.5
        alpha_mode = self._add_mask(properties, textures)
        opacity = _number(properties.get("d"), 1.0 - _number(properties.get("tr"), 0.0, 1.0), 1.0)
        return Material(
            name=name,
            double_sided=True,
            base_color=color,
            emissive=emissive,
            perceptual_roughness=_number(properties.get("pr"), min(math.sqrt(alpha), 1.0), 1.0),
            metallic=_number(properties.get("pm"), 0.0, 1.0),
            reflectance=reflectance,
            alpha=opacity,
            alpha_mode="blend" if opacity < 1 else alpha_mode,
            **textures,
        )

    def _read_textures(self, properties: dict[str, str]) -> dict[str, Any]:
        """The textures of a material by the field of Material; without those that can't be read."""
        textures: dict[str, Any] = {}
        for key, field in _TEXTURES.items():
            image = self.image(self._without_options(properties[key])) if key in properties else None
            if image is not None:
                textures[field] = image
        return textures

    def _add_mask(self, properties: dict[str, str], textures: dict[str, Any]) -> str:
        """Give the base color texture the alpha of `map_d`: that picture's alpha, or its red without one. Returns the
        alpha mode: "mask" where nearly all is either there or not."""
        mask = self.image(self._without_options(properties[_MASK])) if _MASK in properties else None
        if mask is None:
            return "opaque"
        alpha = mask.pixels[..., 0 if mask.least_alpha == 1 else 3]
        base = textures.get("base_color_texture")
        size = mask.pixels.shape[:2] if base is None else base.pixels.shape[:2]
        # Nearest texels, where the pictures differ in size.
        rows, columns = (np.arange(new) * old // new for new, old in zip(size, alpha.shape, strict=True))
        pixels = np.full((*size, 4), 255, np.uint8) if base is None else base.pixels.copy()
        pixels[..., 3] = alpha[rows[:, None], columns]
        charge(pixels.nbytes, mask.name, "its alpha")
        textures["base_color_texture"] = TextureImage(pixels, mask.name if base is None else base.name)
        between = np.mean((alpha > 31) & (alpha < 224))
        return "mask" if between < _MOST_BETWEEN else "blend"

    def _without_options(self, value: str) -> str:
        """The name of a texture's file, which stands behind options and may have spaces."""
        option = _OPTION.match(value)
        while option is not None:
            if option[1].lower() not in _HARMLESS_OPTIONS:
                self.ignored[f"-{option[1]}"] = None
            value = value[option.end() :]
            option = _OPTION.match(value)
        return value

    def image(self, name: str) -> TextureImage | None:
        """A picture in the folder; None (among the failures) for one that can't be read."""
        if name not in self._images:
            self._images[name] = None
            try:
                who = f"the image '{name}'"
                image = image_files.open_image(self._read(name), who, image_files.MORE_FORMATS)
                pixels = image_files.decode(image, who)
                self._images[name] = TextureImage(pixels, os.path.basename(name))
            except BudgetError:
                raise
            except SolariError as error:
                self.failures.append(f"textures are left out: {error}")
        return self._images[name]

    def _read(self, name: str) -> bytes:
        name = name.replace("\\", "/")
        folder = Path(os.path.realpath(self._folder))
        try:
            # Links are followed before the path is compared with the folder.
            path = Path(os.path.realpath(_in_any_case(folder / name)))
        except (OSError, ValueError):
            raise SolariError(f"no file can have the name {quoted(name)}") from None
        if not path.is_relative_to(folder):
            raise SolariError(f"the file '{name}' is outside the model's folder, where nothing is read: copy it there")
        data = read_regular(path, f"'{name}'", LARGEST_FILE + 1)
        if len(data) > LARGEST_FILE:
            raise SolariError(f"the file '{name}' has more than {LARGEST_FILE >> 20} MiB: make it smaller")
        return data


def _in_any_case(path: Path) -> Path:
    """A file, or else the only one of its folder whose name differs in case alone: many come from systems where that is
    the same file."""
    if path.exists() or not path.parent.is_dir():
        return path
    found = [other for other in path.parent.iterdir() if other.name.casefold() == path.name.casefold()]
    return found[0] if len(found) == 1 else path


def _number(text: str | None, default: float, highest: float) -> float:
    """The number at the start of a field, from 0; the default for a field that is missing or has none."""
    try:
        value = float((text or "").split()[0])
    except (IndexError, ValueError):
        return default
    return min(max(value, 0.0), highest) if math.isfinite(value) else default


def _numbers(text: str | None, default: float, highest: float) -> Any:
    """Three numbers of a field; a single one stands for all three."""
    words = (text or "").split()
    three = words[:3] if len(words) > 2 else (words or [""])[:1] * 3
    return np.array([_number(word, default, highest) for word in three])
