"""Groups, and what `Scene.add` makes of files, other scenes and meshes of trimesh."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.matrices import rotation

BOX = sv.shapes.box()


def test_what_is_in_a_group_moves_with_it():
    scene = sv.Scene()
    wheel, cabin = scene.add(BOX, position=(1, 0, 0), name="wheel"), sv.Instance(BOX, position=(0, 1, 0))
    lamp = sv.SpotLight((2, 0, 0), (1, 0, 0))
    sun = sv.DirectionalLight((1, 0, 0))
    camera = sv.Camera()
    wheels = scene.group("wheel")
    car = scene.group(wheels, cabin, lamp, sun, camera, name="car")
    assert set(scene.instances) == {wheel, cabin}
    assert set(scene.lights) == {lamp, sun}
    wheels.position = (0, 0, 1)
    car.update(position=(0, 0, 5), rotation=rotation((0, 1, 0), np.pi / 2), scale=2)
    np.testing.assert_allclose(wheel.position, (2, 0, 3), atol=1e-6)
    np.testing.assert_allclose(wheels.position, (2, 0, 5), atol=1e-6)
    np.testing.assert_allclose(cabin.position, (0, 2, 5), atol=1e-6)
    np.testing.assert_allclose(lamp.position, (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose([lamp.direction, sun.direction], [(0, 0, -1)] * 2, atol=1e-6)
    np.testing.assert_allclose(camera.transform[:3, 3], (0, 0, 5))
    wheel.position = (0, 0, 0)
    car.position = (0, 0, 6)
    np.testing.assert_allclose(wheel.position, (0, 0, 1), atol=1e-12)
    scene.remove(car)
    assert not len(scene.instances) + len(scene.lights) + len(scene.cameras)


def test_the_origin_of_a_group_is_a_pivot():
    door = sv.Instance(BOX, position=(1, 0, 0))
    hinge = sv.Group([door], position=(0.5, 0, 0))
    hinge.rotation = np.pi
    np.testing.assert_allclose(door.position, (0, 0, 0), atol=1e-12)


def test_groups_turn_and_slide_from_where_they_were_made():
    box = sv.Instance(BOX, position=(1, 0, 0))
    joint = sv.Group([box], rotation=rotation((0, 1, 0), np.pi / 2), scale=2)  # its z axis is x
    arm = sv.Group([joint])
    joint.slide(0.5)
    joint.turn(1)
    arm.position = (0, 3, 0)  # what carries the joint may move
    joint.slide(2)
    joint.turn(np.pi / 2)
    np.testing.assert_allclose(box.position, (3, 3, 0), atol=1e-12)
    np.testing.assert_allclose(box.rotation, rotation((1, 0, 0), np.pi / 2), atol=1e-12)
    joint.turn(0)
    joint.slide(0)
    np.testing.assert_allclose(box.transform, sv.Instance(BOX, position=(1, 3, 0)).transform, atol=1e-12)
    for wrong in (np.nan, "a", None):
        with pytest.raises(sv.SolariError, match="turn: radians"):
            joint.turn(wrong)


def test_what_is_twice_in_a_group_moves_once_and_cameras_keep_their_size():
    box, camera = sv.Instance(BOX), sv.Camera(position=(0, 0, 3))
    inner = sv.Group([box])
    outer = sv.Group([inner, box, camera])
    outer.update(position=(1, 0, 0), scale=2)
    assert outer.items == [box, camera]
    np.testing.assert_array_equal(box.position, inner.position)
    np.testing.assert_allclose(camera.transform, sv.Camera(position=(1, 0, 6)).transform, atol=1e-12)
    with pytest.raises(sv.SolariError, match="can't be in itself"):
        inner.add(outer)


def test_scenes_files_and_meshes_of_trimesh_are_added(writer):
    trimesh = pytest.importorskip("trimesh")
    writer.node(mesh=writer.mesh())
    writer.save(writer.path)
    scene, kit = sv.Scene(), sv.Scene(sv.Instance(BOX, name="a"), sv.Instance(BOX, name="b"), sv.PointLight((1, 0, 0)))
    kit.environment, kit.camera = sv.Environment(1.0), sv.Camera()
    for number in range(2):
        pair = scene.add(kit, position=(number, 0, 0), name=f"pair {number}")
    assert scene.instances.names == ["pair 0/a", "pair 0/b", "pair 1/a", "pair 1/b"]
    assert scene.environment is None
    assert [item.position[0] for item in pair] == [1, 1, 2]
    assert kit.instances[0].position[0] == 0
    assert scene.meshes[0] is kit.meshes[0]
    single = scene.add(writer.path, name="leaf", scale=3)
    assert next(iter(single)) is scene.instances["leaf"]
    np.testing.assert_array_equal(scene.instances["leaf"].scale, 3)
    names = [scene.add(writer.path).name for _ in range(2)]
    stem = writer.path.stem
    assert names == [stem, f"{stem} 2"]
    writer.json["scenes"][0]["name"] = "Scene"  # which Blender calls every scene
    writer.save(writer.path)
    assert scene.add(writer.path).name == f"{stem} 3"
    red = sv.Material(base_color=(1, 0, 0))
    made = scene.add(trimesh.creation.box(), red, (1, 2, 3), name="box")
    assert (made.material, made.position.tolist()) == (red, [1, 2, 3])


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda s: s.group(sv.Environment(1.0)), "a group holds instances, .*, not Environment"),
        (lambda s: s.add(sv.Camera(), position=(1, 2, 3)), "are given with a mesh, a file or a"),
        (lambda s: s.add(sv.Scene(), sv.Material()), "material with a mesh only"),
        (lambda s: s.add("nothing.glb"), "nothing.glb: there is no such file"),
        (lambda s: s.group("wall"), "there is no object 'wall'; there are none"),
        (lambda s: s.group().update(place=1), "Group has no field 'place'; .*there are transform, position, rotation"),
        (lambda s: setattr(s.group(), "opacity", False), "Group has no field 'opacity'"),
        (lambda s: s.group(scale=np.inf), "scale must be finite"),
        (lambda s: s.add(sv.Scene(), position=3), "Group: position must have the shape"),
    ],
)
def test_refused_groups(use, message):
    scene = sv.Scene()
    with pytest.raises(sv.SolariError, match=message):
        use(scene)
    assert not scene.instances


def test_labels_are_those_of_all_instances():
    first, second = sv.Instance(BOX, label="car"), sv.Instance(BOX, label="car")
    group = sv.Group([first, sv.PointLight((0, 1, 0)), sv.Group([second])])
    assert (group.label, group.part_of) == ("car", "")
    group.update(label="van", part_of="van 1", position=(1, 0, 0))
    assert [(one.label, one.part_of, one.position[0]) for one in (first, second)] == [("van", "van 1", 1)] * 2
    first.label = "door"
    assert group.label == ""
    group.transform = [[0.1, 0.2, 0, 1], [-0.2, 0.1, 0, 0], [0, 0, 1, 0]]
    before = first.transform
    group.label = "van"
    assert first.transform is before
    with pytest.raises(sv.SolariError, match="Group: label must be one line"):
        group.label = "a\nb"


def test_nothing_moves_or_goes_unless_all_can():
    """A lamp may be that far away, a box may not. Then the box is removed before its group."""
    box, lamp = sv.Instance(BOX), sv.PointLight((1, 0, 0))
    scene = sv.Scene()
    group = scene.group(lamp, box)
    with pytest.raises(sv.SolariError, match="transform must lie within"):
        group.scale = 1e13
    np.testing.assert_array_equal(group.transform, np.eye(4))
    np.testing.assert_array_equal(box.transform, np.eye(4))
    np.testing.assert_array_equal(lamp.position, (1, 0, 0))
    scene.remove(box)
    with pytest.raises(sv.SolariError, match="Instance"):
        scene.remove(group)
    assert list(scene.lights) == [lamp]


def test_an_added_scene_leaves_its_sky_and_sun():
    source, scene = sv.Scene(sv.PointLight((0, 1, 0))), sv.Scene()
    source.environment = sv.Sky()
    scene.add(source)
    assert [type(light) for light in scene.lights] == [sv.PointLight]


def test_groups_are_made_of_names_and_listed():
    scene = sv.Scene()
    for thing in (sv.Instance(BOX, name="box"), sv.PointLight((0, 3, 0), name="lamp"), sv.Camera(name="eye")):
        scene.add(thing)
    inner = scene.group("lamp", "eye", name="inner")
    outer = scene.group("inner", "box", name="outer")
    assert inner.items == [scene.lights["lamp"], scene.cameras["eye"]]
    assert list(outer) == [inner, scene.instances["box"]]
    assert scene.groups.names == ["inner", "outer"]
    assert scene.groups["outer"] is outer
    scene.remove("inner")
    assert scene.groups.names == ["outer"]
    scene.remove("box")
    assert not scene.groups


@pytest.mark.parametrize(
    "use",
    [
        lambda scene, box: scene.add(BOX, parent=box),
        lambda scene, box: scene.add(sv.Instance(BOX), parent=box),
        lambda scene, box: box.parent,
        lambda scene, box: setattr(sv.PointLight((0, 1, 0)), "parent", box),
        lambda scene, box: scene.group(box).update(part_of=box),
        lambda scene, box: box.update(part_of=scene.group(box)),
    ],
)
def test_parents_lead_to_groups(use):
    scene = sv.Scene(sv.Instance(BOX))
    with pytest.raises((sv.SolariError, AttributeError), match=r"scene\.group\("):
        use(scene, scene.instances[0])


def test_a_group_hides_its_objects_and_a_scene_finds_by_name():
    scene = sv.Scene()
    group = scene.group(*(scene.add(sv.shapes.box(), name=name) for name in ("left", "right")), name="pair")
    assert scene["pair"] is group
    assert scene["right"] is scene[1]
    group.visible = False
    assert not any(item.visible for item in scene)
    scene["left"].visible = True
    assert group.visible
    with pytest.raises(sv.SolariError, match="there is no object 'lefty'; did you mean 'left'"):
        scene["lefty"]
