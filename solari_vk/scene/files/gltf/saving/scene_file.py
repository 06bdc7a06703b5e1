"""A scene into a glTF 2.0 file: `save_gltf`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from solari_vk.base.files import check_writable, followed
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.files.formats import writes
from solari_vk.scene.files.gltf.materials import VARIANTS
from solari_vk.scene.files.gltf.saving.clips import RigNodes
from solari_vk.scene.files.gltf.saving.content import Content, data_path_of
from solari_vk.scene.files.gltf.saving.nodes import Nodes, node_extras
from solari_vk.scene.files.gltf.saving.shapes import Shapes, Variants
from solari_vk.scene.files.gltf.saving.skies import add_sky
from solari_vk.scene.files.gltf.saving.surfaces import Surfaces
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.objects import Instance


@writes(".glb", ".gltf")
def save_gltf(scene: Scene, path: Path) -> None:
    """`Scene.save`."""
    check_writable(path)
    if path.suffix.lower() == ".gltf":
        check_writable(data_path_of(followed(path)))
    content = Content()
    _Writer(content).add(scene)
    content.write(path)


class _Writer:
    def __init__(self, content: Content) -> None:
        self._content = content
        self._shapes = Shapes(content, Surfaces(content))
        self._nodes = Nodes(content, self._shapes)

    def add(self, scene: Scene) -> None:
        """Write a scene. Its default camera comes first, or is marked where it follows a clip."""
        variants = self._variants(scene)
        rigs = dict.fromkeys(clip.rig for clip in scene.animations)
        cameras = _cameras(scene)
        followers = {item for rig in rigs for item, *_ in rig.placed} & set(scene.cameras)
        done: set[Any] = set()
        # Readers take a file's first camera. One that follows a clip is written with its rig, and is marked there.
        if cameras and cameras[0] not in followers:
            self._nodes.camera(None, cameras[0], cameras[0].transform)
            done.add(cameras[0])
        rows: list[tuple[RigNodes, list[Animation]]] = []
        for rig in rigs:
            clips = [clip for clip in scene.animations if clip.rig is rig]
            rows.append((RigNodes(self._content, self._nodes, rig, clips, scene, variants, done), clips))
        self._add_still(scene, cameras, variants, done)
        # What clips change is stated when all of it is written.
        for rig_nodes, clips in rows:
            rig_nodes.state_properties()
            for clip in clips:
                rig_nodes.animation(clip)
        self._finish(scene)

    def _add_still(
        self, scene: Scene, cameras: list[Camera], variants: dict[Instance, Variants], done: set[Any]
    ) -> None:
        """Write the instances, cameras and lights that no clip moves. done: what is written."""
        for instance in scene.instances:
            if instance not in done:
                self._nodes.instance(
                    None,
                    instance,
                    instance.transform,
                    variants=variants.get(instance, ()),
                    visible=instance.visible,
                    extras=node_extras(scene, instance),
                )
        for camera in cameras:
            if camera not in done:
                self._nodes.camera(None, camera, camera.transform)
        for light in scene.lights:
            if light not in done and not isinstance(light, EnvironmentLight):
                self._nodes.light(None, light)

    def _finish(self, scene: Scene) -> None:
        entry: dict[str, Any] = {}
        skies = [light for light in scene.lights if isinstance(light, EnvironmentLight)]
        if skies:
            add_sky(self._content, skies[0], entry)
        # A scene of the extension has one sky.
        for other in skies[1:]:
            self._content.lose("environments after the first aren't written", other.describe())
        self._content.json["scene"] = self._content.add("scenes", name=scene.name, nodes=self._nodes.finish(), **entry)

    def _variants(self, scene: Scene) -> dict[Instance, Variants]:
        """The numbers of the variants, with the materials that each gives instances."""
        found: dict[Instance, list[Any]] = {}
        for number, materials in enumerate(scene.variants.values()):
            for instance, material in materials.items():
                # KHR_materials_variants maps materials to the numbers of variants at each primitive.
                found.setdefault(instance, []).append((number, material))
        if scene.variants:
            self._content.use(VARIANTS, {"variants": [{"name": name} for name in scene.variants]})
        return {instance: tuple(rows) for instance, rows in found.items()}


def _cameras(scene: Scene) -> list[Camera]:
    """The cameras of a scene, the default one first."""
    default = [] if scene._camera is None else [scene._camera]
    return [*dict.fromkeys([*default, *scene.cameras])]
