"""The scene as scripts use it: collections, the default camera, bounds, and meshes added in one line."""

from __future__ import annotations

import operator

import numpy as np
import pytest

from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Mesh, Scene

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def scene_of(*names):
    return Scene(*(Instance(Mesh(TRIANGLE), Material(name=f"paint of {name}"), name=name) for name in names))


def test_items_by_number_and_by_name():
    scene = scene_of("floor", "wall", "wall", "lamp")
    items = scene.instances
    assert (len(items), items.names) == (4, ["floor", "wall", "wall", "lamp"])
    assert items[0] is items["floor"] is next(iter(items))
    assert items[-1] is items[np.int64(3)] is items["lamp"]
    assert items["wall"] is items[1], "the first of several objects with this name"
    assert items[1:3] == [items[1], items[2]]
    assert items[2] in items
    assert "lamp" in items
    assert "roof" not in items
    assert Instance(Mesh(TRIANGLE)) not in items
    assert repr(items[:1]) == repr([items[0]])
    assert "Instance 'floor', Instance 'wall'" in repr(items)


def test_scenes_hold_objects_in_order_and_notify_watchers():
    seen = []

    class Watcher:
        mark_changed = staticmethod(seen.append)

    watcher, scene = Watcher(), scene_of("floor", "wall")
    scene.watch(watcher)
    floor, wall = scene
    sun, camera = DirectionalLight(direction=[0, -3, 0]), Camera()
    assert scene.add(sun) is sun
    scene.add(camera)
    assert (list(scene.lights), list(scene.cameras), scene.camera) == ([sun], [camera], camera)
    scene.instances.remove(floor)
    scene.instances.add(floor)
    assert list(scene) == [wall, floor]
    del scene.instances["wall"]
    scene.remove(camera)
    scene.instances.remove(0)
    scene.add(wall)
    scene.remove("wall")
    scene.lights.clear()
    assert not scene.instances
    assert not scene.lights
    assert seen == [sun, camera, floor, floor, wall, camera, floor, wall, wall, sun]
    for item in scene_of(*"abc"):
        scene.add(item)
    for item in scene.instances:  # a loop may remove what it goes over
        scene.remove(item)
    assert not scene.instances


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.instances["wal"], r"there is no instance 'wal'; did you mean 'wall'\? there are floor, wall"),
        (lambda s: s.instances["x"], "there is no instance 'x'; there are floor, wall"),
        (lambda s: s.instances[2], "there is no instance 2: the scene has 2, 0 to 1"),
        (lambda s: s.instances[-3], "there is no instance -3: the scene has 2"),
        (lambda s: s.instances[0.5], "index by a whole number, a slice or a name, not 0.5"),
        (lambda s: s.lights[0], "there is no light 0: the scene has 0"),
        (lambda s: s.cameras["x"], "there is no camera 'x'; there are none"),
        (lambda s: s.add(s.instances[0]), "Instance 'floor' is in the scene already"),
        (lambda s: s.remove(scene_of("box").instances[0]), "Instance 'box' is not in the scene"),
        (lambda s: s.remove("flor"), r"there is no object 'flor'; did you mean 'floor'\? there are floor, wall"),
        (lambda s: s.lights.add(Camera()), "a light is needed, not Camera"),
        (lambda s: s.add(Material()), "holds instances, lights and cameras, not Material"),
        (lambda s: s.add(Camera(), Material()), "material with a mesh only"),
        (lambda s: Scene().bounds, "no visible instance"),
        (lambda s: setattr(s, "instances", []), "Scene.instances can't be replaced: use scene.instances.add"),
        (lambda s: setattr(s, "weather", 1), "Scene has no field 'weather'; there are name, camera"),
        (lambda s: setattr(s, "camera", 1), "camera must be a Camera, not int"),
        (lambda s: operator.setitem(s.cameras, 0, Camera()), "a camera can't be replaced by assigning to 0: change it"),
        (lambda s: operator.setitem(s.materials, "paint of wall", Material()), "assign another one to the instances"),
    ],
)
def test_wrong_uses_are_refused(call, message):
    scene = scene_of("floor", "wall")
    with pytest.raises(SolariError, match=message):
        call(scene)
    assert scene.instances.names == ["floor", "wall"]


def test_materials_and_meshes_are_those_of_the_instances():
    scene = builtin("cornell_box")
    assert scene.materials.names == ["white", "red", "green", "block", "lamp"]
    assert scene.materials["red"] is scene.instances["left wall"].material
    assert len(scene.meshes) == 6
    scene.remove(scene.instances["left wall"])
    assert "red" not in scene.materials
    assert not hasattr(scene.materials, "add"), "materials come with the instances that use them"


def test_the_default_camera():
    scene = scene_of("floor")
    found = scene.camera
    assert found is scene.camera, "always the same object, so that changes to it are kept"
    assert not scene.cameras
    wide = scene_of("floor").camera_for(0.1)
    assert (wide.transform != found.transform).any()
    first = Scene(Camera(name="first"), Camera(name="second"))
    assert first.camera.name == "first"
    first.camera = first.cameras["second"]
    assert first.camera_for(2.0).name == "second"
    assert Scene().camera.transform.tolist() == np.eye(4).tolist()


def test_bounds():
    turned = np.array([[0, -2, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    mesh, far = Mesh(TRIANGLE), turned * 9 - 8 * np.diag([0, 0, 0, 1])
    scene = Scene(Instance(mesh, transform=turned), Instance(mesh, visible=False, transform=far))
    assert np.array(scene.bounds).tolist() == [[3, 0, 0], [5, 1, 0]]
    assert (scene.bounds.min.tolist(), scene.bounds.max.tolist()) == ([3, 0, 0], [5, 1, 0])
    bounds = Scene(Instance(shapes.box((0, 0, 0), (2, 4, 4)))).bounds
    assert (bounds.center.tolist(), bounds.size.tolist(), bounds.radius) == ([1, 2, 2], [2, 4, 4], 3)
    assert bounds.corners.shape == (8, 3)


def test_a_mesh_with_a_material_at_a_place_in_one_line():
    scene, paint = Scene(), Material(roughness=0.2)
    placed = scene.add(Mesh(TRIANGLE, [[0, 1, 2], [2, 1, 0]]), paint, (1, 2, 3), name="leaf")
    assert scene.instances["leaf"] is placed
    assert (placed.material, placed.transform[:3, 3].tolist()) == (paint, [1, 2, 3])
    assert scene.add(Mesh(TRIANGLE)).material.name == ""
    assert placed.mesh.triangles.tolist() == placed.mesh.faces.tolist() == [[0, 1, 2], [2, 1, 0]]


def test_scenes_in_words():
    assert repr(builtin("cornell_box")) == "<Scene 'cornell_box': 6 instances, 1 camera>"
    assert repr(Scene()) == "<Scene: empty>"
