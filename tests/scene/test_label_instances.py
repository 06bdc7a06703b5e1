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
    sv.label_instances(scene, {"floor": "floor"})
    assert scene.instances["floor"].label == "floor"
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
