"""Labels of instances: by patterns of names, and from files."""

from __future__ import annotations

import json

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.objects import objects_of


def scene_of(*names):
    return sv.Scene(*(sv.Instance(shapes.box((0, 0, 0), (1, 1, 1)), name=name) for name in names))


def labels(scene):
    return [instance.label for instance in scene.instances]


def test_patterns():
    scene = scene_of("Chair.1", "Chair[1]", "Desk", "Lamp")
    scene.instances[3].label = "light"
    sv.label_instances(scene, {"Chair[1]": "seat", "Chair*": "chair", "D?sk": "table"})
    assert labels(scene) == ["chair", "seat", "table", "light"]
    with pytest.raises(sv.SolariError, match=r"no instance is named 'Sofa\*'; names are 'Chair.1', 'Chair\[1\]'"):
        sv.label_instances(scene, {"Desk": "desk", "Sofa*": "sofa"})
    with pytest.raises(sv.SolariError, match=r"a class must be one line of printable characters, not 'a\\nb'"):
        sv.label_instances(scene, {"Desk": "a\nb"})
    assert labels(scene)[2] == "table", "nothing changes with a wrong pattern or class"


def test_classes_may_name_the_object():
    scene = scene_of("car/body", "car/door", "tree")
    sv.studio_lights(scene)
    sv.label_instances(scene, {"car/*": {"label": "car", "part_of": "car 1"}, "*": "thing"})
    assert labels(scene) == ["car", "car", "thing", ""], "a pattern doesn't mean the studio's floor"
    assert [one.part_of for one in scene.instances] == ["car 1", "car 1", "", ""]
    sv.label_instances(scene, {"floor": "floor", "tree": None})
    assert scene.instances["floor"].label == "floor"
    assert not scene.instances["tree"].label
    for wrong in ({"part_of": "car"}, {"label": "car", "parts": "x"}, 3):
        with pytest.raises(sv.SolariError, match=r"labels: ('tree': give a class, or|give a class for each)"):
            sv.label_instances(scene, {"tree": wrong})


@pytest.mark.parametrize(
    ("extras", "label"),
    [
        ({"label": "chair"}, "chair"),
        ({"label": "chair", "solari_vk": {"label": "seat"}}, "seat"),
        ({"label": 3}, ""),
        (3, ""),
    ],
)
def test_files(tmp_path, extras, label):
    path = tmp_path / "scene.gltf"
    scene_of("a").save(path)
    content = json.loads(path.read_text())
    content["nodes"][0]["extras"] = extras
    path.write_text(json.dumps(content))
    loaded = sv.load(path)
    assert labels(loaded) == [label]
    wrong = [line for line in loaded.warnings if "label must be a string, not int" in line]
    assert len(wrong) == (extras == {"label": 3})
    loaded.save(path)
    assert labels(sv.load(path)) == [label]


ROOMS = ({0: "ball", 1: "can"}, {0: "bottle", 1: "can"})


@pytest.fixture
def chairs(tmp_path):
    """A file with two nodes of a mesh of two primitives."""
    path = tmp_path / "chairs.gltf"
    sv.Scene(sv.Instance(shapes.box(), name="a"), sv.Instance(shapes.sphere(), name="b")).save(path)
    content = json.loads(path.read_text())
    content["meshes"][0]["primitives"] += content["meshes"].pop()["primitives"]
    content["nodes"] = [{"mesh": 0, "name": "chair", "translation": [5 * n, 0, 0]} for n in range(2)]
    path.write_text(json.dumps(content))
    return path


def test_primitives_are_parts_of_an_object(chairs, tmp_path):
    """Of one for each node, and each time that the file is added; saved scenes keep them."""
    scene = sv.load(chairs)
    assert [one.name for one in scene.instances] == ["chair/0", "chair/1"] * 2
    assert [one.part_of for one in scene.instances] == ["chair"] * 2 + ["chair 2"] * 2
    scene.save(tmp_path / "again.glb")
    assert [one.part_of for one in sv.load(tmp_path / "again.glb").instances] == ["chair"] * 2 + ["chair 2"] * 2
    several = sv.Scene()
    for name in ("", "", "b"):
        several.add(chairs, name=name)
    assert list(objects_of(dict(enumerate(several.instances)))) == [0, 2, 4, 6, 8, 10]
    assert several.instances[8].part_of == "b/chair"


def test_parts_with_one_label_have_one_annotation(chairs):
    scene = sv.load(chairs)
    numbered = dict(enumerate(scene.instances))
    ids = np.array([[0, 1, 2, 9], [0, 1, 3, 3]], np.uint32)
    for classes, expected in (
        ({"chair": "chair", "chair 2": "chair"}, [(0, 4), (2, 3)]),
        ({"chair/0": "seat", "chair/1": "back"}, [(0, 2), (1, 2), (2, 1), (3, 2)]),
    ):
        sv.label_instances(scene, classes)
        labelled = {number: instance.label for number, instance in numbered.items()}
        annotations = sv.Annotations(labelled, objects=objects_of(numbered, labelled))
        coco = annotations.coco([("a.png", ids)])
        assert [(one["instance_id"], one["area"]) for one in coco["annotations"]] == expected
        assert annotations.yolo(ids).count("\n") == len(expected)
        assert coco["annotations"][0]["bbox"] == [0, 0, 3 - len(expected) // 2, 2]


def test_classes_have_one_number_in_all_scenes():
    """A class is a list's place, whatever a scene holds; data sets of other lists are merged by the names."""
    picture = np.array([[0, 0, 1, 1]], np.uint32)
    classes = ["can", "ball", "bottle"]
    rooms = [sv.Annotations(labels, classes=classes) for labels in ({0: "ball", 1: "can"}, {0: "bottle", 1: "can"}, {})]
    found = [room.coco([(f"{number}.png", picture)]) for number, room in enumerate(rooms)]
    assert [one["categories"] for one in found] == [found[0]["categories"]] * 3
    assert [[one["category_id"] for one in room["annotations"]] for room in found] == [[2, 1], [3, 1], []]
    assert [room.yolo(picture).split()[::5] for room in rooms] == [["1", "0"], ["2", "0"], []]
    own = [sv.Annotations(labels).coco([(f"{name}.png", picture)]) for name, labels in zip("ab", ROOMS, strict=True)]
    merged = sv.merge_coco(own)
    names = {category["id"]: category["name"] for category in merged["categories"]}
    files = {image["id"]: image["file_name"] for image in merged["images"]}
    assert [(files[one["image_id"]], names[one["category_id"]]) for one in merged["annotations"]] == [
        ("a.png", "ball"), ("a.png", "can"), ("b.png", "bottle"), ("b.png", "can"),
    ]  # fmt: skip
    for items in merged.values():
        assert [item["id"] for item in items] == list(range(1, len(items) + 1))
    for wrong, words in (
        (lambda: sv.Annotations({0: "cup"}, classes=classes), "classes lack the label 'cup'"),
        (lambda: sv.Annotations({}, classes=["a", "a"]), "names one twice"),
        (lambda: sv.Annotations({}, classes=5), "classes is a list of names"),
        (lambda: sv.merge_coco([own[0], own[0]]), "two pictures are called 'a.png'"),
        (lambda: sv.merge_coco(5), "parts is a list of data sets"),
        (lambda: sv.merge_coco([{"images": []}]), "part 0 isn't in COCO's format"),
    ):
        with pytest.raises(sv.SolariError, match=words):
            wrong()


def test_objects_of_bop_have_one_number_in_all_scenes(tmp_path):
    """Whatever a scene holds, and wherever it lies there."""
    ball, box, cone = sv.shapes.sphere(0.1, 8), sv.shapes.box(), sv.shapes.cone()
    for scene_id, meshes in enumerate(([ball, box], [cone, box], [cone, ball])):
        instances = {n: sv.Instance(mesh, position=(n, scene_id, 0), label=mesh.name) for n, mesh in enumerate(meshes)}
        sv.BopWriter(tmp_path, instances, scene_id=scene_id).finish()
        known = json.loads((tmp_path / "objects.json").read_text())
        assert [known[number]["label"] for number in sorted(known)] == ["sphere", "box", "cone"][: 2 + (scene_id > 0)]
    assert len(list((tmp_path / "models").glob("*.ply"))) == len(known) == 3


def test_labels_change_no_picture(device):
    """A picture that was rendered stays, since labels and names aren't seen."""
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (8, 8)) as tracer:
        tracer.render(samples=2)
        sv.label_instances(scene, {"*": "thing"})
        scene.instances[0].name = "another"
        traced = []
        tracer.render(samples=2, progress=traced.append)
    assert not traced
