"""Labels of instances: by patterns of names, and from files."""

from __future__ import annotations

import json

import pytest

import solari_vk as sv
from solari_vk.scene import shapes


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


@pytest.mark.parametrize(("extras", "label"), [
    ({"label": "chair"}, "chair"),
    ({"label": "chair", "solari_vk": {"label": "seat"}}, "seat"),
    ({"label": 3}, ""),
    (3, ""),
])  # fmt: skip
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
