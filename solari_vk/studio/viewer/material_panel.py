"""The panel of a material: every field, by what it is about, and its textures."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from solari_vk.scene.checks import ALPHA_MODES
from solari_vk.scene.material import RANGES, TEXTURES, Material, Texture
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.widgets import as_edit, choose, color, drag, hint, share

Show = Callable[..., Any]
GROUPS = {
    "surface": ("base_color", "metallic", "perceptual_roughness", "normal", "double_sided", "unlit"),
    "emission": ("emissive",),
    "alpha": ("alpha",),
    "reflection": ("reflectance", "ior", "specular"),
    "glass": ("transmission", "solid", "attenuation", "dispersion"),
    "translucency": ("diffuse_transmission",),
    "clearcoat": ("clearcoat",),
    "sheen": ("sheen",),
    "anisotropy": ("anisotropy",),
    "iridescence": ("iridescence",),
}
"""What the names of fields begin with, by the title under which they are."""
OPEN = ("surface", "emission")
LABELS = {"perceptual_roughness": "roughness"}
THUMBNAIL = 64  # pixels of the longer side of a texture's picture
COLORS_ABOVE_ONE = ("reflectance",)


def group_of(field: str) -> str:
    """The title under which a field is: that with the longest beginning of its name."""
    found = {start: title for title, starts in GROUPS.items() for start in starts if field.startswith(start)}
    return found[max(found, key=len)]


FIELDS = {title: [name for name in Material._names if name != "name" and group_of(name) == title] for title in GROUPS}


class MaterialPanel:
    """Lays out a material. show: gives ImGui a texture, as `OverlayRenderer.show` does."""

    def __init__(self, session: Session, show: Show) -> None:
        self._session = session
        self._show = show
        self._path = ""  # of the file that the user types
        self._shown: dict[str, Texture] = {}  # the texture whose picture each name of `show` has

    def lay_out(self, material: Material) -> None:
        """Lay out all fields; groups in which nothing is as by default are open."""
        changed, name = imgui.input_text("name##material", material.name)
        if changed:
            self._session.edit(material, name=name)
        for title, names in FIELDS.items():
            flags = imgui.TreeNodeFlags_.default_open if title in OPEN or is_used(material, names) else 0
            if imgui.tree_node_ex(title, flags):
                for field in names:
                    self._field(material, field)
                imgui.tree_pop()
        self._from_file()

    def _from_file(self) -> None:
        """A field for a file, whose picture becomes the texture of a field of the material."""
        session = self._session
        imgui.separator_text("texture from a file")
        session.texture_field = choose("##field", session.texture_field, tuple(TEXTURES))
        _, self._path = imgui.input_text_with_hint("##file", "a path; or drop a .png, .jpg, .ktx2", self._path)
        imgui.same_line()
        if imgui.button("put on") and self._path.strip():
            act(session, "put_texture", self._path.strip())

    def _field(self, material: Material, field: str) -> None:
        value = getattr(material, field)
        label = LABELS.get(field, field.replace("_", " "))
        if field in TEXTURES:
            if value is not None:
                self._texture(material, field, value)
            return
        changed, edited = self._edited(material, field, label, value)
        if changed:
            self._session.edit(material, **{field: edited})

    def _edited(self, material: Material, field: str, label: str, value: Any) -> tuple[bool, Any]:
        if field == "emissive":
            return self._emission(value)
        if value is None or isinstance(value, bool):
            return as_edit(imgui.checkbox(label, value is not False))
        if isinstance(value, str):
            edited = choose(label, value, ALPHA_MODES)
            return edited != value, edited
        if np.shape(value) == (2,):  # iridescence's thickness, in nanometers
            return as_edit(imgui.drag_float2(label, value.tolist(), 1.0, 0.0, 1e4, "%.0f"))
        if isinstance(value, np.ndarray):
            return as_edit(color(label, value, 2.5 if field in COLORS_ABOVE_ONE else 1.0))
        low, high = RANGES[field]
        if (low, high) == (0, 1):
            return as_edit(share(label, value))
        return as_edit(drag(label, value, low, high))

    def _emission(self, value: NDArray[np.float32]) -> tuple[bool, Any]:
        """A color and the radiance of its largest channel."""
        # A color of 0 to 1 and a number are easier to set than three numbers without a limit.
        strength = float(value.max())
        tint = value / strength if strength > 0 else np.ones(3, np.float32)
        tinted, edited = color("emission", tint)
        changed, strength = drag("cd/m2", strength, 0.0, 1e9)
        # Whoever chooses a color for a surface that doesn't shine wants to see it.
        if tinted and strength == 0:
            strength = 1.0
        return tinted or changed, np.maximum(edited, 0) * max(strength, 0.0)

    def _texture(self, material: Material, field: str, texture: Texture) -> None:
        """A picture of a texture, its size, and a button that takes it off."""
        pixels = texture.image.pixels
        height, width = pixels.shape[:2]
        name = f"texture {field}"
        # A texture's picture is uploaded when the field gets another texture, not in each frame.
        fresh = self._shown.get(name) is not texture
        reference = self._show(name, thumbnail(pixels) if fresh else None)
        if reference is not None:
            self._shown[name] = texture
            factor = 3 * imgui.get_font_size() / max(width, height)
            imgui.image(reference, imgui.ImVec2(factor * width, factor * height))
            imgui.same_line()
        imgui.begin_group()
        imgui.text(field.replace("_", " "))
        imgui.text_disabled(f"{texture.image.name or 'image'}, {width} x {height}")
        if imgui.small_button(f"take off##{field}"):
            self._session.edit(material, **{field: None})
        imgui.end_group()
        hint(f"wrap {texture.wrap_u}, {texture.wrap_v}; uv set {texture.uv_set}")


def is_used(material: Material, names: list[str]) -> bool:
    """Whether a material has other values than the default ones in any of these fields."""
    for name in names:
        value = getattr(material, name)
        default = Material._defaults[name]
        same = np.array_equal(value, default) if isinstance(value, np.ndarray) else value == default
        if not same:
            return True
    return False


def thumbnail(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pixels (height, width, 4) of at most THUMBNAIL on each side, without their alpha."""
    # Every n-th pixel: a thumbnail needs no filter, and large textures are many.
    step = max(math.ceil(max(pixels.shape[:2]) / THUMBNAIL), 1)
    small = pixels[::step, ::step].copy()
    small[..., 3] = 255
    return small
