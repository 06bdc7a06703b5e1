"""The panel that edits the scene: instances with transforms and materials, lights, cameras."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from solari_vk.scene.matrices import rotation
from solari_vk.scene.model import Camera, Instance, Light, Material
from solari_vk.viewer.session import Session

LABELS = 100  # width of the labels beside the fields
MAX_ROWS = 500  # items that a list shows; the others can be picked in the picture
AXES = np.eye(3)


class ScenePanel:
    """Lays out the scene as a tree. An edit assigns to a field of the object; a refused value shows its error."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def lay_out(self) -> None:
        """Lay out the picked instance, then everything in the scene."""
        scene = self._session.scene
        pick = self._session.pick
        imgui.push_item_width(-LABELS)
        if pick is not None and pick.instance in scene.instances:
            imgui.separator_text("picked")
            self._instance(pick.instance)
            imgui.separator()
        if scene.warnings and imgui.tree_node(f"warnings ({len(scene.warnings)})"):
            for warning in scene.warnings:
                imgui.text_wrapped(warning)
            imgui.tree_pop()
        materials = dict.fromkeys(instance.material for instance in scene.instances)
        lights = [i for i in scene.instances if i.material.emits]
        self._list("instances", list(scene.instances), self._instance)
        self._list("materials", list(materials), self._material)
        self._list("emissive instances", lights, lambda instance: self._material(instance.material))
        self._list("lights", list(scene.lights), self._light)
        self._list("cameras", list(scene.cameras), self._camera)
        imgui.pop_item_width()

    def _list(self, title: str, items: list[Any], edit: Callable[[Any], None]) -> None:
        if not items or not imgui.tree_node(f"{title} ({len(items)})###{title}"):
            return
        for number, item in enumerate(items[:MAX_ROWS]):
            if imgui.tree_node(f"{item.name or f'{title} {number}'}###{title} {number}"):
                edit(item)
                imgui.tree_pop()
        if len(items) > MAX_ROWS:
            imgui.text(f"... and {len(items) - MAX_ROWS} more: click on one in the picture to edit it")
        imgui.tree_pop()

    # ---- editors ------------------------------------------------------------------------------------

    def _instance(self, instance: Instance) -> None:
        imgui.push_id(id(instance) & 0x7FFFFFFF)
        triangles = len(instance.mesh.triangles)
        imgui.text(f"{instance.mesh.describe()}: {triangles:,} triangles")
        self._edit(instance, "visible", imgui.checkbox("visible", instance.visible))
        self._transform(instance)
        if imgui.tree_node(f"material: {instance.material.name or 'unnamed'}###material"):
            self._material(instance.material)
            imgui.tree_pop()
        imgui.pop_id()

    def _transform(self, instance: Instance) -> None:
        """The position, and sliders that turn and scale the instance while they are dragged."""
        transform = instance.transform.copy()
        step = max(1e-3 * float(np.linalg.norm(transform[:3, 3])), 5e-3)
        moved, position = imgui.drag_float3("position", transform[:3, 3].tolist(), step, format="%.4g")
        turned, degrees = imgui.drag_float3("turn by", [0.0] * 3, 0.5, format="%.1f deg")
        scaled, factor = imgui.drag_float("scale by", 1.0, 0.005, 0.1, 10.0, "%.3f")
        if moved:
            transform[:3, 3] = position
        if turned:
            for axis, angle in zip(AXES, degrees, strict=True):
                transform[:3, :3] = rotation(axis, math.radians(angle)) @ transform[:3, :3]
        if scaled and factor > 0:
            transform[:3, :3] *= factor
        self._edit(instance, "transform", (moved or turned or scaled, transform))

    def _material(self, material: Material) -> None:
        imgui.push_id(id(material) & 0x7FFFFFFF)
        self._edit(material, "base_color", color("base color", material.base_color))
        self._edit(material, "metallic", share("metallic", material.metallic))
        self._edit(material, "perceptual_roughness", share("roughness", material.perceptual_roughness))
        self._edit(material, "reflectance", share("reflectance", float(material.reflectance.mean())))
        strength = float(material.emissive.max())
        tint = (material.emissive / strength if strength > 0 else np.ones(3)).tolist()
        tinted, tint = imgui.color_edit3("emission", tint, imgui.ColorEditFlags_.float)
        speed = max(0.01 * strength, 0.05)
        changed, strength = imgui.drag_float("cd/m2", strength, speed, 0.0, 1e9, "%.4g")
        self._edit(material, "emissive", (tinted or changed, np.maximum(tint, 0) * max(strength, 0.0)))
        self._edit(material, "double_sided", imgui.checkbox("double-sided", material.double_sided))
        imgui.pop_id()

    def _light(self, light: Light) -> None:
        """Edit the numbers, vectors and the color of a light of any kind."""
        for field in dataclasses.fields(light):  # type: ignore[arg-type]  # each kind of light is a dataclass
            value, label = getattr(light, field.name), field.name.replace("_", " ")
            if field.name == "color":
                self._edit(light, "color", color("color", value))
            elif np.shape(value) == (3,):
                self._edit(light, field.name, imgui.drag_float3(label, value.tolist(), 0.01, format="%.4g"))
            elif np.shape(value) == (3, 3):
                turned, degrees = imgui.drag_float("turn by", 0.0, 0.5, format="%.1f deg")
                self._edit(light, field.name, (turned, rotation(AXES[1], math.radians(degrees)) @ value))
            elif isinstance(value, float):
                speed = max(0.01 * abs(value), 1e-3)
                self._edit(light, field.name, imgui.drag_float(label, value, speed, format="%.4g"))

    def _camera(self, camera: Camera) -> None:
        if imgui.button("go there"):
            self._session.camera_control.take(camera)
            self._session.pictures.cut()

    def _edit(self, item: Any, field: str, edited: tuple[bool, Any]) -> None:
        """Assign what a widget returned, whether it was changed and its value, to a field."""
        if edited[0]:
            with self._session.showing_mistakes():
                setattr(item, field, edited[1])
                self._session.edits[item, field] = None


def share(label: str, value: float) -> tuple[bool, float]:
    """A slider from 0 to 1."""
    edited: tuple[bool, float] = imgui.slider_float(label, value, 0, 1, flags=imgui.SliderFlags_.always_clamp)
    return edited


def color(label: str, value: NDArray[np.float32]) -> tuple[bool, NDArray[np.float64]]:
    """An editor of a color. The numbers are linear, as in the scene, so the swatch beside them looks darker."""
    changed, edited = imgui.color_edit3(label, value.tolist(), imgui.ColorEditFlags_.float)
    return changed, np.clip(edited, 0, 1)
