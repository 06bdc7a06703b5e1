"""A scene as it was, to which it returns."""

from __future__ import annotations

from solari_vk.base.errors import SolariError
from solari_vk.scene.model import Scene
from solari_vk.scene.observed import Checked


class Snapshot:
    """The fields of a scene's instances, meshes, materials and lights."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._members = list(scene.instances), list(scene.lights)
        objects: list[Checked] = [*scene.instances, *scene.meshes, *scene.materials, *scene.lights]
        self._fields = [(item, {name: getattr(item, name) for name in type(item)._names}) for item in objects]

    def check_members(self, who: str) -> None:
        """Raise SolariError if instances or lights were added or removed."""
        if (list(self._scene.instances), list(self._scene.lights)) != self._members:
            raise SolariError(
                f"{who}: adds or removes instances or lights: add them in prepare(scene), and change "
                "their visible or intensity here"
            )

    def restore(self) -> None:
        """Give all fields the values that they had, and take away what was added."""
        instances, lights = self._members
        if list(self._scene.instances) != instances:
            self._scene.instances.clear()
            for instance in instances:
                self._scene.instances.add(instance)
        if list(self._scene.lights) != lights:
            self._scene.lights.clear()
            for light in lights:
                self._scene.lights.add(light)
        for item, fields in self._fields:
            changed = {name: value for name, value in fields.items() if getattr(item, name) is not value}
            if changed:
                item.update(**changed)
