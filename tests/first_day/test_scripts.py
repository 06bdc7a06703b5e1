"""What a new user writes from imagination: scripts that run, and errors of the others, which lead to the answer.

The scripts in scripts.md are as they were written, but for lines of which an error message said what to write in their
place.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import other_words
from solari_vk.gpu.device.device import Device

HIT_FIELDS = ("t", "position", "primitive")
PAGE = Path(__file__).with_name("scripts.md").read_text(encoding="utf-8")
SCRIPTS = dict(re.findall(r"^## (\w+)[^\n]*\n```python\n(.*?)^```$", PAGE, re.M | re.S))
SMALLER = {
    r"\((320, ?180|320, ?240|64, ?64|3840, ?2160)\)": "(32, 24)",
    r"range\((8|12|10|20|30|32)\)": "range(2)",
    r"samples=\d+": "samples=16",
}


@pytest.mark.slow
@pytest.mark.filterwarnings("error:the picture is black", "error:.*has no light")
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_runs(lent_device, tmp_path, monkeypatch, script, asset):
    program = SCRIPTS[script]
    for name in re.findall(r"\b(trimesh|torch|imageio|matplotlib|cv2)\b", program):
        pytest.importorskip(name)
    if ".mp4" in program:
        pytest.importorskip("imageio_ffmpeg")
    for name in re.findall(r"\.\./shared/assets/(\w+)", program):
        folder = asset(name)
        (tmp_path / "shared" / "assets").mkdir(parents=True, exist_ok=True)
        (tmp_path / "shared" / "assets" / name).symlink_to(folder)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for shown, run in SMALLER.items():
        program = re.sub(shown, run, program)
    names = {"__name__": "__main__"}
    try:
        exec(compile(program, script, "exec"), names)
        if script == "s09":  # the ball is where OpenCV projects it
            assert abs(names["uv"] - (names["xs"].mean(), names["ys"].mean())).max() < 1
    finally:
        for value in names.values():
            if isinstance(value, Device):
                value.close()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("t.render(4)", "the number of samples is given by its name, samples="),
        ("t.render(t.binder.scene)", "the scene was given when the renderer was made"),
        ("t.render(samples=1).save('a.jpg', quality=50)", "a .jpg has 95"),
        ("setattr(t, 'max_bounces', 3)", "PathTracer has no attribute 'max_bounces'"),
        ("sv.PathTracer(t.device, t.binder.scene, 320, 180)", r"\(device, scene, size\) without .* not 4 .* one pair"),
        ("sv.Renderer(t.device, t.binder.scene, 320, 180)", r"not 180; .* size as one pair, \(width, height\)"),
        ("t.save('a.png')", r"tracer.render\(samples=256\).save\(path\)"),
        ("t.render(samples=1)['segmentation']", r"frame.mask\(name\) is where an object is seen"),
        (
            "sv.illuminance(t.binder.scene, (0, 1, 0), (0, 1, 0))",
            "^illuminance: the device is .* give a solari_vk.Device",
        ),
        (
            "sv.illuminance(t.device, t.binder.scene)",
            "illuminance needs points: it takes .device, scene, points, normals",
        ),
        ("t.render(samples=1).pick((1, 2))", r"pick needs y: it takes \(x, y\)"),
        ("sv.Batch(t.device, t.binder.scene, (4, 4), 1)['radiance']", 'renderer="reference" gives a batch radiance'),
    ],
)
def test_errors_of_renderers_lead_to_the_answer(device, line, message):
    with sv.PathTracer(device, sv.builtin("cornell_box"), (16, 9)) as t:
        with pytest.raises((sv.SolariError, AttributeError), match=message):
            eval(line, {"sv": sv, "np": np, "t": t})
        t.size = (8, 6)
        assert t.render(samples=1)["radiance"].shape == (6, 8, 3)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("sv.rt.trace", r"solari_vk.RayTracer\(device, scene\) traces arrays of rays"),
        ("sv.Scene().animate('Run', time=0.3)", r"no option 'time': write scene.animate\(seconds, clip\)"),
        ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), vertical_fov=60)", r"6.28319 radians \(fov takes degrees\), not 60"),
        ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), orthographic=2)", "orthographic_height is in meters"),
        ("sv.Camera.look_at((0, 1, 0), (0, 0, 1), fov=1, vertical_fov=1)", "fov is vertical_fov in degrees: give one"),
        ("sv.Camera.from_file", "Camera has no attribute 'from_file'; did you mean 'from_pose'"),
        ("sv.Camera().moved", "or call place"),
        ("sv.Material(albedo=1)", "it is called base_color here"),
        ("sv.Material(base_color_texture='none.png')", "none.png: there is no such file"),
        ("sv.shapes.sphere(r=1)", "shapes.sphere has no option 'r'; there are radius, segments"),
        ("sv.load('Fox.glb', hdri='map.hdr')", r"open\(path, environment=...\) lights a file"),
        ("sv.Material(base_color=(0.8, 0.2, 0.1, 1))", "alpha is a field of its own"),
        ("sv.DirectionalLight((1, 0.9, 0.8), 3)", r"takes \(direction\) without names, not 2 .*: illuminance="),
        ("sv.PointLight((0, 1, 0), 200)", r"takes \(position\) without names, not 2 .*: intensity="),
        ("sv.Environment(color=(1, 1, 1))", r"image takes one color too: Environment\("),
        ("sv.Camera().position.set(0, 1, 3)", r"no 'set': assign them, as in camera.position = \(x, y, z\)"),
        ("setattr(sv.Camera().position, 'y', 2)", r"no 'y': assign them, as in camera.position = \(x, y, z\)"),
        ("sv.Settings('high')", r"Settings.preset\('high'\) has the settings of a quality"),
        ("sv.Mesh(__import__('trimesh').Trimesh())", r"Mesh.from_trimesh\(mesh\) takes a mesh of trimesh"),
        ("sv.Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))", "there are no positions"),
        ("sv.Camera.from_opencv(np.eye(3))", r"give size=\(width, height\)"),
        ("setattr(sv.Scene(), 'environment', 'none.hdr')", "none.hdr: there is no such file"),
        ("setattr(sv.Scene(), 'background', (1, 1, 1))", r"Environment\(\(0.9, 0.9, 1\)\) .*backdrop is the floor"),
        ("sv.tonemap(np.ones((1, 1, 3)), ev100=3)", r"exposure=Camera\(ev100=12\).exposure"),
        ("sv.save_image(np.ones((1, 1, 3)), 'a.png')", "the path of a file comes first"),
        ("sv.label_instances(sv.Scene())", r"needs classes: it takes \(scene, classes\)"),
        (
            "sv.Material(base_color=np.zeros((4, 4, 3)))",
            "an image belongs in a field for textures, such as base_color_tex",
        ),
    ],
)
def test_errors_lead_to_the_answer(line, message):
    with pytest.raises((sv.SolariError, AttributeError), match=message):
        eval(line, {"sv": sv, "np": np})


def test_a_warning_names_the_line_of_the_user():
    with pytest.warns(UserWarning, match="a telescope's") as caught:
        sv.Camera.look_at((0, 1, 0), (0, 0, 1), fov=0.9)
    assert caught[0].filename == __file__


def test_scenes_have_as_many_objects_as_loops_over_them():
    scene = sv.builtin("cornell_box")
    assert len(scene) == len(list(scene)) == len(scene.instances)
    assert (len(sv.Scene()), bool(sv.Scene())) == (0, True)


def test_words_of_other_programs_are_answered():
    """By what they are called here; so none is ours, and what the answers name must be there."""
    for owner, words in other_words().items():
        holder = holder_of(owner)
        assert all(word == word.lower() for word in words), owner
        if isinstance(holder, type) or owner in ("solari_vk", "shapes"):
            known = {name.lower() for name in dir(holder)} | set(getattr(holder, "_names", ()))
            # Their attributes have the name.
            options_alone = {
                "PathTracer": {"samples", "outputs"},
                "Renderer": {"outputs"},
                "Camera": {"intrinsics"},
            }.get(owner, set())
            assert not known & words.keys() - options_alone, owner
            for word in words.keys() - options_alone:
                with pytest.raises((sv.SolariError, AttributeError), match=re.escape(words[word])):
                    getattr(holder, word.upper())
        there = {*dir(holder), *getattr(holder, "_names", ()), *HIT_FIELDS, "samples"}
        answers = {advice: re.match(r"it is (?:called )?(\w+)", advice) for advice in words.values()}
        for advice, found in answers.items():
            assert found is None or found[1] in there, advice


def holder_of(owner):
    """What has the words of "NAME.NAME", None where it is no part of the package."""
    first, *names = owner.split(".")
    holder = sv if first == "solari_vk" else getattr(sv, first, None)
    for name in names:
        holder = getattr(holder, name)
    return holder
