"""`open`: files as the command line shows them."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli.jobs import RenderOptions
from solari_vk.cli.loading import load_scene
from solari_vk.scene.files import formats


def sun_file(writer):
    """A file with a triangle and a sun."""
    writer.node(mesh=writer.mesh())
    light = {"type": "directional", "intensity": 80_000.0}
    writer.node(extensions={"KHR_lights_punctual": {"light": 0}})
    writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    writer.json["extensionsUsed"] = ["KHR_lights_punctual"]


@pytest.mark.parametrize("lit", [False, True])
def test_a_file_is_as_the_command_line_shows_it(writer, lit, capsys):
    if lit:
        sun_file(writer)
    else:
        writer.node(mesh=writer.mesh())
    writer.save(writer.path)
    scene = sv.open(writer.path)
    shown = load_scene(RenderOptions(source=str(writer.path), output="x.png"))
    assert [light.describe() for light in scene.lights] == [light.describe() for light in shown.scene.lights]
    assert len(scene.instances) == len(shown.scene.instances) == (1 if lit else 2)
    camera = scene.camera_for(640 / 360)
    np.testing.assert_array_equal(camera.transform, shown.cameras[0].transform)
    assert camera.auto_exposure == shown.auto_exposure == lit
    assert not sv.load(writer.path).camera.auto_exposure


def test_surroundings_builtin_scenes_and_what_is_no_path(writer):
    writer.node(mesh=writer.mesh())
    writer.save(writer.path)
    assert isinstance(sv.open(writer.path, environment="sky").environment, sv.Sky)
    assert not sv.open("builtin:cornell_box").camera.auto_exposure
    with pytest.raises(sv.SolariError, match="path of a file is needed, not 3"):
        sv.open(3)


def test_an_exposure_that_is_set_stays():
    camera = sv.Camera(auto_exposure=True)
    assert camera.auto_exposure
    camera.ev100 = 9
    assert (camera.ev100, camera.auto_exposure) == (9, False)


@pytest.mark.parametrize("ev100", [0, 9.5])
def test_files_keep_the_exposure_that_they_were_saved_with(writer, ev100):
    sun_file(writer)
    writer.save(writer.path)
    scene = sv.load(writer.path)
    scene.camera.ev100 = ev100
    path = writer.path.with_name("saved.glb")
    scene.save(path)
    for camera in (sv.open(path).camera, load_scene(RenderOptions(source=str(path), output="x.png")).cameras[0]):
        assert (camera.ev100, camera.auto_exposure) == (ev100, False)
    assert not load_scene(RenderOptions(source=str(path), output="x.png")).auto_exposure
    scene.camera.auto_exposure = True
    scene.save(path)
    assert sv.open(path).camera.auto_exposure


def test_a_format_registers_itself(tmp_path, monkeypatch):
    """`load`, `Scene.add` and the list of formats know a format by its own module alone."""
    known = formats.readable_suffixes()
    monkeypatch.setattr(formats, "_READERS", dict(formats._READERS))

    @formats.reads(".dots", options=("unit",), only=".dots files have a unit")
    def read_dots(path, *, strict, unit=1.0):
        return sv.Scene(sv.Instance(sv.shapes.sphere(unit)), name="dots")

    path = tmp_path / "some.DOTS"
    path.touch()
    assert formats.readable_suffixes() == (*known, ".dots")
    assert sv.load(path, unit=2.0).bounds.size[0] == pytest.approx(4)
    assert sv.Scene().add(path).name == "dots"
    with pytest.raises(sv.SolariError, match="only glTF files have scenes and variants"):
        sv.load(path, variant="red")


def test_formats_are_imported_when_a_file_is_read():
    code = "import sys, solari_vk as sv; sv.load; sv.Scene; assert not any('gltf' in name for name in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
