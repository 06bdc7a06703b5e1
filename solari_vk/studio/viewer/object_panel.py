"""The panel of what is picked: an instance with its material, a light or a camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from imgui_bundle import imgui

from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light, kelvin
from solari_vk.scene.matrices import rotation
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.observable import Checked
from solari_vk.studio.viewer.actions import act
from solari_vk.studio.viewer.material_panel import MaterialPanel, Show
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.widgets import as_edit, color, drag, hint

AXES = np.eye(3)
TEMPERATURES = {"candle": 1900, "light bulb": 2700, "halogen": 3200, "noon": 5500, "overcast": 6500, "blue sky": 10000}
"""Of black bodies, in kelvin."""
UNITS = {"intensity": "cd", "illuminance": "lx", "radius": "m", "range": "m"}
OPTIONAL = {"range": 10.0}
"""Fields of lights that may be None, and what they are when they are switched on."""


class ObjectPanel:
    """Lays out the fields of what a session has picked. A value that is refused shows its error."""

    def __init__(self, session: Session, show: Show) -> None:
        self._session = session
        self._material = MaterialPanel(session, show)

    def lay_out(self) -> None:
        """Lay out the name and the fields, which are dim for a locked object."""
        item = self._session.selected
        if item is None:
            return
        imgui.push_item_width(-7 * imgui.get_font_size())
        imgui.push_id(id(item) & 0x7FFFFFFF)  # a C int; so a field that is being typed in isn't that of another object
        imgui.begin_disabled(item in self._session.locked)
        changed, name = imgui.input_text("name", item.name)
        if changed:
            self._session.edit(item, name=name)
        others = len(self._session.picked) - 1
        if others:
            imgui.text_wrapped(f"{others} more picked: G, R, S, handles, arrows, H, F and Delete are for all of them.")
        if isinstance(item, Instance):
            self._instance(item)
        elif isinstance(item, Light):
            self._light(item)
        elif isinstance(item, Camera):
            self._camera(item)
        imgui.end_disabled()
        imgui.pop_id()
        imgui.pop_item_width()

    def _edit(self, item: Checked, field: str, edited: tuple[bool, Any]) -> None:
        """Assign what a widget returned, whether it was changed and its value, to a field."""
        if edited[0]:
            self._session.edit(item, **{field: edited[1]})

    # ---- instances ----------------------------------------------------------------------------------

    def _instance(self, instance: Instance) -> None:
        imgui.text_disabled(f"{instance.mesh.describe()}: {len(instance.mesh.triangles):,} triangles")
        if self._session.pick is not None:
            imgui.text_disabled("at " + ", ".join(f"{x:.4g}" for x in self._session.pick.point))
        self._edit(instance, "visible", imgui.checkbox("visible", instance.visible))
        self._transform(instance)
        changed, label = imgui.input_text("label", instance.label)
        hint("A semantic class, such as chair, for annotations of pictures.")
        self._edit(instance, "label", (changed, label))
        # Materials are shared: an edit shows on all instances that have this one.
        users = users_of(self._session.scene, instance)
        imgui.separator_text(f"material: {instance.material.name or 'unnamed'}")
        if users > 1:
            imgui.text_disabled(f"used by {users} objects")
            imgui.same_line()
            if imgui.small_button("make its own"):
                act(self._session, "own_material")
            hint("Edits change all objects that have this material. A copy of it is this object's alone.")
        self._material.lay_out(instance.material)

    def _transform(self, item: Any) -> None:
        """The position, and fields that turn and scale the object while they are dragged."""
        transform = item.transform.copy()
        # A drag of a pixel moves by a thousandth of the way to the origin, and by 5 mm at least.
        step = max(1e-3 * float(np.linalg.norm(transform[:3, 3])), 5e-3)
        moved, position = imgui.drag_float3("position", transform[:3, 3].tolist(), step, format="%.4g")
        # Turning and scaling are relative: a transform has no Euler angles of its own, and theirs would jump.
        turned, degrees = imgui.drag_float3("turn by", [0.0] * 3, 0.5, format="%.1f deg")
        scaled = False
        factor = 1.0
        if isinstance(item, Instance):
            scaled, factor = imgui.drag_float("scale by", 1.0, 0.005, 0.1, 10.0, "%.3f")
        if moved:
            transform[:3, 3] = position
        if turned:
            for axis, angle in zip(AXES, degrees, strict=True):
                transform[:3, :3] = rotation(axis, math.radians(angle)) @ transform[:3, :3]
        if scaled and factor > 0:
            transform[:3, :3] *= factor
        self._edit(item, "transform", (moved or turned or scaled, transform))

    # ---- lights and cameras -------------------------------------------------------------------------

    def _light(self, light: Light) -> None:
        """The fields of a light of any kind."""
        for field in light._names:
            edit = self._field(light, field)
            if edit is not None:
                self._edit(light, field, edit)
            if field == "color":
                imgui.same_line()
                self._temperature(light)
        if hasattr(light, "lumens"):
            imgui.text_disabled(f"{light.lumens:.4g} lm")

    def _field(self, light: Any, field: str) -> tuple[bool, Any] | None:
        """The widget of a field, and what it returned; None for a field that has no widget."""
        value = getattr(light, field)
        label = field.replace("_", " ")
        # The intensity of an environment isn't in candela: it scales a radiance.
        if field in UNITS and not isinstance(light, EnvironmentLight):
            label = f"{label} ({UNITS[field]})"
        if field == "color":
            return color("color", value)
        if isinstance(value, bool):
            edited = as_edit(imgui.checkbox(label, value))
            if field == "blocks_light":
                hint("The lamp's own sphere stops light. What the lamp lights casts shadows either way.")
            return edited
        if field in OPTIONAL:
            return _optional_number(label, value, OPTIONAL[field])
        if field.endswith("_angle") or field == "angular_diameter":
            changed, degrees = imgui.drag_float(label, math.degrees(value), 0.1, 0.0, 180.0, "%.2f deg")
            return changed, math.radians(degrees)
        if np.shape(value) == (3,):
            return as_edit(imgui.drag_float3(label, value.tolist(), 0.01, format="%.4g"))
        if isinstance(value, float):
            return drag(label, value, 0.0, 1e15)
        return None

    def _temperature(self, light: Any) -> None:
        """A list of light sources by their temperature, which makes the color."""
        if imgui.small_button("K"):
            imgui.open_popup("temperature")
        hint("The color of a black body.")
        if imgui.begin_popup("temperature"):
            for name, temperature in TEMPERATURES.items():
                if imgui.menu_item_simple(f"{name}, {temperature} K"):
                    self._session.edit(light, color=kelvin(temperature))
            imgui.end_popup()

    def _camera(self, camera: Camera) -> None:
        if imgui.button("look through it"):
            self._session.camera_control.look_through(camera)
            self._session.pictures.cut()
        imgui.same_line()
        if imgui.button("set to the view"):
            view = self._session.camera
            self._session.edit(camera, transform=view.transform, vertical_fov=view.vertical_fov)
        self._transform(camera)
        changed, degrees = imgui.drag_float("field of view", math.degrees(camera.vertical_fov), 0.2, 1, 170, "%.1f deg")
        self._edit(camera, "vertical_fov", (changed, math.radians(degrees)))
        for field, low, high in (("ev100", -20.0, 30.0), ("aperture", 0.0, 1.0), ("focus_distance", 1e-6, 1e6)):
            self._edit(camera, field, drag(field.replace("_", " "), getattr(camera, field), low, high))


def users_of(scene: Scene, instance: Instance) -> int:
    """The number of instances that have an instance's material."""
    return sum(other.material is instance.material for other in scene.instances)


def _optional_number(label: str, value: float | None, default: float) -> tuple[bool, float | None]:
    """A number that can be switched off. default: what it is when it is switched on."""
    switched, on = imgui.checkbox(f"##{label}", value is not None)
    # ## makes a label that isn't shown: the checkbox stands before the number's own.
    imgui.same_line()
    edited, number = drag(label, default if value is None else value, 1e-4, 1e9)
    return bool(switched or (edited and on)), number if on else None
