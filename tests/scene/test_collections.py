"""The scene as scripts use it: collections, the default camera, bounds, meshes and materials in one line."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Mesh, Scene, Texture, TextureImage

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


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("wal", r"there is no instance 'wal'; did you mean 'wall'\? there are floor, wall"),
        ("x", "there is no instance 'x'; there are floor, wall"),
        (2, "there is no instance 2: the scene has 2, 0 to 1"),
        (-3, "there is no instance -3: the scene has 2"),
        (0.5, "index by a whole number, a slice or a name, not 0.5"),
    ],
)
def test_unknown_keys_are_refused(key, message):
    scene = scene_of("floor", "wall")
    with pytest.raises(SolariError, match=message):
        _ = scene.instances[key]
    with pytest.raises(SolariError, match="there is no light 0: the scene has 0"):
        _ = scene.lights[0]
    with pytest.raises(SolariError, match="there is no camera 'x'; there are none"):
        _ = scene.cameras["x"]


def test_scenes_hold_objects_in_order_and_notify_watchers():
    seen = []

    class Watcher:
        def note(self, changed):
            seen.append(changed)

    watcher, scene = Watcher(), scene_of("floor", "wall")
    scene.watch(watcher)
    floor, wall = scene
    sun, camera = DirectionalLight(direction=[0, -1, 0]), Camera()
    assert scene.add(sun) is sun
    scene.add(camera)
    assert (list(scene.lights), list(scene.cameras), scene.camera) == ([sun], [camera], camera)
    scene.instances.remove(floor)
    scene.instances.add(floor)
    assert list(scene) == [wall, floor]
    del scene.instances["wall"]
    scene.remove(camera)
    assert seen == [sun, camera, floor, floor, wall, camera]
    scene.instances.remove(0)
    assert not scene.instances
    scene.add(wall)
    scene.remove("wall")
    scene.lights.clear()
    assert seen[-3:] == [wall, wall, sun]
    assert not scene.lights
    for item in scene_of(*"abc"):
        scene.add(item)
    for item in scene.instances:  # a loop may remove what it goes over
        scene.remove(item)
    assert not scene.instances


def test_scenes_refuse_what_they_can_not_hold():
    scene = scene_of("box")
    box = scene.instances[0]
    with pytest.raises(SolariError, match="Instance 'box' is in the scene already"):
        scene.add(box)
    scene.remove(box)
    with pytest.raises(SolariError, match="Instance 'box' is not in the scene"):
        scene.remove(box)
    with pytest.raises(SolariError, match=r"there is no object 'boxy'; did you mean 'box'\? there are box, sun"):
        scene_of("box", "sun").remove("boxy")
    with pytest.raises(SolariError, match="a light is needed, not Camera"):
        scene.lights.add(Camera())
    with pytest.raises(SolariError, match="holds instances, lights and cameras, not Material"):
        scene.add(Material())
    with pytest.raises(SolariError, match="no visible instance"):
        _ = scene.bounds


def test_collections_cannot_be_replaced_or_misspelt():
    scene = scene_of("floor")
    with pytest.raises(SolariError, match=r"Scene.instances can't be replaced: use scene.instances.add"):
        scene.instances = []
    with pytest.raises(SolariError, match=r"Scene has no field 'weather'; there are name, camera"):
        scene.weather = 1
    with pytest.raises(SolariError, match="a camera can't be replaced by assigning to 0: change its fields"):
        scene.cameras[0] = Camera()
    with pytest.raises(SolariError, match="assign another one to the instances that use it"):
        scene.materials["paint of floor"] = Material()
    assert not hasattr(scene.materials, "add"), "materials come with the instances that use them"


def test_materials_and_meshes_are_those_of_the_instances():
    scene = builtin("cornell_box")
    assert scene.materials.names == ["white", "red", "green", "block", "lamp"]
    assert scene.materials["red"] is scene.instances["left wall"].material
    assert len(scene.meshes) == 6
    scene.remove(scene.instances["left wall"])
    assert "red" not in scene.materials


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
    with pytest.raises(SolariError, match="camera must be a Camera, not int"):
        first.camera = 1
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
    with pytest.raises(SolariError, match="given with a mesh only"):
        scene.add(Camera(), paint)
    assert placed.mesh.triangles.tolist() == placed.mesh.faces.tolist() == [[0, 1, 2], [2, 1, 0]]


def test_default_triangles_follow_the_positions():
    mesh = Mesh(TRIANGLE)
    mesh.positions = TRIANGLE * 2
    assert mesh.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(SolariError, match="normals has 3 rows for 9 positions"):
        mesh.update(positions=TRIANGLE * 3, normals=TRIANGLE)
    assert (len(mesh.positions), len(mesh.triangles)) == (6, 2)
    mesh.update(triangles=[[0, 1, 5]])
    mesh.positions = TRIANGLE * 3
    assert mesh.triangles.tolist() == [[0, 1, 5]]
    mesh.triangles = None
    assert len(mesh.triangles) == 3


def test_a_mesh_from_trimesh():
    trimesh = pytest.importorskip("trimesh")
    with pytest.raises(SolariError, match=r"a trimesh.Trimesh is needed, not Scene; trimesh.Scene.to_mesh"):
        Mesh.from_trimesh(trimesh.Scene())
    ball = trimesh.creation.icosphere(subdivisions=1)
    flat, smooth = Mesh.from_trimesh(ball), Mesh.from_trimesh(ball, smooth=True)
    np.testing.assert_allclose(flat.positions, ball.vertices, atol=1e-6)
    assert flat.triangles.tolist() == ball.faces.tolist()
    assert flat.normals is None
    np.testing.assert_allclose(smooth.normals, smooth.positions, atol=0.05)
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 0.25]])
    found = Mesh.from_trimesh(trimesh.Trimesh(TRIANGLE, [[0, 1, 2]], visual=visual, process=False))
    assert found.uvs.tolist() == [[0, 1], [1, 1], [0, 0.75]]


def test_roughness_has_two_names():
    material = Material(roughness=0.3)
    assert material.perceptual_roughness == material.roughness == 0.3
    material.roughness = 0.4
    material.update(roughness=0.5)
    assert material.perceptual_roughness == 0.5
    with pytest.raises(SolariError, match="roughness and perceptual_roughness name the same field: give one"):
        Material(roughness=0.3, perceptual_roughness=0.3)
    with pytest.raises(SolariError, match="Mesh: indices and faces name the same field"):
        Mesh(TRIANGLE, indices=[[0, 1, 2]], faces=[[0, 1, 2]])
    with pytest.raises(SolariError, match="perceptual_roughness must be a finite number between 0 and 1"):
        material.roughness = 2


def test_textures_are_made_of_pixels():
    gray = np.full((2, 3), 7, np.uint8)
    material = Material(base_color_texture=gray, normal_texture=TextureImage(np.zeros((1, 1, 3), np.uint8)))
    assert isinstance(material.base_color_texture, Texture)
    assert material.base_color_texture.image.pixels.tolist() == [[[7, 7, 7, 255]] * 3] * 2
    with pytest.raises(SolariError, match="pixels must be integers, not float64: give 8-bit pixels"):
        material.base_color_texture = np.ones((2, 2, 3))


def test_positions_stand_for_transforms():
    assert Camera(transform=(0, 1, 5)).transform.tolist() == [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 5], [0, 0, 0, 1]]
    assert DirectionalLight((0, -3, 0)).direction.tolist() == [0, -1, 0], "of any length"
